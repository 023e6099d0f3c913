"""Two machines on one folder: signs of life, silence, and what a run does whose lock is no longer its own."""

from __future__ import annotations

import contextlib
import json
import os
import random
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.core.errors import LockedError
from accelcal_cli.output import files
from accelcal_cli.studies import lock
from accelcal_cli.studies.lock import LOOK_S, Lease, Patience, locked

SILENCE_S = 120.0
LOOKS = 24
Patch = pytest.MonkeyPatch


class Night:
    """Passes as soon as somebody sleeps; what happens meanwhile is in a list, one call for each sleep.

    Attributes:
        slept: how often somebody slept.
    """

    def __init__(self) -> None:
        self.events: list[Callable[[], object]] = []
        self.slept, self.now_s = 0, 0.0

    def sleep(self, seconds: float) -> None:
        self.slept, self.now_s = self.slept + 1, self.now_s + seconds
        if self.slept <= len(self.events):
            self.events[self.slept - 1]()

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def night(monkeypatch: Patch) -> Night:
    night = Night()
    monkeypatch.setattr(lock, "time", night)
    return night


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def patience(said: list[str]) -> Patience:
    return Patience(SILENCE_S, said.append)


def elsewhere(path: Path, **changed: object) -> dict[str, Any]:
    """A lock of a run of another machine, and what it says."""
    says = {**json.loads(lock.this_run()), "host": "elsewhere", "started": "some time", **changed}
    path.write_text(json.dumps(says))
    return says


def beat(path: Path, number: int) -> None:
    """What the other machine does, whose clock is years off."""
    os.utime(path, (1_000_000 + number, 1_000_000 + number))


def test_a_silent_run_is_taken_over_after_as_many_looks_as_were_asked_for(
    tmp_path: Path, night: Night, patience: Patience, said: list[str]
) -> None:
    path = tmp_path / "study.lock"
    owner = elsewhere(path)
    with locked(path, patience=patience) as lease:
        assert lease.lost == {path: "elsewhere"}
        assert json.loads(path.read_text())["host"] != "elsewhere"
    assert night.slept == LOOKS
    assert night.now_s == SILENCE_S == LOOKS * LOOK_S
    after = f"process {owner['pid']} on elsewhere after 2 minutes without a sign of life"
    assert said == [f"{path} is taken over from {after}"]
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_beats_is_left_alone(tmp_path: Path, night: Night, patience: Patience) -> None:
    path = tmp_path / "study.lock"
    owner = elsewhere(path)
    night.events = [lambda: None, lambda: beat(path, 1), lambda: None, lambda: beat(path, 2)]
    message = "on elsewhere is working in this folder; wait for it to end"
    with pytest.raises(LockedError, match=message), locked(path, patience=patience):
        pass
    assert night.slept == 4
    assert json.loads(path.read_text()) == owner


def test_one_late_beat_is_no_sign_of_life(tmp_path: Path, night: Night, patience: Patience) -> None:
    """A cache may show the last beat of a run that is gone after the first look; the count begins anew."""
    path = tmp_path / "study.lock"
    elsewhere(path)
    night.events = [lambda: None] * 9 + [lambda: beat(path, 1)]
    with locked(path, patience=patience):
        pass
    assert night.slept == 10 + LOOKS


def test_a_run_that_ends_meanwhile_is_not_waited_for(
    tmp_path: Path, night: Night, patience: Patience
) -> None:
    path = tmp_path / "study.lock"
    elsewhere(path)
    night.events = [path.unlink]
    with locked(path, patience=patience) as lease:
        assert lease.lost == {}
    assert night.slept == 1


def test_a_disk_that_hangs_does_not_make_a_run_silent(
    tmp_path: Path, night: Night, patience: Patience
) -> None:
    """An hour in which nothing was seen is one look: the other could not beat either."""
    path = tmp_path / "study.lock"
    elsewhere(path)

    def hang() -> None:
        night.now_s += 3600

    night.events = [hang, lambda: beat(path, 1), lambda: beat(path, 2)]
    with pytest.raises(LockedError), locked(path, patience=patience):
        pass


def test_a_living_run_of_this_machine_is_not_watched(
    tmp_path: Path, night: Night, patience: Patience
) -> None:
    path = tmp_path / "study.lock"
    path.write_text(lock.this_run())
    with pytest.raises(LockedError, match="wait for it to end"), locked(path, patience=patience):
        pass
    assert night.slept == 0


