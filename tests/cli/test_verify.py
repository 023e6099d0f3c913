"""`accelcal verify`: identical where nothing was changed, and what differs where something was."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import accelcal_cli.verify as verifying
from accelcal_cli.core.version import __version__
from tests.cli.run import run, verify
from tests.device_recordings import donor, edit, rest, week, write_device
from tests.recordings import directions, still_counts, write_csv

Capture = pytest.CaptureFixture[str]


def test_a_reworded_report_is_identical(tmp_path: Path, capsys: Capture) -> None:
    """Sentences are for people; reason and values are compared."""
    report, recording = donor(tmp_path), tmp_path / "donor.raw"
    edit(report, lambda held: held.update(message="Other words."))
    ran, found = verify(capsys, report, recording)
    assert (ran.code, found["result"]) == (0, "identical")
    edit(report, lambda held: held.update(reason="not_clearly_better"))
    ran, found = verify(capsys, report, recording)
    assert (ran.code, found["differs"]) == (1, ["reason"])


@pytest.mark.parametrize("words", [
    (),
    pytest.param(("--no-temperature",), marks=pytest.mark.nightly),
    pytest.param(("--model", "6", "--segment-seconds", 4, "--stillness-threshold-g", 0.2),
                 marks=pytest.mark.nightly),
    pytest.param(("--optimizer", "gauss-newton"), marks=pytest.mark.nightly),
    ("--profile", "paper", "--min-distance-g", 0.15),
    ("--profile", "paper", "--max-subset-points", 4, "--stillness-axis", "z"),
    pytest.param(("--stillness", "deviation"), marks=pytest.mark.nightly),
    pytest.param(("--stillness", "adaptive"), marks=pytest.mark.nightly),
    pytest.param(("--latitude", 52.5, "--altitude", 34, "--timezone", "Europe/Berlin"),
                 marks=pytest.mark.nightly),
    pytest.param(("--report-only", "--lsb-per-g", 250.0, "--no-temperature"), marks=pytest.mark.nightly),
])  # fmt: skip
def test_a_report_with_any_settings_is_reproduced(
    tmp_path: Path, capsys: Capture, words: tuple[object, ...]
) -> None:
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    poses = (
        directions(120) if "paper" in words else np.concatenate([faces, faces, faces, faces, directions(30)])
    )
    path = write_device(tmp_path / "a.raw", *rest(poses, warm=True))
    assert run(capsys, "calibrate", path, *words).code == 0
    ran, found = verify(capsys, tmp_path / "a.calibration.json", path, "--chunk-samples", 333)
    assert (ran.code, found["result"], found["differs"]) == (0, "identical", [])
    assert (found["largest_mg"], found["mean_mg"]) == (0, 0)
    assert found["versions"] == {"report": __version__, "this": __version__}
    assert (found["parquet"] is None) == ("--report-only" in words)


def test_text_options_a_moved_recording_and_the_line(tmp_path: Path, capsys: Capture) -> None:
    path = write_csv(tmp_path / "a.csv", still_counts(directions(20)))
    run(
        capsys, "calibrate", "--model", 6, path, "--columns", "y,z,x", "--unit", "g", "-R", "time_column=time"
    )
    report, moved = tmp_path / "a.calibration.json", tmp_path / "moved.csv"
    path.rename(moved)
    ran = run(capsys, "verify", report, moved)
    assert ran.code == 0
    assert ran.lines == [f"{report}\tidentical\t0\t0\t{__version__}\t{__version__}\t-"]
    assert "a.calibrated.parquet: carries the calibration of the report" in ran.err
    assert run(capsys, "verify", "-q", report, moved).err == ""


def test_a_refused_recording_is_refused_again(tmp_path: Path, capsys: Capture) -> None:
    path = write_csv(tmp_path / "a.csv", still_counts(directions(4)))
    assert run(capsys, "calibrate", path, "--strict").code == 4
    ran, found = verify(capsys, tmp_path / "a.calibration.json", path)
    assert (ran.code, found["result"]) == (0, "identical")
    assert (found["largest_mg"], found["parquet"]) == (None, None)


def test_every_parameter_is_compared_to_the_last_bit(tmp_path: Path, capsys: Capture) -> None:
    report, path = donor(tmp_path, warm=True), tmp_path / "donor.raw"
    (tmp_path / "donor.calibrated.parquet").unlink()
    whole = report.read_text()
    for name in ("k_xx", "k_zy", "oz", "sx"):
        report.write_text(whole)
        key = f"calibration.fixed_point.parameters.{name}"

        def flip(held: dict, name: str = name) -> None:
            held["calibration"]["fixed_point"]["parameters"][name] ^= 1

        ran, found = verify(capsys, edit(report, flip), path)
        assert (ran.code, found["result"], found["differs"]) == (1, "differs", [key])
        if name == "sx":
            assert found["largest_mg"] == 0
        else:
            assert 0 < found["mean_mg"] <= found["largest_mg"] < 1.05 * 1000 / 2**29


def change_gain(held: dict) -> None:
    held["calibration"]["gain"][1][0] *= 1 + 2**-52


@pytest.mark.parametrize(
    ("change", "keys"),
    [
        (lambda held: held.update(outcome="reduced_model"), ["outcome"]),
        pytest.param(lambda held: held.update(reason="all_is_well"), ["reason"], marks=pytest.mark.nightly),
        pytest.param(
            lambda held: held["calibration"].update(model="6"),
            ["calibration.model"],
            marks=pytest.mark.nightly,
        ),
        (change_gain, ["calibration.gain[1][0]"]),
        (lambda held: held["holdout"]["after_mg"].update(mean=0.001), ["holdout.after_mg.mean"]),
        pytest.param(
            lambda held: held["file_health"].update(filled_samples=3),
            ["file_health.filled_samples"],
            marks=pytest.mark.nightly,
        ),
        (lambda held: held.pop("coverage"), ["coverage"]),
        pytest.param(lambda held: held.update(calibration=None), ["calibration"], marks=pytest.mark.nightly),
        pytest.param(lambda held: held.update(calibration=[1]), ["calibration"], marks=pytest.mark.nightly),
        pytest.param(lambda held: held.update(extra=1), ["extra"], marks=pytest.mark.nightly),
        (lambda held: held["provenance"].update(host="elsewhere"), []),
        pytest.param(lambda held: held.pop("provenance"), [], marks=pytest.mark.nightly),
    ],
)
def test_what_differs_is_named(tmp_path: Path, capsys: Capture, change: Any, keys: list[str]) -> None:
    report, path = donor(tmp_path), tmp_path / "donor.raw"
    (tmp_path / "donor.calibrated.parquet").unlink()
    edit(report, change)
    ran, found = verify(capsys, report, path)
    assert (ran.code, found["differs"]) == (1 if keys else 0, keys)
    line = run(capsys, "verify", report, path).lines[0].split("\t")
    assert line[1] == ("differs" if keys else "identical")
    assert line[6] == (", ".join(keys) or "-")


def test_settings_of_another_version_are_told(tmp_path: Path, capsys: Capture) -> None:
    report, path = donor(tmp_path), tmp_path / "donor.raw"
    (tmp_path / "donor.calibrated.parquet").unlink()

    def change(held: dict) -> None:
        held["accelcal_version"] = "0.0.9"
        del held["settings"]["precision_mg"], held["settings"]["input"]["date_format"]
        held["settings"]["magic"] = {"a": 1}

    edit(report, change)
    ran, found = verify(capsys, report, path)
    assert (ran.code, found["differs"]) == (0, [])
    assert found["versions"] == {"report": "0.0.9", "this": __version__}
    assert found["settings_assumed"] == ["precision_mg", "input.date_format"]
    assert found["settings_unknown"] == ["magic"]
    assert "does not state precision_mg, input.date_format" in ran.err
    assert "states magic" in ran.err
    edit(report, lambda held: held["settings"].update(cells_per_g=10))
    assert verify(capsys, report, path)[0].code == 1


def places(report: Any, *outer: str) -> list[tuple[str, ...]]:
    """All keys of a report, outer ones first."""
    if not isinstance(report, dict):
        return []
    return [at for name in report for at in ((*outer, name), *places(report[name], *outer, name))]


def test_what_was_taken_out_differs(tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without `input`, a report says that it cannot be reproduced."""
    report, path = donor(tmp_path), tmp_path / "donor.raw"
    (tmp_path / "donor.calibrated.parquet").unlink()
    whole = json.loads(report.read_text())
    made_again = json.loads(report.read_text())
    monkeypatch.setattr(verifying, "reproduced", lambda *_: (json.loads(json.dumps(made_again)), None))
    taken_out = [*places(whole["settings"], "settings"), ("file_health", "clock"), ("coverage", "cells")]
    taken_out.remove(("settings", "input"))
    for place in taken_out:
        held = json.loads(json.dumps(whole))
        section = held
        for name in place[:-1]:
            section = section[name]
        del section[place[-1]]
        report.write_text(json.dumps(held))
        ran, found = verify(capsys, report, path)
        assert ran.code != 0, place
        assert not found or ".".join(place) in found["differs"], (place, found)


