"""The registry of devices: what it takes in, how it merges, and whose calibration a recording gets."""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import datetime, timedelta
from hashlib import sha256
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import IDENTITY, Calibration
from accelcal_cli.judge.errors import apart_mg
from accelcal_cli.output.coefficients import coefficients_json
from accelcal_cli.output.registry import RegistryEntry, read_registry, write_registry
from accelcal_cli.output.report_reading import report_schema
from accelcal_cli.pipeline.registry import Wanted, candidates, walk_mg2_a_day
from tests.cli.run import assert_one_line, exit_code, nightly, run, verify
from tests.recordings import good_raw

BEGUN = datetime(2024, 1, 1)


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("template")
    assert exit_code("calibrate", good_raw(folder), "--report-only", "-q") == 0
    return json.loads((folder / "good.calibration.json").read_text())


def test_an_entry_keeps_what_a_report_must_have() -> None:
    """What a new section holds goes into every registry: decide whether it may before it is put here."""
    kept = (
        "kind", "schema_version", "accelcal_version", "recording", "settings", "outcome", "reason", "values",
        "message", "notes", "cautions", "advice", "calibration", "without_misalignment",
        "calibration_error_mg", "probability", "uncertainty", "rest_scatter_mg", "change", "misfits",
        "holdout", "fit", "coverage", "models_tried", "file_health", "provenance",
    )  # fmt: skip
    assert tuple(report_schema()["required"]) == kept


def calibration(scales: np.ndarray, offset_mg: np.ndarray) -> Calibration:
    fixed = [round(float(value) * ONE) for value in (*scales, 0, 0, 0, *offset_mg / 1000, 0, 0, 0)]
    return Calibration("9", tuple(fixed))


def made(
    template: dict[str, Any], serial: str, day: float, found: Calibration, error_mg: float,
    heat: tuple[float, float] | None = None,
) -> RegistryEntry:  # fmt: skip
    """An entry as of a recording of this day, with coefficients that claim such an error."""
    before = apart_mg(Calibration("0", IDENTITY), found)
    start = (BEGUN + timedelta(days=day)).isoformat()
    recording = template["recording"] | {
        "start_time": start,
        "sha256": sha256(f"{serial} {day}".encode()).hexdigest(),
    }
    recording["device"] = {"model": "AX3", "serial": serial, "firmware": None}
    error = {"mean": error_mg, "ci95": [0.4 * error_mg, 2 * error_mg], "worst_direction": 2 * error_mg}
    error |= {"worst_direction_at": [1.0, 0.0, 0.0], "before": before}
    section = template["calibration"] | coefficients_json(found)
    return RegistryEntry(
        template | {"recording": recording, "calibration": section, "calibration_error_mg": error},
        heat,
        Path("r"),
    )


def wanted(serial: str, day: float, **more: Any) -> Wanted:
    return Wanted(serial, "AX3", None, BEGUN + timedelta(days=day), **more)


@dataclass
class Device:
    """A simulated device whose scales and offsets walk at random, day by day."""

    scales: np.ndarray
    offsets: np.ndarray

    @classmethod
    def drawn(cls, random: np.random.Generator, walk_mg: float, off: float) -> Device:
        """Args: walk_mg: what offsets walk in a month; off: size of the device's errors."""
        steps = walk_mg / np.sqrt(30) * random.standard_normal((181, 3))
        scales = 1 + 0.02 * off * random.standard_normal(3)
        return cls(scales, np.cumsum(steps, axis=0) + 30 * off * random.standard_normal(3))

    def at(self, day: int) -> Calibration:
        return calibration(self.scales, self.offsets[day])

    def found(self, day: int, error_mg: float, random: np.random.Generator) -> Calibration:
        """Coefficients that are off by about such an error over all orientations."""
        return calibration(self.scales, self.offsets[day] + 1.25 * error_mg * random.standard_normal(3))


def fleet(
    template: dict[str, Any], seed: int, walk_mg: float, devices: int
) -> list[tuple[float, float, float]]:
    """Errors of refused recordings [mg]: by the registry (raw where it has nothing), by the nearest, raw."""
    random, errors = np.random.default_rng(seed), []
    raw = Calibration("0", IDENTITY)
    for number in range(devices):
        device = Device.drawn(random, walk_mg, 1.0 if number % 4 else 0.1)
        days = sorted(random.choice(181, 10, replace=False).tolist())
        claims = np.exp(random.uniform(np.log(0.2), np.log(8), 10)).tolist()
        entries = [
            made(template, f"D{number}", day, device.found(day, claim, random), claim)
            for day, claim in zip(days, claims, strict=True)
        ]
        for day in random.choice(181, 4, replace=False).tolist():
            best = candidates(entries, wanted(f"D{number}", day))
            nearest = entries[int(np.abs(np.array(days) - day).argmin())]
            chosen = best[0].entry.coefficients().calibration if best else raw
            used = (chosen, nearest.coefficients().calibration, raw)
            errors.append(tuple(apart_mg(one, device.at(day)) for one in used))
    return errors


