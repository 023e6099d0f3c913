"""`accelcal study` again: what is remembered, looked at, done anew, left to others."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import pytest

from accelcal_cli.studies import lock
from tests.cli.run import run
from tests.cli.studies import NAMES, results, rows, study, study_folder
from tests.recordings import directions, still_counts, write_raw


def times(out: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in out.rglob("*.cal*")}


def test_a_rerun_does_nothing_but_what_changed(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in"), tmp_path / "out"
    first = study(folder)
    made, held = times(out), results(out)
    again = study(folder)
    assert sorted(again.lines) == sorted(first.lines)
    assert "3 unchanged" in again.err
    assert (times(out), results(out)) == (made, held)
    write_raw(folder / NAMES[0], still_counts(directions(60), seed=9))
    assert "2 unchanged" in study(folder).err
    changed = {name for name, at in times(out).items() if made[name] != at}
    assert changed == {"a.calibrated.parquet", "a.calibration.json"}


def test_touched_moved_or_forgotten_is_looked_at_but_not_done_again(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in"), tmp_path / "out"
    study(folder)
    made, held = times(out), results(out)
    os.utime(folder / NAMES[0])
    assert "2 unchanged" in study(folder).err
    (out / "study.ledger").write_text('{"name": "north/a.raw", "sta')
    assert "unchanged" not in study(folder).err
    assert (times(out), results(out)) == (made, held)


def test_a_lost_output_other_settings_and_another_layout_are_done_again(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in"), tmp_path / "out"
    study(folder)
    held = results(out)
    (out / "north/a.calibrated.parquet").unlink()
    study(folder)
    assert results(out) == held
    layout = folder / "north/a.layout.toml"
    layout.write_text(layout.read_text().replace("range_g = 8.0", "range_g = 4.0"))
    assert "2 unchanged" in study(folder).err
    assert "unchanged" not in study(folder, "--model", 6).err
    assert {row["model"] for row in rows(out)} == {"6"}


def test_failures_are_remembered_until_told_otherwise(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in", NAMES[:1])
    (folder / "zeros.cwa").write_bytes(bytes(4096))
    study(folder)
    assert "2 unchanged" in study(folder).err
    assert "1 unchanged" in study(folder, "--retry-failed").err


def test_an_output_in_the_way_is_that_recordings_failure_and_tried_each_time(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in", NAMES[:2]), tmp_path / "out"
    (out / "north").mkdir(parents=True)
    foreign = out / "north/a.calibrated.parquet"
    foreign.write_text("mine")
    assert (study(folder).code, foreign.read_text()) == (1, "mine")
    assert [row["exit_code"] for row in rows(out)] == ["5", "0"]
    foreign.unlink()
    assert study(folder).code == 0


def test_what_is_still_being_copied_waits(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in")
    hour_ago = time.time() - 3600
    os.utime(folder / NAMES[0], (hour_ago, hour_ago))
    assert "1 recording: 1 calibrated, 2 not started" in study(folder, "--settle", 600, code=0).err
    assert "3 recordings" in study(folder, "--newer-than", "2000-01-01").err
    assert "3 unchanged" in study(folder, "--newer-than", "2100-01-01").err


def test_what_is_copied_again_keeps_its_result_until_it_has_settled(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in"), tmp_path / "out"
    assert study(folder).code == 0
    before = (out / "study.csv").read_bytes()
    whole = (folder / NAMES[0]).read_bytes()
    (folder / NAMES[0]).write_bytes(whole[:100])
    assert (study(folder, "--settle", 600).code, (out / "study.csv").read_bytes()) == (0, before)
    (folder / NAMES[0]).write_bytes(whole)
    assert study(folder).code == 0
    assert (out / "study.csv").read_bytes() == before


def test_a_living_run_is_not_disturbed(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in", NAMES[:1]), tmp_path / "out"
    out.mkdir()
    (out / "study.lock").write_text(lock.this_run())
    ran = study(folder, "-q")
    assert (ran.code, ran.out, ran.err.count("\n")) == (75, "", 1)
    assert f"process {os.getpid()} on " in ran.err
    assert [path.name for path in out.iterdir()] == ["study.lock"]
    assert study(folder, "--dry-run").lines == [f"{folder / NAMES[0]}\ttodo"]


@pytest.mark.parametrize(("shard", "name"), [((), "study.lock"), (("--shard", "1/2"), "study.1-of-2.lock")])
def test_a_lock_is_removed_if_someone_says_so(tmp_path: Path, shard: tuple[str, ...], name: str) -> None:
    folder, out = study_folder(tmp_path / "in", NAMES[:1]), tmp_path / "out"
    out.mkdir()
    (out / name).write_text(json.dumps({"host": "elsewhere", "pid": 7, "run": "x"}))
    assert study(folder, *shard).code == 75
    ran = study(folder, *shard, "--unlock")
    assert (ran.code, ran.out) == (0, "")
    assert ran.err == f"accelcal: {out / name}: removed the lock of process 7 on elsewhere\n"
    assert list(out.iterdir()) == []
    ran = study(folder, *shard, "--unlock")
    assert (ran.code, ran.err) == (0, f"accelcal: {out / name}: there is no lock\n")
    (out / name).write_text("my notes")
    assert study(folder, *shard, "--unlock").code == 5
    assert (out / name).read_text() == "my notes"


def test_shards_are_disjoint_and_collected_they_are_the_whole(tmp_path: Path) -> None:
    names = tuple(f"{letter}.raw" for letter in "abcd")
    folder, out = study_folder(tmp_path / "in", names), tmp_path / "out"
    first = study(folder, "--shard", "1/2")
    early = study(folder, "--collect", code=1)
    assert "not started" in early.err
    second = study(folder, "--shard", "2/2")
    done = [[line.split("\t")[0] for line in ran.lines] for ran in (first, second)]
    assert sorted([*done[0], *done[1]]) == [str(folder / name) for name in names]
    assert all(done)
    assert study(folder, "--collect").code == 0
    run("study", folder, "-d", tmp_path / "whole")
    whole, parts = results(tmp_path / "whole"), results(out)
    assert {name: content for name, content in parts.items() if "-of-" not in name} == whole


def test_nothing_to_collect_leaves_the_table_as_it_is(tmp_path: Path) -> None:
    """The parts were made with another option: an empty table would take the place of theirs."""
    folder, out = study_folder(tmp_path / "in", ("a.raw", "b.raw")), tmp_path / "out"
    study(folder, "--report-only")
    held = (out / "study.csv").read_bytes()
    ran = study(folder, "--collect")
    assert (ran.code, (out / "study.csv").read_bytes()) == (2, held)
    assert "no results of 2 recordings were found for these options; run the parts first, or" in ran.err
    assert study(folder, "--collect", "--report-only").code == 0


def test_with_q_only_what_is_new_is_said_and_decides_the_exit_code(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in")
    short = write_raw(folder / "short.raw", still_counts(directions(1)))
    first = study(folder, "-q")
    assert first.code == 1 and str(short) in first.err
    nothing_new = study(folder, "-q")
    assert (nothing_new.code, nothing_new.out, nothing_new.err) == (0, "", "")
    everything = study(folder, "-q", "--all-failures")
    assert (everything.code, everything.err) == (1, first.err)
    assert study(folder).code == 1, "without -q all recordings count"
    other = write_raw(folder / "other.raw", still_counts(directions(60)[:1]))
    news = study(folder, "-q")
    assert news.code == 1 and str(other) in news.err and str(short) not in news.err
