"""Borrowing again: what is done anew when a device's recordings change, and after a kill."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.run import Ran
from tests.cli.studies import results, rows, study_in
from tests.device_recordings import week
from tests.studies.borrowing import report
from tests.studies.processes import killed_after

LONG = {"a/far.raw": "2024-01-01", "a/near.raw": "2024-03-01", "b/late.raw": "2024-06-01"}
SHORT = ("a/short1.raw", "a/short2.raw", "b/short3.raw")
POOR = "b/poor.raw"
BORROWERS = (*SHORT, POOR)


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study that is done: of device A1 three good recordings, three of three poses each, and a poor one.

    It lies in `in` and `out`, named from their folder, so that a copy of all is the same study.
    """
    base = tmp_path_factory.mktemp("base")
    for number, (name, day) in enumerate(LONG.items()):
        write(base / "in" / name, day, poses=40, seed=number + 1)
    for number, name in enumerate(SHORT):
        write(base / "in" / name, "2024-03-04", poses=3, seed=number + 11)
    write(base / "in" / POOR, "2024-03-05", poses=11, seed=21)
    write(base / "in/b/other.raw", "2024-03-05", poses=3, seed=22, serial="B2")
    assert study(base).code == 1
    return base


def study(here: Path, *words: object, out: str = "out", borrow: bool = True) -> Ran:
    return study_in(here, "--prior", "none", *(["--borrow"] if borrow else []), *words, out=out)


def write(path: Path, day: str, **more: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return week(path, start=f"{day}T00:00:00", **more)


def borrowed_from(here: Path) -> dict[str, str]:
    return {row["path"]: row["borrowed_from"] for row in rows(here / "out") if row["borrowed_from"]}


def changed(here: Path, base: Path) -> set[str]:
    """Names of recordings whose outputs were written since."""
    before = {path.relative_to(base): path.stat().st_mtime_ns for path in base.rglob("out/*/*")}
    after = {path.relative_to(here): path.stat().st_mtime_ns for path in here.rglob("out/*/*")}
    return {path.name.split(".")[0] for path in before | after if before.get(path) != after.get(path)}


def test_a_poorer_calibration_gives_way_to_a_better_one(base: Path) -> None:
    out = base / "out"
    assert borrowed_from(base) == dict.fromkeys(BORROWERS, "a/near.raw")
    row = next(row for row in rows(out) if row["path"] == POOR)
    assert row["own_outcome"] == "reduced_model"
    assert float(row["after_mg"]) < 1
    assert float(row["own_after_mg"]) > 5
    assert report(out, "b/poor")["calibration"] == report(out, "a/near")["calibration"]


@pytest.mark.nightly
def test_a_farther_lender_changes_nothing_but_a_nearer_one_is_asked(base: Path, here: Path) -> None:
    write(here / "in/a/farther.raw", "2023-01-01", poses=40, seed=6)
    assert "8 unchanged" in study(here).err
    assert changed(here, base) == {"farther"}
    write(here / "in/b/late.raw", "2024-03-04", poses=40, seed=7)
    assert "4 unchanged" in study(here).err
    assert borrowed_from(here) == dict.fromkeys(BORROWERS, "b/late.raw")
    assert changed(here, base) == {"farther", "late", "short1", "short2", "short3", "poor"}


@pytest.mark.nightly
def test_changed_coefficients_are_applied_again(base: Path, here: Path) -> None:
    write(here / "in/a/near.raw", "2024-03-01", poses=40, seed=8)
    assert "3 unchanged" in study(here).err
    assert changed(here, base) == {"near", "short1", "short2", "short3", "poor"}
    assert report(here / "out", "b/poor")["calibration"] == report(here / "out", "a/near")["calibration"]
    assert report(here / "out", "a/near") != report(base / "out", "a/near")


@pytest.mark.nightly
def test_the_poor_one_lends_when_the_better_ones_are_gone(base: Path, here: Path) -> None:
    study(here, *(word for name in LONG for word in ("--exclude", name)))
    assert report(here / "out", "b/poor")["outcome"] == "reduced_model"
    assert set(borrowed_from(here).values()) == {POOR}
    study(here)
    assert results(here / "out") == results(base / "out")


@pytest.mark.nightly
@pytest.mark.parametrize(
    "lost", [("study.ledger",), ("a/short1.calibrated.parquet", "a/near.calibration.json")]
)
def test_what_is_lost_comes_back(base: Path, here: Path, lost: tuple[str, ...]) -> None:
    for name in lost:
        (here / "out" / name).unlink()
    study(here)
    assert results(here / "out") == results(base / "out")
    assert "8 unchanged" in study(here).err


@pytest.mark.nightly
def test_what_stands_in_the_way_leaves_the_own_result_and_is_tried_again(base: Path, here: Path) -> None:
    study(here, borrow=False, out="late")
    foreign = here / "late/a/short1.calibrated.parquet"
    foreign.write_text("mine")
    assert study(here, out="late").code == 1
    row = next(row for row in rows(here / "late") if row["path"] == SHORT[0])
    assert (row["outcome"], foreign.read_text()) == ("refused", "mine")
    assert "was not written by accelcal" in row["message"]
    foreign.unlink()
    assert "7 unchanged" in study(here, out="late").err
    assert results(here / "late") == results(base / "out")


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
@pytest.mark.nightly
@pytest.mark.parametrize("after", [1, 5, 8, 9, 10, 11])
def test_killed_at_any_moment_a_rerun_ends_as_if_nothing_had_been(base: Path, here: Path, after: int) -> None:
    """After so many lines of the ledger: the own results are eight, the borrowed ones four."""
    killed_after(here, after, "--borrow")
    assert study(here).code == 1
    assert results(here / "out") == results(base / "out")


def test_a_lender_that_waits_lends_as_before(here: Path) -> None:
    before = rows(here / "out")
    for name in LONG:
        (here / "in" / name).touch()
    study(here, "--settle", 3600)
    assert rows(here / "out") == before
