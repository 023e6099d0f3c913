"""`accelcal study --prior study` and `--prior device`: what a recording learns from others of the study."""

from __future__ import annotations

import hashlib
import json
import runpy
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.prior import LearntPrior
from accelcal_cli.studies.other_recordings import Learning
from accelcal_cli.studies.summary import PARAMETERS
from tests.cli.run import Ran, assert_one_line, run, verify
from tests.cli.studies import results, rows, study_in
from tests.conftest import ROOT
from tests.device_recordings import edit, rest, write_device
from tests.recordings import GAIN, OFFSET_G, directions
from tests.studies.borrowing import report
from tests.studies.processes import killed_after

FEW = directions(12)[directions(12)[:, 2] > 0.2][:5]
GOOD = "ABCDE"
KINDS = dict.fromkeys([*GOOD, "far"], "population") | {"few1": "device", "few2": "study"}
UNLIKE = "its still windows contradict what other recordings say of its sensor."


def study(here: Path, prior: str, *words: object, out: str = "out", jobs: int = 2) -> Ran:
    return study_in(here, "--report-only", "--prior", prior, *words, out=out, jobs=jobs)


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five devices with a good recording each, a short one of A and of another device, and one far off.

    Of each of the five there are only four others, so that all but `few1` has its model's prior or none.
    """
    base = tmp_path_factory.mktemp("prior")
    (base / "in").mkdir()

    def made(name: str, poses: np.ndarray, seed: int, serial: str, moved: object, day: int = 4) -> None:
        start = f"2024-03-{day:02}T00:00:00"
        held = rest(poses, seed=seed)[0] + moved
        write_device(base / f"in/{name}.raw", held, serial=serial, model="M1", start=start)

    for number, serial in enumerate(GOOD):
        made(serial, directions(8), number, serial, 0.002 * np.random.RandomState(number).randn(3))
    made("few1", FEW, 20, "A", 0.002 * np.random.RandomState(0).randn(3), day=30)
    made("few2", FEW, 21, "G", 0.0)
    made("far", FEW, 30, "H", [0.2, -0.2, 0.15])
    assert study(base, "device").code == 0
    return base


def of(out: Path) -> dict[str, dict[str, str]]:
    return {row["path"].removesuffix(".raw"): row for row in rows(out)}


def error_mg(found: dict[str, Any]) -> float:
    """Mean | |a| - 1 | over the sphere of the sensor that all of them nearly are, without scatter."""
    raw = directions(500) @ np.linalg.inv(GAIN).T - OFFSET_G
    a = (raw + found["calibration"]["offset_g"]) @ np.array(found["calibration"]["gain"]).T
    return float(1000 * np.abs(np.linalg.norm(a, axis=1) - 1).mean())


def test_it_says_which_prior_was_used_and_the_error_is_smaller(base: Path, tmp_path: Path) -> None:
    table = of(base / "out")
    assert {name: row["prior"] for name, row in table.items()} == KINDS
    assert json.loads((base / "out/study.json").read_text())["settings"]["prior"] == "device"
    for name in ("few1", "few2"):
        run("calibrate", base / f"in/{name}.raw", "-d", tmp_path, "--report-only")
        own, found = report(tmp_path, name), report(base / "out", name)
        assert error_mg(found) < error_mg(own) / 2
        assert found["calibration_error_mg"]["ci95"][1] < own["calibration_error_mg"]["ci95"][1]
        assert table[name]["own_message"] == own["message"]


def test_the_report_says_what_was_learnt_and_from_whom(base: Path) -> None:
    found = report(base / "out", "few2")
    said = found["prior"]
    assert found["settings"]["prior"] == said["kind"] == found["models_tried"][-1]["prior"] == "study"
    hashes = sorted(report(base / "out", name)["recording"]["sha256"] for name in GOOD)
    digest = hashlib.sha256("".join(hashes).encode()).hexdigest()
    assert said["model"] == {"name": "M1", "devices": 5, "recordings": 5, "sha256": digest}
    assert found["message"].endswith(" The prior was learnt from 5 other devices of model M1.")
    assert np.abs(np.subtract([said["centre"][name] for name in ("ox", "oy", "oz")], OFFSET_G)).max() < 0.006
    of_device = report(base / "out", "few1")
    donor = report(base / "out", "A")["recording"]["sha256"]
    assert of_device["prior"]["device"] == [{"path": "A.raw", "sha256": donor}]
    assert of_device["message"].endswith(" The prior was learnt from 1 other recording of the device.")
    assert all("prior" not in report(base / "out", name) for name in ("far", *GOOD))


def test_a_sensor_unlike_the_others_keeps_its_own_result(base: Path) -> None:
    """200 mg from them all, and five postures say so."""
    message = report(base / "out", "far")["message"]
    row = of(base / "out")["far"]
    assert row["message"] == f"{message} Kept with the prior of the population: {UNLIKE}"
    assert row["cautions"].split()[-1] == "prior_not_learnt"


def test_verify_repeats_it_from_report_and_recording_alone(base: Path, tmp_path: Path) -> None:
    for name in ("few1", "few2"):
        path = Path(shutil.copy(base / f"out/{name}.calibration.json", tmp_path))
        assert verify(path, base / f"in/{name}.raw")[0].code == 0
    edit(path, lambda held: held["prior"]["centre"].update(ox=0.05))
    assert verify(path, base / f"in/{name}.raw")[0].code == 1


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda held: held.pop("prior"), "settings.prior is 'study', but there is no prior"),
        (lambda held: held["prior"]["width"].pop("ox"), "prior.width.ox is missing"),
        (lambda held: held["prior"]["width"].update(ox=0), "prior.width.ox is 0, which is too small"),
        (lambda held: held["prior"]["centre"].update(ox=1e300), "it has a prior that no study learns"),
        (lambda held: held["prior"].update(kind="device"), "it has a prior that no study learns"),
        (lambda held: held["prior"].update(reference_c=1e9), "prior.reference_c cannot be"),
    ],
)
def test_a_report_whose_prior_cannot_be_is_damaged(
    base: Path, tmp_path: Path, change: Callable[[dict[str, Any]], object], what: str
) -> None:
    path = Path(shutil.copy(base / "out/few2.calibration.json", tmp_path))
    edit(path, change)
    assert_one_line(run("verify", path, base / "in/few2.raw"), f"is a damaged report: {what}", code=3)


@pytest.mark.nightly
def test_workers_and_earlier_runs_make_no_difference(base: Path, here: Path) -> None:
    study(here, "device", out="other", jobs=1)
    assert results(here / "other") == results(base / "out")
    assert "8 unchanged" in study(here, "device").err
    assert {line.split("\t")[1] for line in study(here, "device", "--dry-run").lines} == {
        "calibrated",
        "provisional",
    }
    assert "7 unchanged" in study(here, "study").err
    assert {name: row["prior"] for name, row in of(here / "out").items()} == {**KINDS, "few1": "population"}
    assert "7 unchanged" in study(here, "device").err
    assert results(here / "out") == results(base / "out")


def test_when_one_goes_the_others_learn_anew(base: Path, here: Path) -> None:
    (here / "in/E.raw").unlink()
    states = dict(line.split("\t") for line in study(here, "device", "--dry-run").lines)
    assert {name for name, state in states.items() if state == "todo"} == set()
    told = study(here, "device").err
    assert "M1: 4 devices with good recordings, a recording needs 5 others to learn from" in told
    assert {name: row["prior"] for name, row in of(here / "out").items() if name in ("few1", "few2")} == {
        "few1": "device",
        "few2": "population",
    }


def test_what_changes_is_learnt_anew(here: Path) -> None:
    """By `few1`, and by `far`, which keeps its own result again."""
    write_device(here / "in/A.raw", rest(directions(8), seed=40)[0], serial="A", model="M1")
    assert "4 unchanged" in study(here, "device").err
    (source,) = report(here / "out", "few1")["prior"]["device"]
    assert source["sha256"] == hashlib.sha256((here / "in/A.raw").read_bytes()).hexdigest()


def test_its_coefficients_are_applied_and_verified(base: Path, tmp_path: Path) -> None:
    held = base / "out/few1.calibration.json"
    for name, words in (("few1", ()), ("few2", ("--any-device",))):
        recording, made = base / f"in/{name}.raw", tmp_path / f"{name}.calibration.json"
        assert run("apply", "--coefficients", held, recording, "-d", tmp_path, *words).code == 0
        assert json.loads(made.read_text())["calibration"] == report(base / "out", "few1")["calibration"]
        again = run("verify", made, recording, "--coefficients", held)
        assert again.lines[0].split("\t")[1] == "identical"
    assert json.loads(made.read_text())["settings"]["prior"] == "population"


@pytest.mark.parametrize("words", ["calibrate in/A.raw --prior study", "inspect in/A.raw --prior device"])
def test_a_learnt_prior_is_refused_elsewhere_with_where_it_is_available(words: str) -> None:
    ran = run(*words.split(), code=2)
    more = f"see: accelcal {words.split(maxsplit=1)[0]} --help\n"
    assert ran.err.endswith(f"is available only in `accelcal study`: it uses other recordings; {more}")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("study in -d x --prior study --pool device", "--prior study does not go with --pool"),
        ("study in -d x --prior device --borrow", "--prior device does not go with --borrow"),
        ("study in -d x --prior study --model 9", "--prior study does not go with --model 9"),
    ],
)
def test_what_it_does_not_go_with(base: Path, monkeypatch: pytest.MonkeyPatch, words: str, said: str) -> None:
    monkeypatch.chdir(base)
    assert_one_line(run(*words.split()), said, code=2)
    assert not (base / "x").exists()


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
@pytest.mark.nightly
@pytest.mark.parametrize("after", [1, 4, 8, 9, 10])
def test_killed_at_any_moment_a_rerun_ends_as_if_nothing_had_been(base: Path, here: Path, after: int) -> None:
    killed_after(here, after, "--prior", "device", "--report-only")
    assert study(here, "device").code == 0
    assert results(here / "out") == results(base / "out")


@pytest.mark.nightly
def test_shards_find_own_results_and_collected_they_learn(base: Path, here: Path) -> None:
    for number in (2, 1):
        study(here, "device", "--shard", f"{number}/2", out="parts")
    study(here, "device", "--collect", out="parts")
    assert {name: held for name, held in results(here / "parts").items() if "-of-" not in name} == results(
        base / "out"
    )


@pytest.mark.nightly
def test_a_lost_ledger_changes_nothing(base: Path, here: Path) -> None:
    (here / "out/study.ledger").unlink()
    study(here, "device")
    assert results(here / "out") == results(base / "out")


@pytest.mark.nightly
def test_devices_alike_have_smaller_errors_and_intervals_that_hold() -> None:
    """One fleet of those in docs/prior.md."""
    tool = runpy.run_path(str(ROOT / "tools/compare_priors.py"))
    found = tool["fleet"](tool["KINDS"][0], seed=11)
    error_mg = {prior: np.mean([one.error_mg for one in held]) for prior, held in found.items()}
    assert error_mg["device"] < error_mg["study"] < 0.7 * error_mg["population"]
    for held in found.values():
        assert np.mean([one.low_mg <= one.error_mg <= one.high_mg for one in held]) >= 0.9


def row(serial: str | None, sha256: str, offset_g: float = 0.03, **more: Any) -> dict[str, Any]:
    """A good recording's row in which each parameter is known to a hundredth of the population's width."""
    ideal = dict(zip(PARAMETERS, [1.0] * 3 + [0.0] * 3 + [offset_g] * 3 + [None] * 3, strict=True))
    errors = dict(zip(PARAMETERS, [0.00018] * 3 + [0.00013] * 3 + [0.00035] * 3 + [None] * 3, strict=True))
    held = {
        "outcome": "calibrated", "change": "none", "calibration_error_high_mg": 4.0, "device_serial": serial,
        "device_model": "M1", "lsb_per_g": 256.0, "range_g": 8.0, "sha256": sha256, "cells": 20,
        "start_time": "2024-03-04T00:00:00", "duration_s": 3600.0, "reference_c": None,
    }  # fmt: skip
    return held | ideal | {f"se_{name}": error for name, error in errors.items()} | more


def prior_of(
    kind: str = "study", silent: Sequence[str] = (), without: Sequence[str] = (), **named: dict[str, Any]
) -> LearntPrior | None:
    """That of recording `x`, with five others or more, some of which are excluded or not there."""
    fleet = {f"d{number}": row(f"D{number}", f"d{number}") for number in range(5)} | named
    there = {name: one for name, one in fleet.items() if name not in without}
    return Learning({"x": row("X", "x", outcome="refused"), **there}, 10.0, silent).prior("x", kind)


def test_each_other_device_counts_once_and_only_what_is_good() -> None:
    found = prior_of()
    assert found is not None and (found.devices, found.recordings) == (5, 5)
    again = prior_of(more=row("D1", "d1b"))
    assert again is not None and (again.devices, again.recordings) == (5, 6)
    for bad in (
        row("N", "n", outcome="already_good"),
        row("N", "n", change="step"),
        row("N", "n", calibration_error_high_mg=10.0),
        row("N", "n", lsb_per_g=128.0),
        row("N", "n", range_g=16.0),
        row("N", "n", device_model="M2"),
        row(None, "n"),
        row("N", "d1"),
        row("N", "x"),
        row("X", "n"),
    ):
        assert prior_of(bad=bad) == found


def test_four_devices_are_too_few_and_a_recording_teaches_itself_nothing() -> None:
    assert prior_of(d4=row("D4", "d4", outcome="refused")) is None
    assert prior_of(d4=row("X", "x2")) is None
    found = prior_of()
    assert prior_of(x=row("X", "x", 0.2)) == found


def test_offsets_are_brought_to_one_temperature() -> None:
    """A slope of 1 mg per degree: 30 mg at 25 degrees are 35 mg at the others' 30."""
    slopes = dict.fromkeys(PARAMETERS[9:], 0.001)
    slopes |= {f"se_{name}": 1e-5 for name in PARAMETERS[9:]}
    warm = {
        f"d{number}": row(f"D{number}", f"d{number}", 0.035, reference_c=30.0, **slopes)
        for number in range(5)
    }
    cool = {**warm, "d1": row("D1", "d1", 0.03, reference_c=25.0, **slopes)}
    found, same = prior_of(**cool), prior_of(**warm)
    assert found is not None and same is not None
    assert found.prior.reference_c == 30.0
    assert found.prior.centre == pytest.approx(same.prior.centre, abs=2e-5)
    assert found.prior.centre[9] == pytest.approx(0.001, rel=0.05)