def test_a_setting_that_this_version_does_not_have_differs_in_its_own_report(
    tmp_path: Path, capsys: Capture
) -> None:
    report, path = donor(tmp_path), tmp_path / "donor.raw"
    (tmp_path / "donor.calibrated.parquet").unlink()
    ran, found = verify(capsys, edit(report, lambda held: held["settings"].update(magic=1)), path)
    assert (ran.code, found["differs"]) == (1, ["settings.magic"])


def test_another_or_a_changed_recording_is_refused(tmp_path: Path, capsys: Capture) -> None:
    report, path = donor(tmp_path), tmp_path / "donor.raw"
    other = week(tmp_path / "other.raw", seed=2, poses=12)
    ran, _ = verify(capsys, report, other)
    assert ran.code == 2
    assert "is not the recording of" in ran.err
    data = bytearray(path.read_bytes())
    data[1000] ^= 1
    path.write_bytes(data)
    assert verify(capsys, report, path)[0].code == 2
    assert verify(capsys, report, tmp_path / "absent.raw")[0].code == 3


def test_the_layout_must_be_the_same(tmp_path: Path, capsys: Capture) -> None:
    report, path = donor(tmp_path), tmp_path / "donor.raw"
    layout, moved = tmp_path / "donor.layout.toml", tmp_path / "moved.toml"
    layout.rename(moved)
    ran, _ = verify(capsys, report, path)
    assert (ran.code, "--layout" in ran.err) == (2, True)
    assert verify(capsys, report, path, "--layout", moved)[0].code == 0
    moved.write_text(moved.read_text() + "# changed\n")
    assert verify(capsys, report, path, "--layout", moved)[0].code == 2


