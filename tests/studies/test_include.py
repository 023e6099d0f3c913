"""`accelcal study --include`: what is done now, and what stays of what was done before."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.cli.run import run
from tests.cli.studies import NAMES, results, rows, run_in, study, study_folder
from tests.device_recordings import week
from tests.recordings import directions, still_counts, write_raw

POOL = ("--pool", "device")


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three recordings, all done, and one that fails."""
    base = tmp_path_factory.mktemp("include")
    folder = study_folder(base / "in", NAMES)
    (folder / "zeros.cwa").write_bytes(bytes(4096))
    assert run_in(base, "study", folder, "-d", base / "out").code == 1
    return base


def paths(here: Path) -> list[str]:
    return [row["path"] for row in rows(here / "out")]


def test_others_keep_their_rows_and_are_remembered(here: Path) -> None:
    before = results(here / "out")
    ran = study(here / "in", "--include", "a.raw")
    assert (ran.code, [line.split("\t")[0] for line in ran.lines]) == (0, [str(here / "in/north/a.raw")])
    assert ran.err.startswith(
        "accelcal: 4 recordings (4 unchanged): 3 calibrated, 1 failed. 1 other file skipped. Results: "
    )
    assert results(here / "out") == before
    assert "4 unchanged" in study(here / "in").err
    listed = study(here / "in", "--include", "a.raw", "--dry-run").lines
    assert listed == [f"{here / 'in/north/a.raw'}\tcalibrated"]


def test_a_changed_one_waits_until_it_is_asked_for(here: Path) -> None:
    before = results(here / "out")
    write_raw(here / "in" / NAMES[1], still_counts(directions(60), seed=9))
    study(here / "in", "--include", "a.raw")
    assert results(here / "out") == before
    study(here / "in", "--include", "b.raw")
    assert results(here / "out") != before
    assert paths(here) == [*NAMES, "zeros.cwa"]


def test_a_study_may_be_done_in_steps(here: Path) -> None:
    shutil.rmtree(here / "out")
    for name, done in zip(("a.raw", "b.raw"), (NAMES[:1], NAMES[:2]), strict=True):
        assert study(here / "in", "--include", name).code == 0
        assert paths(here) == list(done)
    study(here / "in")
    steps = results(here / "out")
    shutil.rmtree(here / "out")
    study(here / "in")
    assert results(here / "out") == steps


def test_what_is_excluded_or_gone_has_no_row(here: Path) -> None:
    (here / "in" / NAMES[2]).unlink()
    study(here / "in", "--include", "a.raw", "--exclude", "*.cwa")
    assert paths(here) == list(NAMES[:2])


def test_what_was_done_with_other_options_keeps_its_row(here: Path) -> None:
    again = study(here / "in", "--include", "a.raw", "--model", 6)
    assert "4 recordings (3 made with other options): " in again.err
    assert paths(here) == [*NAMES, "zeros.cwa"]
    assert [row["model"] for row in rows(here / "out")] == ["6", "9", "9", ""]
    study(here / "in", "--include", "a.raw")
    assert [row["model"] for row in rows(here / "out")] == ["9", "9", "9", ""]
    assert "4 unchanged" in study(here / "in").err


@pytest.mark.nightly
def test_a_pool_stays_whole(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for number, name in enumerate(("one", "two", "three")):
        week(tmp_path / f"in/{name}.raw", poses=12, seed=number)
    week(tmp_path / "in/other.raw", serial="B2")
    study(tmp_path / "in", *POOL)
    before = results(tmp_path / "out")
    assert "4 unchanged" in study(tmp_path / "in", *POOL, "--include", "other.raw").err
    assert results(tmp_path / "out") == before
    week(tmp_path / "in/four.raw", poses=12, seed=4)
    more = study(tmp_path / "in", *POOL, "--include", "four.raw")
    assert len(more.lines) == 4, "the members of the new pool, but not the other device"
    run("study", tmp_path / "in", "-d", tmp_path / "at once", *POOL)
    assert results(tmp_path / "out") == results(tmp_path / "at once")


@pytest.mark.nightly
def test_collected_without_an_option_a_later_round_is_not_forgotten(tmp_path: Path) -> None:
    """What a plain `--collect` cannot tell of is still known to the next one."""
    (tmp_path / "in").mkdir()
    for name, poses in (("long", 40), ("short", 3)):
        week(tmp_path / f"in/{name}.raw", poses=poses, seed=poses)
    for number in (1, 2):
        study(tmp_path / "in", "--shard", f"{number}/2")
    assert study(tmp_path / "in", "--collect", "--borrow").code == 0
    ran = study(tmp_path / "in", "--collect")
    assert (ran.code, "1 not started" in ran.err) == (1, True)
    pooled = study(tmp_path / "in", *POOL, "--collect")
    assert pooled.err.startswith("accelcal: 2 recordings: 2 calibrated.")
    ran = study(tmp_path / "in", "--collect")
    assert (ran.code, "no results of 2 recordings were found for these options" in ran.err) == (2, True)
    assert list((tmp_path / "out").glob("study.pool.*")), "both were made with it"
    assert "2 unchanged" in study(tmp_path / "in", *POOL, "--collect").err


@pytest.mark.parametrize("words", [(), ("--dry-run",), ("--html",)])
@pytest.mark.parametrize("later", [(), ("--force",), ("--retry-failed",)])
def test_d14_a_file_that_was_left_out_can_be_named(
    later: tuple[str, ...], words: tuple[str, ...], tmp_path: Path
) -> None:
    """It is looked at as a recording, and fails as one; the others keep their rows."""
    folder = study_folder(tmp_path / "in", ("a.raw",))
    (folder / "P2.csv").write_text("name,age,score\n" + "x,3,4\n" * 50)
    assert study(folder, "-q").code == 0
    ran = study(folder, "--include", "P2*", *later, *words)
    assert ran.code == (0 if "--dry-run" in words else 3)
    table = {row["path"]: row["outcome"] for row in rows(tmp_path / "out")}
    assert table == {"a.raw": "calibrated"} | ({} if "--dry-run" in words else {"P2.csv": "failed"})
    assert study(folder, "-q").code == 0
    assert [row["path"] for row in rows(tmp_path / "out")] == ["a.raw"]