def test_a_device_is_known_by_its_nearest_recordings() -> None:
    """Of 20 mg the day before and 50 mg two years before, beside five devices of 30 mg."""
    past = {
        "near": row("X", "near", 0.02, start_time="2024-03-03T00:00:00"),
        "old": row("X", "old", 0.05, start_time="2022-03-03T00:00:00"),
    }
    found, model = prior_of("device", **past), prior_of()
    assert found is not None and model is not None
    assert (found.kind, [one.name for one in found.own]) == ("device", ["near", "old"])
    assert abs(found.prior.centre[6] - 0.02) < 0.006 and found.prior.width[6] < model.prior.width[6]
    alone = Learning({"x": row("X", "x"), "near": past["near"]}, 10.0).prior("x", "device")
    assert alone is not None and (alone.devices, alone.sha256) == (0, None)
    assert abs(alone.prior.centre[6] - 0.02) < 0.001
    assert Learning({"x": row("X", "x")}, 10.0).prior("x", "device") is None
    nameless = {name: one | {"device_model": None} for name, one in past.items()}
    assert Learning({"x": row("X", "x", device_model=None), **nameless}, 10.0).prior("x", "study") is None
    nobody = {"x": row(None, "x"), "near": row(None, "near")}
    assert Learning(nobody, 10.0).prior("x", "device") is None
