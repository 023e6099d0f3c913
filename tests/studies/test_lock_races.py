"""Two runs on one folder: a lock in any order of operations, and what a run does whose lock is not its own.

Links, exclusive creation and answers behave as on NFS.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.core.errors import LockedError
from accelcal_cli.output import files
from accelcal_cli.studies import lock
from accelcal_cli.studies.lock import Lease, locked
from tests.cli.run import nightly

Patch = pytest.MonkeyPatch


def ended(path: Path) -> str:
    """The content of a lock of a process that is gone."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    path.write_text(json.dumps({**json.loads(lock.this_run()), "pid": process.pid}))
    return path.read_text()


@pytest.mark.parametrize("error", [FileExistsError(), OSError(5, "lost")])
def test_a_link_whose_answer_is_lost_is_a_link(tmp_path: Path, monkeypatch: Patch, error: OSError) -> None:
    """The server made it, the client asked again, or was told of a failure (open(2), on O_EXCL and NFS)."""
    link, path = os.link, tmp_path / "study.lock"

    def made_and_failed(source: Path, target: Path) -> None:
        link(source, target)
        raise error

    monkeypatch.setattr(lock.os, "link", made_and_failed)
    with locked(path) as lease:
        lease.confirm()
        with pytest.raises(LockedError), locked(path):
            pass
    assert list(tmp_path.iterdir()) == []


def test_where_links_work_nothing_depends_on_exclusive_creation(tmp_path: Path, monkeypatch: Patch) -> None:
    """As on NFS of version 2, where O_EXCL is none: only names that no one else has are created so."""
    created: list[str] = []
    real = os.open

    def not_exclusive(path: Any, flags: int, *more: Any, **named: Any) -> int:
        if flags & os.O_EXCL:
            created.append(Path(path).name)
        return real(path, flags & ~os.O_EXCL, *more, **named)

    plain = Path.open

    def noted(self: Path, mode: str = "r", *more: Any, **named: Any) -> Any:
        created.extend([self.name] * ("x" in mode))
        return plain(self, mode, *more, **named)

    monkeypatch.setattr(files.os, "open", not_exclusive)
    monkeypatch.setattr(Path, "open", noted)
    with locked(tmp_path / "study.lock"), pytest.raises(LockedError), locked(tmp_path / "study.lock"):
        pass
    assert created
    assert all(name.endswith(".tmp") and str(os.getpid()) in name for name in created)


def test_without_links_and_exclusive_creation_the_first_has_lost(tmp_path: Path, monkeypatch: Patch) -> None:
    path, real = tmp_path / "study.lock", Path.open

    def refuse(*_paths: object) -> None:
        raise PermissionError

    def not_exclusive(self: Path, mode: str = "r", *more: Any, **named: Any) -> Any:
        return real(self, mode.replace("x", "w"), *more, **named)

    monkeypatch.setattr(lock.os, "link", refuse)
    monkeypatch.setattr(Path, "open", not_exclusive)
    with locked(path) as first, locked(path) as second:
        second.confirm()
        with pytest.raises(LockedError, match=f"was taken over by process {os.getpid()} on "):
            first.confirm()


def test_a_run_whose_lock_was_removed_leaves_the_others(tmp_path: Path, monkeypatch: Patch) -> None:
    path = tmp_path / "study.lock"
    with locked(path) as lease:
        lease.confirm()
        monkeypatch.setattr(lock, "host", lambda: "there")
        assert lock.remove(path, lease.text)
        with locked(path) as other:
            with pytest.raises(LockedError, match=f"was taken over by process {os.getpid()} on there"):
                lease.confirm()
            other.confirm()
            assert json.loads(path.read_text())["host"] == "there"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", [None, "somebody's notes"])
def test_a_lock_that_is_gone_is_lost(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "study.lock"
    with locked(path) as lease:
        path.unlink()
        if text is not None:
            path.write_text(text)
        with pytest.raises(LockedError, match=r"study\.lock: the lock of this run was re(moved|placed)"):
            lease.confirm()
    assert path.exists() == (text is not None)


def test_a_disk_that_does_not_answer_loses_no_lock(tmp_path: Path, monkeypatch: Patch) -> None:
    def unreadable(*_words: object) -> None:
        raise OSError(5, "Input/output error")

    with locked(tmp_path / "study.lock") as lease:
        with Patch.context() as patch:
            patch.setattr(lock, "open_plain", unreadable)
            lease.confirm()
        lease.confirm()


class Turns:
    """Threads of which one at a time does one operation on files, in an order that chance chooses."""

    def __init__(self, monkeypatch: Patch, chance: random.Random) -> None:
        self.chance = chance
        self.waiting: dict[threading.Thread, threading.Event] = {}
        self.back = threading.Event()
        for owner, name in ((lock.os, "link"), (lock, "open_plain"), (lock, "discard")):
            monkeypatch.setattr(owner, name, self.stepped(getattr(owner, name)))
        for name in ("replace", "unlink"):
            monkeypatch.setattr(Path, name, self.stepped(getattr(Path, name)))

    def stepped(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def step(*words: Any, **named: Any) -> Any:
            mine = self.waiting.get(threading.current_thread())
            if mine is not None:
                self.back.set()
                mine.wait()
                mine.clear()
            return call(*words, **named)

        return step

    def run(self, *works: Callable[[], object]) -> list[object]:
        """What each returns."""
        results: list[object] = [None] * len(works)

        def act(number: int) -> None:
            mine = self.waiting[threading.current_thread()]
            mine.wait()
            mine.clear()
            results[number] = works[number]()
            del self.waiting[threading.current_thread()]
            self.back.set()

        threads = [threading.Thread(target=act, args=(number,)) for number in range(len(works))]
        self.waiting = {thread: threading.Event() for thread in threads}
        for thread in threads:
            thread.start()
        while self.waiting:
            self.back.clear()
            self.chance.choice(list(self.waiting.values())).set()
            assert self.back.wait(60)
        return results


@pytest.mark.parametrize(("first", "last"), [(0, 60), nightly(60, 3000)])
def test_in_any_order_of_operations_one_at_most_has_the_lock(tmp_path: Path, first: int, last: int) -> None:
    """Of three that come while a run that has ended is removed."""
    gone = ended(tmp_path / "gone")
    for seed in range(first, last):
        (folder := tmp_path / str(seed)).mkdir()
        race(folder / "study.lock", gone, random.Random(seed))


def race(path: Path, gone: str, chance: random.Random) -> None:
    """One at least of the three gets the lock, and one at most has it in the end."""
    path.write_text(gone)

    def enter() -> Lease | None:
        try:
            return stack.enter_context(locked(path))
        except LockedError:
            return None

    with Patch.context() as patch, contextlib.ExitStack() as stack:
        results = Turns(patch, chance).run(enter, enter, lambda: lock.remove(path, gone), enter)
        leases = [one for one in results if isinstance(one, Lease)]
        assert sum(has_it(one) for one in leases) <= 1, path
        assert leases, path


def has_it(lease: Lease) -> bool:
    try:
        lease.confirm()
    except LockedError:
        return False
    return True


def test_a_lock_that_is_another_s_by_now_is_put_back(tmp_path: Path, monkeypatch: Patch) -> None:
    path, other = tmp_path / "study.lock", lock.this_run()
    gone, replace = ended(path), Path.replace

    def faster(self: Path, target: Path) -> Path:
        self.write_text(other)
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", faster)
    assert not lock.remove(path, gone)
    assert path.read_text() == other
    assert list(tmp_path.iterdir()) == [path]
