"""`make fuzz`: tries mutants of all targets, or of those named, on all cores.

ACCELCAL_FUZZ is the number of mutants of all formats, ACCELCAL_FUZZ_SEED the seed, ACCELCAL_FUZZ_JOBS the
number of processes; ACCELCAL_FUZZ_FROM leaves out as many of ACCELCAL_FUZZ as an earlier run has tried. A
process tries PART mutants and ends, so that memory does not depend on their number. What fails is kept in
`fuzz_failures`.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import sys
import tempfile
import time
from collections import deque
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from accelcal_cli.core.system import hold_to_one_thread
from tests.fuzz import engine
from tests.fuzz.engine import Tally

PART = 2000
STUCK_S = 90.0
"""A process that begins no mutant for so long is stuck where no Python code runs, and is ended."""

POLL_S = 0.2


@dataclass
class Part:
    """Mutants of one target that one process tries."""

    name: str
    numbers: range


@dataclass
class Worker:
    """A process at work; each mutant that it begins changes the time of `folder`'s file `number`."""

    part: Part
    process: Any
    result: Connection
    folder: Path

    def begun(self) -> tuple[int, float]:
        """The number of the mutant at work, and for how long it has been."""
        try:
            file = self.folder / engine.NUMBER
            return int(file.read_text() or self.part.numbers.start), time.time() - file.stat().st_mtime
        except FileNotFoundError:
            return self.part.numbers.start, 0.0


def work(part: Part, seed: int, folder: Path, result: Connection) -> None:
    """What a process does."""
    hold_to_one_thread()
    result.send(engine.fuzz(part.name, seed, part.numbers, folder))


def start(part: Part, seed: int) -> Worker:
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    folder = Path(tempfile.mkdtemp(prefix="accelcal-fuzz-"))
    process = context.Process(target=work, args=(part, seed, folder, there))
    process.start()
    there.close()
    return Worker(part, process, here, folder)


def parts(names: list[str], tried: int = 0) -> deque[Part]:
    found = []
    for name in names:
        total = engine.number_of_mutants(name, engine.MUTANTS)
        size = PART if name in engine.FORMATS else PART // 40
        first = engine.number_of_mutants(name, tried) if tried else 0
        found += [Part(name, range(at, min(total, at + size))) for at in range(first, total, size)]
    return deque(sorted(found, key=lambda part: part.numbers.start / part.numbers.stop))


def ended(worker: Worker, queue: deque[Part], seed: int) -> Tally | None:
    """What a worker found, None while it works; where it died or is stuck, the rest goes back."""
    if worker.result.poll():
        try:
            tally: Tally = worker.result.recv()
        except EOFError:
            return lost(worker, queue, seed, "DIES")
        worker.process.join()
        return tally
    if worker.begun()[1] > STUCK_S:
        worker.process.kill()
        return lost(worker, queue, seed, f"HANGS: takes more than {STUCK_S:g} s outside of Python")
    return None


def lost(worker: Worker, queue: deque[Part], seed: int, what: str) -> Tally:
    """A mutant that ended its process; what came before it in the part is counted, but not what it gave."""
    worker.process.join()
    number = worker.begun()[0]
    kept = engine.keep(f"{worker.part.name}-{seed}-{number}", worker.folder)
    if number + 1 < worker.part.numbers.stop:
        queue.appendleft(Part(worker.part.name, range(number + 1, worker.part.numbers.stop)))
    done = number + 1 - worker.part.numbers.start
    return Tally(mutants=done, failures=[f"{kept}: {what} (exit code {worker.process.exitcode})"])


def run(names: list[str], seed: int, jobs: int, tried: int = 0) -> dict[str, Tally]:
    tallies = {name: Tally() for name in names}
    queue, workers = parts(names, tried), list[Worker]()
    while queue or workers:
        while queue and len(workers) < jobs:
            workers.append(start(queue.popleft(), seed))
        for worker in list(workers):
            tally = ended(worker, queue, seed)
            if tally is not None:
                workers.remove(worker)
                shutil.rmtree(worker.folder, ignore_errors=True)
                tallies[worker.part.name].add(tally)
                print(*tally.failures, sep="\n", end="\n" if tally.failures else "", flush=True)
                print(f"{worker.part.name}: {tallies[worker.part.name].mutants} mutants", file=sys.stderr)
        time.sleep(POLL_S)
    return tallies


def main() -> int:
    seed, jobs, tried = (
        int(os.environ.get(f"ACCELCAL_FUZZ_{name}", "0")) for name in ("SEED", "JOBS", "FROM")
    )
    names = sys.argv[1:] or list(engine.NAMES)
    begun = time.monotonic()
    tallies = run(names, seed or 1, jobs or os.cpu_count() or 1, tried)
    print(engine.HEAD)
    total = Tally()
    for name, tally in tallies.items():
        print(tally.line(name))
        total.add(tally)
    print(total.line("all"))
    print(f"{time.monotonic() - begun:.0f} s")
    return min(len(total.failures), 100)


if __name__ == "__main__":
    sys.exit(main())
