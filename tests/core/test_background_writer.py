"""Bytes reach the file in order, later; what fails then is told."""

from __future__ import annotations

import io
import threading
from pathlib import Path

import pytest

from accelcal_cli.core.parallel import DEPTH, Behind


class Slow(io.BytesIO):
    """A file whose writes wait for a word."""

    def __init__(self) -> None:
        super().__init__()
        self.go = threading.Event()
        self.threads: set[str] = set()

    def write(self, data: bytes) -> int:  # type: ignore[override]
        self.go.wait(10)
        self.threads.add(threading.current_thread().name)
        return super().write(data)


def test_all_bytes_in_order(tmp_path: Path) -> None:
    path = tmp_path / "a"
    file = Behind(path.open("wb"))
    parts = [bytes([number % 251]) * (number * 97 % 4096) for number in range(300)]
    assert [file.write(part) for part in parts] == [len(part) for part in parts]
    assert file.tell() == sum(map(len, parts))
    file.close()
    assert file.closed
    assert path.read_bytes() == b"".join(parts)


def test_whoever_writes_does_not_wait_for_the_disk() -> None:
    slow = Slow()
    file = Behind(slow)
    for _ in range(DEPTH):
        file.write(b"abc")
    assert slow.getvalue() == b""
    slow.go.set()
    file.flush()
    assert slow.getvalue() == b"abc" * DEPTH
    assert threading.current_thread().name not in slow.threads


def test_what_was_given_may_change_at_once() -> None:
    slow = Slow()
    file = Behind(slow)
    data = bytearray(b"abc")
    file.write(data)
    data[:] = b"xyz"
    slow.go.set()
    file.flush()
    assert slow.getvalue() == b"abc"


class Full(io.BytesIO):
    def write(self, data: bytes) -> int:  # type: ignore[override]
        raise OSError(28, "No space left on device")


@pytest.mark.parametrize("then", ["write", "flush", "close"])
def test_a_write_that_failed_is_told_by_the_next_call(then: str) -> None:
    file = Behind(Full())
    for _ in range(DEPTH):
        file.write(b"abc")
    with pytest.raises(OSError, match="No space"):
        file.write(b"abc") if then == "write" else getattr(file, then)()
    if then == "close":
        assert file.closed
