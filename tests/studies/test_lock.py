"""One run at a time: living, dead and foreign owners of the lock."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from accelcal_cli.core.errors import LockedError, OutputError
from accelcal_cli.studies import lock
from accelcal_cli.studies.lock import locked

NO_PROCESS = (b"-1", b"0", b"true", b"1e3", b"9999999999999")


def write(path: Path, **changed: object) -> Path:
    path.write_text(json.dumps({**json.loads(lock.this_run()), **changed}))
    return path


@pytest.fixture
def dead() -> int:
    """The number of a process that is gone."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_a_lock_says_who_holds_it_and_goes_with_the_block(tmp_path: Path) -> None:
    path = tmp_path / "study.lock"
    with locked(path):
        assert json.loads(path.read_text())["pid"] == os.getpid()
        with pytest.raises(LockedError, match=f"process {os.getpid()} on"), locked(path):
            pass
        assert path.exists()
    assert list(tmp_path.iterdir()) == []


def test_it_goes_when_the_block_fails(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), locked(tmp_path / "study.lock"):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_the_lock_of_a_dead_process_is_taken_over(tmp_path: Path, dead: int) -> None:
    path = write(tmp_path / "study.lock", pid=dead)
    with locked(path):
        assert json.loads(path.read_text())["pid"] == os.getpid()
    assert not path.exists()


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_a_number_that_was_given_again_is_not_taken_for_its_owner(tmp_path: Path) -> None:
    with locked(write(tmp_path / "study.lock", started="another time")):
        pass


@pytest.mark.parametrize(
    ("name", "options"), [("study.lock", "--unlock"), ("study.2-of-8.lock", "--shard 2/8 --unlock")]
)
def test_another_hosts_lock_is_respected(name: str, options: str, tmp_path: Path, dead: int) -> None:
    path = write(tmp_path / name, host="elsewhere", pid=dead)
    with (
        pytest.raises(
            LockedError,
            match=rf"on elsewhere.*; if it is no longer running there, remove its lock with {options}$",
        ),
        locked(path),
    ):
        pass
    assert path.exists()


@pytest.mark.parametrize(
    "text",
    [
        b"", b"{", b'{"host": "x", "pi', b'{"host": "x", "pid": "y"}', b'{"host": "\xff", "pid": 1',
        *(b'{"host": "x", "pid": %b, "started": null, "run": "x"}' % pid for pid in NO_PROCESS),
    ],
)  # fmt: skip
def test_a_lock_without_an_owner_is_stale_after_a_while(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "study.lock"
    path.write_bytes(text)
    with pytest.raises(LockedError, match="another process"), locked(path):
        pass
    os.utime(path, (1, 1))
    with locked(path):
        assert json.loads(path.read_text())["pid"] == os.getpid()


@pytest.mark.parametrize("text", ["my notes", "[]", '{"pid": "x"}', "[" * 100_000])
def test_a_file_that_is_not_a_lock_is_kept(tmp_path: Path, text: str) -> None:
    path = tmp_path / "study.lock"
    path.write_text(text)
    os.utime(path, (1, 1))
    with pytest.raises(OutputError, match=r"study\.lock: was not written by accelcal"), locked(path):
        pass
    assert path.read_text() == text


@pytest.mark.parametrize("kind", ["link", "dangling", "pipe"])
def test_what_is_not_a_plain_file_is_neither_followed_nor_waited_for(tmp_path: Path, kind: str) -> None:
    path, target = tmp_path / "study.lock", tmp_path / "somebody else's"
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(target)
    if kind == "link":
        target.write_text("")
        os.utime(target, (1, 1))
    with pytest.raises(OutputError, match=r"study\.lock: is not a plain file"), locked(path):
        pass
    assert not target.exists() or target.read_text() == ""


def test_of_two_that_find_it_stale_one_removes_it(tmp_path: Path, dead: int) -> None:
    path = write(tmp_path / "study.lock", pid=dead)
    ended, others = lock.read_lock(path), lock.this_run()
    assert ended is not None
    assert lock.remove(path, ended.text)
    assert not lock.remove(path, ended.text)
    path.write_text(others)
    assert not lock.remove(path, ended.text)
    assert path.read_text() == others


def test_others_locks_count(tmp_path: Path, dead: int) -> None:
    living, gone = write(tmp_path / "a.lock"), write(tmp_path / "b.lock", pid=dead)
    with pytest.raises(LockedError), locked(tmp_path / "study.lock", lambda: (gone, living)):
        pass
    assert not (tmp_path / "study.lock").exists()
    with locked(tmp_path / "study.lock", lambda: (gone,)):
        pass


def test_a_lock_that_cannot_be_read_is_said(tmp_path: Path) -> None:
    folder = tmp_path / "study.1-of-2.lock"
    folder.mkdir()
    with (
        pytest.raises(OutputError, match=r"study\.1-of-2\.lock: "),
        locked(tmp_path / "study.lock", lambda: (folder,)),
    ):
        pass
    assert list(tmp_path.iterdir()) == [folder]


def test_a_disk_without_links_is_served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_paths: object) -> None:
        raise PermissionError

    monkeypatch.setattr(lock.os, "link", refuse)
    with locked(tmp_path / "study.lock"), pytest.raises(LockedError), locked(tmp_path / "study.lock"):
        pass
    assert list(tmp_path.iterdir()) == []