@pytest.mark.parametrize(
    ("seed", "walk_mg", "devices"), [(1, 0.3, 4), nightly(2, 0.3, 12), nightly(3, 2.0, 12)]
)
def test_51_2_the_registry_beats_the_nearest_in_time(
    template: dict[str, Any], seed: int, walk_mg: float, devices: int
) -> None:
    """Quiet devices and ones that wander, some of them with hardly any error of their own."""
    ours, nearest, raw = np.array(fleet(template, seed, walk_mg, devices)).T
    means = [round(float(errors.mean()), 2) for errors in (ours, nearest, raw)]
    print(f"walk {walk_mg} mg: registry, nearest, raw: {means} mg")
    assert ours.mean() < 0.8 * nearest.mean()
    assert (ours <= raw + 1e-9).all(), "never worse than none"


def test_51_2_near_in_time_or_sure_by_how_the_device_walks(template: dict[str, Any]) -> None:
    """A device that stays as it is takes its surest calibration, one that wanders its last."""
    scales, zero = np.array([1.02, 0.98, 1.01]), np.array([20.0, -30.0, 25.0])
    same = calibration(scales, zero)
    still = [made(template, "D", day, same, 0.3 if day == 0 else 2.0) for day in (0, 50, 100)]
    assert candidates(still, wanted("D", 110))[0].entry is still[0]
    moved = [
        made(template, "D", day, calibration(scales, zero + day / 5), 0.3 if day == 0 else 2.0)
        for day in (0, 50, 100)
    ]
    assert candidates(moved, wanted("D", 110))[0].entry is moved[2]
    assert walk_mg2_a_day(moved) > 5 * walk_mg2_a_day(still)


def test_51_2_a_temperature_that_was_never_there_counts(template: dict[str, Any]) -> None:
    found = calibration(np.array([1.02, 0.98, 1.01]), np.array([20.0, -30.0, 25.0]))
    cold = made(template, "D", 9, found, 0.5, (5.0, 12.0))
    warm = made(template, "D", 1, found, 0.5, (28.0, 34.0))
    assert candidates([cold, warm], wanted("D", 10, celsius=31.0))[0].entry is warm
    assert candidates([cold, warm], wanted("D", 10, celsius=8.0))[0].entry is cold


def test_51_2_what_does_not_help_is_not_taken(template: dict[str, Any]) -> None:
    near_ideal = calibration(np.ones(3), np.array([2.0, -1.0, 1.0]))
    assert not candidates([made(template, "D", 1, near_ideal, 2.0)], wanted("D", 2))
    far = calibration(np.array([1.05, 0.97, 1.01]), np.array([50.0, -40.0, 30.0]))
    entries = [made(template, "D", 1, far, 2.0)]
    assert candidates(entries, wanted("D", 2))
    assert not candidates(entries, wanted("D", 2, own_mg=1.0))
    assert not candidates(entries, wanted("E", 2)) and not candidates(entries, Wanted(None, None, None, None))


def test_51_2_registries_merge_in_any_order_to_one_file(template: dict[str, Any], tmp_path: Path) -> None:
    found = calibration(np.array([1.05, 0.97, 1.01]), np.array([50.0, -40.0, 30.0]))
    for name, serials in (("a", "XY"), ("b", "YZ"), ("c", "XZ")):
        error = {"a": 1.0, "b": 2.0, "c": 0.5}[name]
        write_registry(tmp_path / f"{name}.json", [made(template, one, 1, found, error) for one in serials])
    written = set()
    for order in permutations("abc"):
        target = tmp_path / "".join(order)
        target = target.with_suffix(".json")
        for name in order:
            assert exit_code("devices", tmp_path / f"{name}.json", "--registry", target, "-q") == 0
        written.add(target.read_bytes())
    assert len(written) == 1
    held = read_registry(target)
    assert [one.view.recording.device.serial for one in held] == ["X", "Y", "Z"]
    assert [one.view.calibration_error_mg.mean for one in held] == [0.5, 1.0, 0.5]
    assert held[0].report["provenance"] == template["provenance"]


