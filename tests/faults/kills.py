"""Commands that are killed again and again, before operations that chance chooses, and then run to their end.

`python -m tests.faults.kills [KILLS [NAME...]]` prints figures: 1000 kills of a study, or KILLS, and a tenth
as many of the others. All processes of the command are killed at once (SIGKILL).
"""

from __future__ import annotations

import os
import random
import re
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.faults.checks import Contents, contents, differences
from tests.faults.shim import Fault, Runner, Struck, running
from tests.recordings import directions, still_counts, write_csv, write_raw

ALSO = (".tmp", "study.lock")
"""How names end of what a killed run may leave, and a later one removes."""

PROBE = re.compile("[a-z0-9_]{8}")
"""The file by which Python's `tempfile` finds out whether a folder can be written."""

TABLES = ("study.csv", "study.json", "study.parquet")


def _folder(folder: Path) -> None:
    """Three recordings, one of them refused."""
    for number, poses in enumerate((24, 26, 2)):
        write_raw(folder / f"p{number}.raw", still_counts(directions(poses), seed=number + 1))


def _long(folder: Path) -> None:
    """A recording of three row groups, which threads encode."""
    write_raw(folder / "p0.raw", still_counts(np.tile(directions(24), (70, 1))))


def _parts(folder: Path) -> None:
    """Three tables, one after the other."""
    whole = write_csv(folder / "whole.csv", still_counts(directions(24))).read_text().splitlines(True)
    (folder / "whole.csv").unlink()
    head, rows, length = whole[0], whole[1:], len(whole) // 3
    for number in range(3):
        part = rows[number * length : (number + 1) * length]
        (folder / f"{number}.csv").write_text("".join([head, *part]))


@dataclass(frozen=True)
class Victim:
    """A command that is killed.

    Attributes:
        words: names in them are below the folder in which it runs.
        make: makes the inputs.
        code: how it ends if it is not killed.
        share: kills of it for each of those of a study.
    """

    name: str
    words: tuple[str, ...]
    make: Callable[[Path], object]
    code: int
    share: float = 0.1


QUICK = ("-q", "--recalibrate", "never", "--prior", "none", "--model", "6")
STUDY = ("study", "in", "-d", "out", "-j", "2", "--all-failures", *QUICK)
VICTIMS = (
    Victim("study", STUDY, _folder, 1, share=1.0),
    Victim("study --html", (*STUDY, "--html"), _folder, 1),
    Victim("calibrate --html", ("calibrate", "in/p0.raw", "-d", "out", "--html", *QUICK), _folder, 0),
    Victim("calibrate, with threads", ("calibrate", "in/p0.raw", "-d", "out", *QUICK), _long, 0),
    Victim("calibrate --parts", ("calibrate", "--parts", "in", "-d", "out", *QUICK), _parts, 0),
)


@dataclass
class Killing:
    """One command and what came of killing it.

    Attributes:
        operations: of an undisturbed run.
        kills: how often it was killed; places: before which operations.
        ends: how often a run came to its end after kills, with all bytes as undisturbed.
    """

    victim: Victim
    folder: Path
    runner: Runner
    undisturbed: Contents = field(default_factory=dict)
    operations: int = 0
    kills: int = 0
    places: set[int] = field(default_factory=set)
    ends: int = 0

    def __post_init__(self) -> None:
        """Make the inputs, and see what comes of them undisturbed."""
        for name in ("in", "out", "tmp"):
            (self.folder / name).mkdir(parents=True)
        self.victim.make(self.folder / "in")
        self.operations = self._run(0).failed
        self.undisturbed = contents(self.folder / "out")
        self._fresh()

    def kill(self, times: int, chance: random.Random) -> None:
        """Kill it so often; raises AssertionError if anything is not as it must be."""
        while self.kills < times:
            nth = chance.randint(1, self.operations)
            if self._run(nth).ran.code == -signal.SIGKILL:
                self.kills += 1
                self.places.add(nth)
                self._check_outputs()
            else:
                self._check_end()
            if chance.random() < 0.5:
                self._run(0)
                self._check_end()
        self._run(0)
        self._check_end()

    def _run(self, nth: int) -> Struck:
        struck = self.runner.run(self.victim.words, self.folder, Fault("open", nth=nth, kills=True))
        wanted = (self.victim.code, -signal.SIGKILL) if nth else (self.victim.code,)
        assert struck.ran.code in wanted, (nth, struck)
        assert "bug in accelcal" not in struck.ran.err, (nth, struck)
        return struck

    def _check_outputs(self) -> None:
        """Each file that is there is whole: as undisturbed, or a table with some of its rows."""
        found = contents(self.folder / "out")
        for name, held in found.items():
            if name.endswith(ALSO) or held == self.undisturbed.get(name):
                continue
            assert name in TABLES and isinstance(held, bytes), f"{name} is torn"
            self._check_table(name, held)
        for name in found:
            if name.endswith(".calibration.json"):
                data = name.replace(".calibration.json", ".calibrated.parquet")
                assert data in found or data not in self.undisturbed, f"{name} without its Parquet file"

    def _check_table(self, name: str, held: bytes) -> None:
        whole = self.undisturbed[name]
        assert isinstance(whole, bytes)
        if name.endswith(".csv"):
            assert set(held.splitlines(True)) <= set(whole.splitlines(True)), f"{name} is torn"
        else:
            found, wanted = (pq.read_table(pa.BufferReader(one)).to_pylist() for one in (held, whole))
            assert all(row in wanted for row in found), f"{name} is torn"

    def _check_end(self) -> None:
        """A run came to its end: nothing tells that there were others."""
        found = contents(self.folder / "out")
        wrong = differences(found, self.undisturbed)
        assert not wrong, f"{sorted(wrong)} differ after {self.kills} kills"
        left = [one for path in (self.folder / "tmp").iterdir() if not PROBE.fullmatch(one := path.name)]
        assert not left, f"{left} are left after {self.kills} kills"
        self.ends += 1
        self._fresh()

    def _fresh(self) -> None:
        shutil.rmtree(self.folder / "out")
        (self.folder / "out").mkdir()


def main(words: list[str]) -> None:
    """Kill all of them, and tell how often."""
    kills, names = int(words[0]) if words else 1000, words[1:]
    seed = int(os.environ.get("ACCELCAL_KILLS_SEED", time.time_ns() % 1_000_000))
    sys.stdout.write(f"ACCELCAL_KILLS_SEED={seed}\n")
    with tempfile.TemporaryDirectory() as folder, running(Path(folder), forked=True) as runner:
        assert runner is not None, "needs Linux and a C compiler"
        for number, victim in enumerate(VICTIMS):
            if names and victim.name not in names:
                continue
            killing = Killing(victim, Path(folder) / str(number), runner)
            killing.kill(round(kills * victim.share), random.Random(seed))
            where = f"before {len(killing.places)} of {killing.operations} operations"
            ends = f"{killing.ends} ends as undisturbed"
            sys.stdout.write(f"{victim.name}: {killing.kills} kills, {where}; {ends}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