def test_locks_that_exclude_ours_are_watched_together_and_removed(
    tmp_path: Path, night: Night, patience: Patience
) -> None:
    parts = [tmp_path / f"study.{number}-of-3.lock" for number in (1, 2, 3)]
    for path in parts:
        elsewhere(path)
    with locked(tmp_path / "study.lock", lambda: parts, patience) as lease:
        assert lease.lost == dict.fromkeys(parts, "elsewhere")
        assert [path.name for path in tmp_path.iterdir()] == ["study.lock"]
    assert night.slept == LOOKS


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


def test_without_links_and_exclusive_creation_the_first_finds_that_it_lost(
    tmp_path: Path, monkeypatch: Patch
) -> None:
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


def test_a_run_that_comes_back_notices_and_leaves_the_others_lock(
    tmp_path: Path, monkeypatch: Patch, night: Night, patience: Patience
) -> None:
    path = tmp_path / "study.lock"
    with locked(path) as lease:
        lease.confirm()
        monkeypatch.setattr(lock, "host", lambda: "there")
        with locked(path, patience=patience) as other:
            for _ in range(2):
                with pytest.raises(LockedError, match=f"was taken over by process {os.getpid()} on there"):
                    lease.confirm()
            with pytest.raises(LockedError):
                lease.check()
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


def test_who_cannot_see_its_lock_for_a_minute_stops(night: Night, tmp_path: Path, monkeypatch: Patch) -> None:
    def unreadable(*_words: object) -> None:
        raise OSError(5, "Input/output error")

    lease = Lease(tmp_path / "study.lock", "ours")
    monkeypatch.setattr(lock, "open_plain", unreadable)
    night.now_s = 60.0
    lease.confirm()
    night.now_s = 61.0
    with pytest.raises(LockedError, match=r"cannot be read for 61 s \(Input/output error\)"):
        lease.confirm()


def test_it_beats_while_it_is_held_and_not_when_it_is_lost(tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.setattr(lock, "BEAT_S", 0.001)
    path, touched, beats = tmp_path / "study.lock", threading.Event(), []

    def touch(which: Path) -> None:
        beats.append(which)
        touched.set()

    monkeypatch.setattr(lock.os, "utime", touch)
    with locked(path) as lease:
        assert touched.wait(60)
        heart = next(one for one in threading.enumerate() if one.name == "heartbeat")
        path.unlink()
        heart.join(60)
        with pytest.raises(LockedError, match="was removed"):
            lease.check()
    assert set(beats) == {path}


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


@pytest.mark.parametrize(("first", "last"), [(0, 60), pytest.param(60, 3000, marks=pytest.mark.nightly)])
def test_in_any_order_of_operations_one_at_most_has_the_lock(tmp_path: Path, first: int, last: int) -> None:
    """Of two that hold a run for dead, and one that comes anew while it ends."""
    taken = 0
    for seed in range(first, last):
        (folder := tmp_path / str(seed)).mkdir()
        taken += raced(folder / "study.lock", random.Random(seed), seed)
    assert taken > (last - first) / 4


def raced(path: Path, chance: random.Random, seed: int) -> int:
    """How many of the two that take over have the lock in the end."""
    owner = json.dumps(elsewhere(path))

    def entering(silence_s: float | None) -> Callable[[], Lease | None]:
        patience = None if silence_s is None else Patience(silence_s, lambda _text: None)

        def enter() -> Lease | None:
            try:
                return stack.enter_context(locked(path, patience=patience))
            except LockedError:
                return None

        return enter

    with Patch.context() as patch, contextlib.ExitStack() as stack:
        patch.setattr(lock, "time", Night())
        works = [entering(SILENCE_S), entering(SILENCE_S), lambda: lock.remove(path, owner), entering(None)]
        b, c, _, fresh = Turns(patch, chance).run(*works)
        leases = [one for one in (b, c, fresh) if isinstance(one, Lease)]
        assert sum(has_it(one) for one in leases) <= 1, seed
        assert leases, seed
        return sum(isinstance(one, Lease) for one in (b, c))


def has_it(lease: Lease) -> bool:
    try:
        lease.confirm()
    except LockedError:
        return False
    return True


def test_a_lock_that_is_another_s_by_now_is_put_back(tmp_path: Path, monkeypatch: Patch) -> None:
    path, other = tmp_path / "study.lock", lock.this_run()
    ended, replace = json.dumps(elsewhere(path)), Path.replace

    def faster(self: Path, target: Path) -> Path:
        self.write_text(other)
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", faster)
    assert not lock.remove(path, ended)
    assert path.read_text() == other
    assert list(tmp_path.iterdir()) == [path]
