"""`accelcal watch --state`, killed at random moments: nothing is lost, and what comes twice is the same."""

from __future__ import annotations

import contextlib
import json
import subprocess
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import BinaryIO

import numpy as np
import pytest

from tests.cli.run import command
from tests.recordings import directions, still_counts, write_raw


@dataclass(frozen=True)
class Place:
    """Where the state says that a watch goes on."""

    byte: int = 0
    sample: int = 0


def place_of(state: Path) -> Place:
    if not state.exists():
        return Place()
    head = json.loads(state.read_bytes().split(b"\n", 1)[0])
    return Place(head["bytes"], head["samples"])


def send(pipe: BinaryIO, data: bytes, *, close: bool) -> None:
    with contextlib.suppress(BrokenPipeError):
        pipe.write(data)
        if close:
            pipe.close()


def kill_one(words: Sequence[str], data: bytes, random: Random) -> None:
    """Kill a watch when it has taken some bytes in, or when it tells something."""
    told = random.random() < 0.5
    sent = data if told else data[: random.randint(0, len(data))]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(words, **pipes, bufsize=0) as process:  # type: ignore[call-overload]
        sending = threading.Thread(target=send, args=(process.stdin, sent), kwargs={"close": told})
        sending.start()
        if told:
            for _ in range(random.randint(1, 4)):
                process.stdout.readline()
        else:
            sending.join()
        process.kill()
        sending.join()
        assert process.stderr.read() == b""


def rows_of(path: Path) -> list[str]:
    """Whole lines behind the head; the last one may be cut off."""
    return path.read_text().split("\n")[1:-1] if path.exists() else []


@pytest.mark.parametrize("kills", [2, pytest.param(100, marks=pytest.mark.nightly)])
def test_the_state_is_the_same_and_rows_come_again_from_the_last_one_on(kills: int, tmp_path: Path) -> None:
    poses = np.concatenate([directions(200), directions(120), directions(300)])
    recording, random = write_raw(tmp_path / "paper.raw", still_counts(poses)), Random(kills)
    data, layout = recording.read_bytes(), tmp_path / "paper.layout.toml"
    watch = command("watch", "-", "--profile", "paper", "--format", "raw", "--layout", layout)

    def words(name: str, rows: Path) -> list[str]:
        return [*watch, "--state", str(tmp_path / name), "-o", str(rows)]

    whole = tmp_path / "whole.csv"
    subprocess.run(words("undisturbed", whole), input=data, check=True, stdout=subprocess.DEVNULL)
    expected = rows_of(whole)
    first = place_of(tmp_path / "undisturbed").sample - len(expected)
    assert 0 < first < len(expected) // 2
    for chain in range(0, kills, 10):
        name, complete = f"state-{chain}", 0
        for run in range(min(10, kills - chain) + 1):
            place, rows = place_of(tmp_path / name), tmp_path / f"rows-{chain}-{run}.csv"
            if run < min(10, kills - chain):
                kill_one(words(name, rows), data[place.byte :], random)
            else:
                left = data[place.byte :]
                subprocess.run(words(name, rows), input=left, check=True, stdout=subprocess.DEVNULL)
            begin, found = max(0, place.sample - first), rows_of(rows)
            assert found == expected[begin : begin + len(found)]
            assert begin <= complete, "rows were lost"
            complete = max(complete, begin + len(found))
        assert complete == len(expected)
        assert (tmp_path / name).read_bytes() == (tmp_path / "undisturbed").read_bytes()
    assert not list(tmp_path.glob("*.tmp")), "a later watch removes what a killed one left"