def test_sidecars_must_be_the_same(tmp_path: Path, capsys: Capture) -> None:
    rows = still_counts(directions(4)) / 256 * 9.80665
    path = tmp_path / "sub-1_task-a_tracksys-b_motion.tsv"
    np.savetxt(path, rows, "%.6f", "\t")
    channels = tmp_path / "sub-1_task-a_tracksys-b_channels.tsv"
    lines = [f"acc_{axis}\t{axis}\tACCEL\twrist\tm/s^2\t25" for axis in "xyz"]
    head = "name\tcomponent\ttype\ttracked_point\tunits\tsampling_frequency"
    channels.write_text("\n".join([head, *lines, ""]))
    assert run(capsys, "calibrate", path).code in (0, 4)
    report = tmp_path / "sub-1_task-a_tracksys-b_motion.calibration.json"
    ran, found = verify(capsys, report, path)
    assert (ran.code, found["result"]) == (0, "identical")
    channels.write_text(channels.read_text().replace("wrist", "ankle"))
    assert verify(capsys, report, path)[0].code == 2


def test_reports_of_apply_are_verified_with_their_coefficients(tmp_path: Path, capsys: Capture) -> None:
    coefficients, path = donor(tmp_path), tmp_path / "donor.raw"
    other = week(tmp_path / "other.raw", seed=2, poses=12, serial="B2")
    apply = ("apply", "--coefficients", coefficients, "--any-device", "-d", tmp_path / "out")
    assert run(capsys, *apply, other, path).code == 0
    for name, recording in (("other", other), ("donor", path)):
        ran, found = verify(capsys, tmp_path / "out" / f"{name}.calibration.json", recording, "--values")
        assert (ran.code, found["differs"], found["parquet"]["values"]) == (0, [], "identical")
    moved = tmp_path / "moved.json"
    coefficients.rename(moved)
    report = tmp_path / "out" / "other.calibration.json"
    ran, _ = verify(capsys, report, other)
    assert (ran.code, "--coefficients" in ran.err) == (2, True)
    assert verify(capsys, report, other, "--coefficients", moved)[0].code == 0
    edit(moved, lambda held: held["provenance"].update(host="elsewhere"))
    ran, found = verify(capsys, report, other, "--coefficients", moved)
    assert (ran.code, found["differs"], found["largest_mg"]) == (1, ["coefficients.sha256"], 0)


def test_what_is_no_report_of_a_recording(tmp_path: Path, capsys: Capture) -> None:
    report, path = donor(tmp_path), tmp_path / "donor.raw"
    whole = report.read_text()
    for change, code in (
        (lambda held: held["settings"].pop("input"), 2),
        (lambda held: held["settings"].update(profile="six-pose"), 4),
        (lambda held: held.pop("settings"), 3),
        (lambda held: held.pop("recording"), 3),
        (lambda held: held.update(schema_version=7), 3),
        (lambda held: held.update(coefficients={}), 3),
        (lambda held: held["settings"].update(folds=0), 3),
    ):
        report.write_text(whole)
        ran, _ = verify(capsys, edit(report, change), path)
        assert (ran.code, ran.err.count("\n")) == (code, 1), ran.err
    report.write_text("{")
    assert verify(capsys, report, path)[0].code == 3
