"""`accelcal study --pool device`: several short recordings of one device calibrated as one."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.cli.studies import results, rows, run_in
from tests.device_recordings import rest, write_device
from tests.recordings import directions
from tests.studies.borrowing import report
from tests.studies.pooling import pool_of, study
from tests.studies.processes import killed_after

PARTS = {"a/one": 0, "a/two": 7, "b/three": 13, "b/four": 19}
"""Recordings of device A1, and the first pose of each; 26 poses in all."""

ENDS = (7, 13, 19, 26)
ALONE = ("lone", "nobody1", "nobody2", "coarse", "few1", "few2")


def part(values: np.ndarray, heat: np.ndarray, first: int, end: int) -> tuple[np.ndarray, np.ndarray]:
    """What was recorded from a pose to another."""
    at = slice(first * 750, end * 750)
    return values[at], heat[at]


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """In `in` device A1 in four parts, and recordings that belong to no pool; `out` is pooled.

    `whole.raw` holds the four parts one after another.
    """
    base = tmp_path_factory.mktemp("pool")
    values, heat = rest(directions(26), seed=3, warm=True)
    write_device(base / "whole.raw", values, heat)
    for (name, first), end in zip(PARTS.items(), ENDS, strict=True):
        (base / "in" / name).parent.mkdir(parents=True, exist_ok=True)
        write_device(base / f"in/{name}.raw", *part(values, heat, first, end))
    for number, (name, said) in enumerate(
        {
            "lone": {"serial": "B2"},
            "nobody1": {"serial": None},
            "nobody2": {"serial": None},
            "coarse": {"lsb_per_g": 128.0},
            "few1": {"serial": "C3"},
            "few2": {"serial": "C3"},
        }.items()
    ):
        write_device(base / f"in/{name}.raw", *part(values, heat, 4 * number, 4 * number + 3), **said)
    assert study(base).code == 1
    assert study(base, out="plain", pool=False).code == 1
    return base


def test_a_pool_is_what_one_long_recording_would_be(base: Path) -> None:
    """Windows end where poses do, so that the long recording has the very windows of its four parts."""
    assert run_in(base, "calibrate", base / "whole.raw", "-d", base / "alone", "--prior", "none").code == 0
    whole, made = report(base / "alone", "whole"), pool_of(base / "out")
    whole["coverage"]["subsets_full_after_h"] = None  # a pool has no time of its own
    for name in (
        "outcome", "message", "calibration", "without_misalignment", "holdout", "coverage", "models_tried",
    ):  # fmt: skip
        assert made[name] == whole[name]
    assert made["calibration"]["model"] == "9T"
    assert {**made["fit"], "windows": 0} == {**whole["fit"], "windows": 0}
    windows = {name: n for name, n in whole["fit"]["windows"].items() if name != "raw_error_mg"}
    assert windows == {name: n for name, n in made["fit"]["windows"].items() if name != "raw_error_mg"}
    assert (made["recording"]["samples"], made["recording"]["format"]) == (26 * 750, "pool")


def test_each_recording_gets_its_coefficients_and_says_what_they_do_to_its_own_windows(base: Path) -> None:
    out = base / "out"
    made = pool_of(out)
    held = [{"path": f"in/{name}.raw", "sha256": report(out, name)["recording"]["sha256"]} for name in PARTS]
    assert made["pool"]["serial"] == "A1"
    assert sorted(made["pool"]["recordings"], key=str) == sorted(held, key=str)
    for name in PARTS:
        found = report(out, name)
        assert report(base / "plain", name)["outcome"] == "refused"
        assert found["outcome"] == "calibrated"
        assert made["without_misalignment"]["calibration"]["model"] == "6T"
        for section in (
            "calibration", "without_misalignment", "holdout", "fit", "coverage", "models_tried",
        ):  # fmt: skip
            assert found[section] == made[section]
        assert found["pool"]["recordings"] == made["pool"]["recordings"]
        assert (out / name).parent.joinpath(found["pool"]["path"]).resolve().parent == out
        assert (out / f"{name}.calibrated.parquet").exists()


def test_what_cannot_be_pooled_keeps_its_own_result(base: Path) -> None:
    """One recording of a device, unknown devices, other counts per g, and a pool of too few postures."""
    table = {row["path"]: row for row in rows(base / "out")}
    plain = {row["path"]: row for row in rows(base / "plain")}
    for name in ALONE:
        assert table[f"{name}.raw"] == plain[f"{name}.raw"]
        own, found = report(base / "plain", name), report(base / "out", name)
        assert {**own, "provenance": 0} == {**found, "provenance": 0}
    counts = json.loads((base / "out/study.json").read_text())
    outcomes = {pool["device_serial"]: pool["outcome"] for pool in counts["pools"].values()}
    assert outcomes == {"A1": "calibrated", "C3": "refused"}
    assert study(base, "-q").err == ""  # it was said in the first run
    again = study(base, "-q", "--all-failures").err
    assert "recordings of device C3 are not pooled: The device was still in only" in again


def test_order_and_workers_make_no_difference_and_a_rerun_does_nothing(base: Path, here: Path) -> None:
    study(here, out="other", jobs=1)
    assert results(here / "other") == results(base / "out")
    held = {path: path.stat().st_mtime_ns for path in here.rglob("out/**/*.cal*")}
    assert "10 unchanged" in study(here).err
    states = [line.split("\t")[1] for line in study(here, "--dry-run").lines]
    assert states == ["calibrated"] * 4 + ["refused"] * 6
    (here / "in/b/four.raw").unlink()
    states = [line.split("\t")[1] for line in study(here, "--dry-run").lines]
    assert states == ["todo"] * 3 + ["refused"] * 6
    assert {path: path.stat().st_mtime_ns for path in here.rglob("out/**/*.cal*")} == held


@pytest.mark.nightly
def test_collected_shards_are_the_same(base: Path, here: Path) -> None:
    for number in (2, 1):
        assert "calibrated" not in study(here, "--shard", f"{number}/2", out="parts").out
    assert study(here, "--collect", out="parts").code == 1
    found = {name: held for name, held in results(here / "parts").items() if "-of-" not in name}
    assert found == results(base / "out")
    owned = len(rows(here / "parts", "study.1-of-2"))
    assert f"{owned} unchanged" in study(here, "--shard", "1/2", out="parts").err
    assert "10 unchanged" in study(here, "--collect", out="parts").err


@pytest.mark.nightly
def test_another_member_makes_another_pool_and_without_pooling_it_goes_back(base: Path, here: Path) -> None:
    (here / "in/b/four.raw").unlink()
    assert "6 unchanged" in study(here).err
    assert len(pool_of(here / "out")["pool"]["recordings"]) == 3
    shutil.copy2(base / "in/b/four.raw", here / "in/b/four.raw")
    study(here)
    assert results(here / "out") == results(base / "out")
    assert "6 unchanged" in study(here, pool=False).err
    assert results(here / "out") == results(base / "plain")


def test_with_borrowing_what_is_left_borrows_from_the_pool(here: Path) -> None:
    study(here, "--borrow")
    table = {row["path"]: row for row in rows(here / "out")}
    assert table["coarse.raw"]["outcome"] == "borrowed"
    assert table["coarse.raw"]["borrowed_from"] in {f"{name}.raw" for name in PARTS}
    assert report(here / "out", "coarse")["calibration"] == pool_of(here / "out")["calibration"]
    assert "10 unchanged" in study(here, "--borrow").err
    for name in ("coarse", "a/one"):
        ran = run_in(here, "verify", "--values", here / f"out/{name}.calibration.json", f"in/{name}.raw")
        assert (ran.code, ran.lines[0].split("\t")[1]) == (0, "identical")


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
@pytest.mark.nightly
@pytest.mark.parametrize("after", [10, 11, 12, 13, 15])
def test_killed_at_any_moment_a_rerun_ends_as_if_nothing_had_been(base: Path, here: Path, after: int) -> None:
    """After so many lines of the ledger: ten own results, two pools, four members."""
    killed_after(here, after, "--pool", "device")
    study(here)
    assert results(here / "out") == results(base / "out")


def test_profile_paper_has_no_cells(here: Path) -> None:
    assert study(here, "--profile", "paper").code == 2


@pytest.mark.nightly
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
def test_with_a_cluster_the_bytes_are_the_same(here: Path, scheduler: Path) -> None:
    pytest.importorskip("distributed")
    for _ in range(2):
        ran = study(here, "--borrow", "--dask", scheduler, out="there")
    assert "10 unchanged" in ran.err
    study(here, "--borrow", out="local")
    assert results(here / "there") == results(here / "local")