@pytest.fixture(scope="module")
def nights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A good recording of a device, studied and in a registry, and one of seven minutes."""
    folder = tmp_path_factory.mktemp("registry")
    (folder / "in").mkdir()
    for path, days in ((folder / "in" / "good.bin", 0.5), (folder / "short.bin", 0.005)):
        assert exit_code("simulate", path, "--days", days, "--rate", 20, "-q") == 0
    assert exit_code("study", folder / "in", "-d", folder / "out", "-q", "--jobs", 1, "--report-only") == 0
    assert exit_code("devices", folder / "out", "--registry", folder / "lab.json", "-q") == 0
    return folder


def test_51_2_a_refused_recording_takes_the_best_of_its_device(nights: Path) -> None:
    out = nights / "c"
    words = ("calibrate", nights / "short.bin", "-d", out, "--force", "-q")
    assert run(*words).code in (0, 4)
    own = json.loads((out / "short.calibration.json").read_text())
    assert own["outcome"] in ("refused", "provisional")
    assert run(*words, "--registry", nights / "lab.json").code == 0
    report = json.loads((out / "short.calibration.json").read_text())
    good = json.loads((nights / "out" / "good.calibration.json").read_text())
    assert report["outcome"] == "borrowed" and report["calibration"]["gain"] == good["calibration"]["gain"]
    assert report["coefficients"]["recording_sha256"] == good["recording"]["sha256"]
    assert verify(out / "short.calibration.json", nights / "short.bin")[0].code == 0


def test_51_2_apply_and_study_take_it_too(nights: Path, tmp_path: Path) -> None:
    lab = ("--registry", nights / "lab.json")
    assert exit_code("apply", nights / "short.bin", *lab, "-d", tmp_path, "-q") == 0
    assert json.loads((tmp_path / "short.calibration.json").read_text())["outcome"] == "borrowed"
    other = good_raw(tmp_path)
    ran = run("apply", other, *lab, "-d", tmp_path)
    assert_one_line(ran, "good.raw", "registry", "accelcal devices", code=2)
    assert run("apply", other, "-d", tmp_path).code == 2
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "short.bin").write_bytes((nights / "short.bin").read_bytes())
    words = ("study", tmp_path / "in", "-d", tmp_path / "out", "-q", "--jobs", 1, "--report-only")
    assert run(*words).code in (0, 1, 4)
    assert run(*words, *lab).code == 0
    table = (tmp_path / "out" / "study.csv").read_text()
    assert "borrowed" in table


def test_a_known_device_that_nothing_helps_is_not_said_to_be_unknown(nights: Path, tmp_path: Path) -> None:
    held = json.loads((nights / "lab.json").read_text())
    held["devices"]["SIM00001"][0]["report"]["calibration_error_mg"]["before"] = 0.01
    (tmp_path / "lab.json").write_text(json.dumps(held))
    ran = run("apply", nights / "short.bin", "--registry", tmp_path / "lab.json", "-d", tmp_path)
    assert_one_line(ran, "of device SIM00001", "nothing that is surely better than raw data", code=2)


def test_51_2_files_that_are_not_registries_are_said(nights: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.json"
    mine.write_text('{"a": 1}')
    ran = run("devices", nights / "out", "--registry", mine)
    assert ran.code == 5 and mine.read_text() == '{"a": 1}'
    ran = run("calibrate", nights / "short.bin", "--registry", mine, "-d", tmp_path)
    assert_one_line(ran, "mine.json", "accelcal devices OUT --registry", code=3)
    damaged = json.loads((nights / "lab.json").read_text())
    damaged["devices"]["SIM00001"][0]["report"]["calibration"]["model"] = "x"
    mine.write_text(json.dumps(damaged))
    ran = run("calibrate", nights / "short.bin", "--registry", mine, "-d", tmp_path)
    assert ran.code == 3 and "mine.json: is a damaged registry" in ran.err
    damaged = json.loads((nights / "lab.json").read_text())
    damaged["devices"]["SIM00001"][0]["report"]["misfits"][0].pop("before_mg")
    mine.write_text(json.dumps(damaged))
    ran = run("apply", nights / "short.bin", "--registry", mine, "-d", tmp_path)
    said = "is a damaged registry: in an entry of device SIM00001, misfits[0].before_mg is missing"
    assert_one_line(ran, said, "accelcal devices OUT --registry", code=3)
    damaged["devices"]["SIM00001"][0].pop("report")
    mine.write_text(json.dumps(damaged))
    assert run("calibrate", nights / "short.bin", "--registry", mine, "-d", tmp_path).code == 3
