"""Issue 50, item 6: the story of a night can be read in the log of a run, whatever happens to either."""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import time
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli import run_log
from accelcal_cli.core.version import __version__
from tests.cli.run import Ran, command, run
from tests.recordings import directions, still_counts, write_raw

LINE = re.compile(r"(\S+) \[(\d+)\] (.*)")
SECONDS = re.compile(r"\d+\.\d s")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "in").mkdir()
    write_raw(tmp_path / "in" / "good.raw", still_counts(directions(60)))
    (tmp_path / "in" / "bad.cwa").write_bytes(b"not a recording" * 100)
    return tmp_path / "in"


def study(folder: Path, *words: object, log: str = "night.log") -> Ran:
    more = ("--log", folder.parent / log)
    return run("study", folder, "-d", folder.parent / "out", "-j", 1, "--report-only", *more, *words)


def story(path: Path) -> list[str]:
    """What the lines say, after a check of their times and processes."""
    texts, before = [], None
    for line in filter(None, path.read_text("utf-8").splitlines()):
        found = LINE.fullmatch(line)
        assert found is not None, line
        moment = datetime.fromisoformat(found[1])
        assert moment.utcoffset() is not None and (before is None or moment >= before)
        assert int(found[2]) == os.getpid()
        before = moment
        texts.append(SECONDS.sub("N s", found[3]))
    return texts


def test_50_6_the_story_of_a_night(folder: Path) -> None:
    assert study(folder, "-q").code == 1
    told = story(folder.parent / "night.log")
    assert re.fullmatch(rf"begins: accelcal {re.escape(__version__)} on \S+: accelcal study .* -q", told[0])
    assert told[1] == "planned: 2 to do, 0 done, 0 waiting, 0 left out"
    assert (
        told[2].startswith("begun: good.raw (")
        and "ended: good.raw: calibrated, exit code 0 after N s" in told
    )
    at = told.index("ended: bad.cwa: failed, exit code 3 after N s")
    assert told[at + 1].startswith("why: bad.cwa: unreadable: ")
    assert told[-2:] == ['outcomes: {"calibrated": 1, "failed": 1}; unchanged: 0', "ends with exit code 1"]
    study(folder, "-q")
    again = story(folder.parent / "night.log")
    assert again[: len(told)] == told
    assert again[len(told) + 1] == "planned: 0 to do, 2 done, 0 waiting, 0 left out"
    assert again[-1] == "ends with exit code 0"


def test_50_6_notes_are_logged_each_time_and_said_once_by_a_quiet_run(folder: Path) -> None:
    (folder.parent / "out").mkdir()
    (folder.parent / "out" / "decisions.csv").write_text("recording,use\ngone.raw,no\n")
    assert "gone.raw" in study(folder, "-q").err
    assert "gone.raw" not in study(folder, "-q").err
    told = story(folder.parent / "night.log")
    said = "decisions.csv: Row 2 names gone.raw, which is not a recording of the study."
    assert sum(said in one for one in told) == 2


def test_50_6_how_a_run_ended_is_logged_when_it_could_not_begin(folder: Path) -> None:
    (folder.parent / "out").mkdir()
    (folder.parent / "out" / "study.csv").write_text("mine\n")
    assert study(folder).code == 5
    assert story(folder.parent / "night.log")[-1].startswith("ends with exit code 5: ")


def test_50_6_without_the_option_there_is_no_log(folder: Path) -> None:
    run("study", folder, "-d", folder.parent / "out", "-j", 1, "--report-only", "-q")
    assert not list(folder.parent.rglob("*.log"))
    assert run_log.LOG.handlers == []


@pytest.mark.parametrize("content", [b"time,x,y,z\n0,1,2,3\n", b"\x00\x01" * 400, b"2026-11-27 night\n"])
def test_50_6_nothing_is_added_to_a_file_that_is_no_log(folder: Path, content: bytes) -> None:
    path = folder.parent / "night.log"
    path.write_bytes(content)
    ran = study(folder)
    assert (ran.code, len(ran.err.splitlines())) == (2, 1)
    assert "is not a log of accelcal" in ran.err
    assert path.read_bytes() == content


def test_50_6_a_log_in_the_folder_of_recordings_is_none(folder: Path) -> None:
    for _ in range(2):
        study(folder, "-q", log="in/night.log")
    table = (folder.parent / "out" / "study.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in table] == ["path", "bad.cwa", "good.raw"]


@pytest.mark.parametrize("log", ["nowhere/night.log", "in"])
def test_50_6_a_log_that_cannot_be_written_is_said_once(folder: Path, log: str) -> None:
    (folder / "bad.cwa").unlink()
    ran = study(folder, "-q", log=log)
    if log == "in":
        assert (ran.code, len(ran.err.splitlines())) == (5, 1)
        return
    assert (ran.code, ran.err.count("the log cannot be written")) == (0, 1)
    assert len(ran.err.splitlines()) == 1


def test_50_6_a_full_disk_costs_lines_of_the_log_alone(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second line is cut short, the third fails, and the others are whole."""
    (folder / "bad.cwa").unlink()
    written, number = os.write, 0

    def full(handle: int, data: bytes) -> int:
        nonlocal number
        number += b"] " in data
        if b"] planned" in data:
            return written(handle, data[:20])
        if b"] begun" in data:
            raise OSError(errno.ENOSPC, "No space left on device")
        return written(handle, data)

    monkeypatch.setattr(run_log.os, "write", full)
    ran = study(folder, "-q")
    assert (ran.code, ran.err.count("the log cannot be written (no space left)")) == (0, 1)
    lines = [line for line in (folder.parent / "night.log").read_text().splitlines() if line]
    assert len(lines) == number - 1
    assert sum(LINE.fullmatch(line) is None for line in lines) == 1
    assert lines[-1].endswith("ends with exit code 0")


def test_50_6_a_killed_run_leaves_whole_lines_and_the_next_begins_its_own(folder: Path) -> None:
    (folder / "bad.cwa").unlink()
    log = folder.parent / "night.log"
    words: list[Any] = ["study", folder, "-d", folder.parent / "out", "-j", 1, "--log", log]
    process = subprocess.Popen(command(*words), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    until = time.monotonic() + 120
    while not (log.exists() and b"begun" in log.read_bytes()) and time.monotonic() < until:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    held = log.read_bytes()
    assert b"begun: good.raw" in held and all(LINE.fullmatch(line) for line in held.decode().splitlines())
    log.write_bytes(held[:-7])
    ran = study(folder, "-q", "--unlock") if (folder.parent / "out/study.lock").exists() else None
    assert ran is None or ran.code == 0
    assert study(folder, "-q").code == 0
    lines = [line for line in log.read_text().splitlines() if line]
    assert sum(LINE.fullmatch(line) is not None for line in lines) >= len(lines) - 1
    assert lines[-1].endswith("ends with exit code 0")
