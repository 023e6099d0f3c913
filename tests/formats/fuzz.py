"""Damages small valid files of every format at random and reads them: `make fuzz`.

Whatever the bytes, a reader gives rows that keep its contract, or an error of ours, soon and in little
memory. ACCELCAL_FUZZ is the number of mutants of each format; what fails is kept in `fuzz_failures`.
"""

from __future__ import annotations

import importlib
import os
import resource
import signal
import sys
import tempfile
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType

import numpy as np

from accelcal_cli.core.errors import AccelcalError
from accelcal_cli.core.formats import Format, ReadOptions
from accelcal_cli.core.recording import Chunk, Reader
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.formats import all_formats
from accelcal_cli.pipeline.survey import FactsObserver, make_method, open_marked, survey
from tests.formats.expected import Expected

MUTANTS = int(os.environ.get("ACCELCAL_FUZZ", "25"))
SECONDS = 5.0
MEMORY_BYTES = 400 << 20
FAILURES = Path("fuzz_failures")
CHUNK_SAMPLES = 300


class HangError(Exception):
    """A mutant takes too long."""


def make(item: Format, folder: Path, rows: int = 1200) -> Expected:
    """The small valid file of a format's `make_<name>.py`."""
    counts = np.random.RandomState(11).randint(-500, 500, (rows, 3)).astype(np.int16)
    maker = importlib.import_module(f"tests.formats.make_{item.name}")
    made: Expected = maker.make(folder, counts, 50.0, 256.0)
    return made


def mutants(data: bytes, number: int, seed: int) -> Iterator[bytes]:
    """Copies of `data` with one to four damages each."""
    random = np.random.RandomState(seed)
    for _ in range(number):
        mutant = data
        for _ in range(random.randint(1, 5)):
            mutant = damaged(mutant, random)
        yield mutant


def damaged(data: bytes, random: np.random.RandomState) -> bytes:
    """Bytes changed, a block removed, repeated, moved, zeroed or erased, or the end cut off."""
    if not data:
        return data
    at, other = (random.randint(len(data)) for _ in range(2))
    size = int(random.choice([1, 2, 4, 8, 64, 512, random.randint(1, len(data) + 1)]))
    if random.rand() < 0.3:
        at = at // 512 * 512
    if random.rand() < 0.2:
        at = min(at, random.randint(2048))
    before, block, after = data[:at], data[at : at + size], data[at + size :]
    kinds = (
        lambda: before + bytes([data[at] ^ 1 << random.randint(8)]) + data[at + 1 :],
        lambda: before + bytes(random.randint(0, 256, len(block)).tolist()) + after,
        lambda: before + after,
        lambda: before + block + block + after,
        lambda: before + data[other : other + len(block)] + after,
        lambda: before + bytes(len(block)) + after,
        lambda: before + b"\xff" * len(block) + after,
        lambda: before,
        lambda: before + data[other : other + size] + data[at:],
    )
    return kinds[random.randint(len(kinds))]()


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise HangError in a block that takes longer."""

    def stop(_number: int, _frame: FrameType | None) -> None:
        raise HangError

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def checked(chunks: Iterator[Chunk], total_bytes: int) -> Iterator[Chunk]:
    """The chunks; AssertionError for one that breaks the contract."""
    sample = byte = 0
    for chunk in chunks:
        rows = len(chunk)
        assert chunk.first_sample == sample, "rows do not go on"
        assert chunk.counts.shape == (rows, 3)
        assert chunk.counts.dtype in (np.int16, np.int32)
        assert byte <= chunk.end_byte <= total_bytes, "progress goes back or beyond the file"
        assert chunk.breaks.shape == (len(chunk.breaks),)
        assert (np.diff(chunk.breaks) > 0).all()
        assert not len(chunk.breaks) or 0 <= chunk.breaks[0] <= chunk.breaks[-1] < rows
        assert sample != 0 or 0 not in chunk.breaks, "the first row cannot be a break"
        times = chunk.clock.times(0, rows)
        assert (times.shape, times.dtype) == ((rows,), np.int64)
        for column, dtype in ((chunk.temperature_mc, np.int32), (chunk.validity, np.uint8)):
            assert column is None or (column.shape, column.dtype) == ((rows,), dtype)
        gyro = chunk.gyro_counts
        assert gyro is None or (gyro.shape == (rows, 3) and gyro.dtype in (np.int16, np.int32))
        for problem in chunk.problems:
            assert problem.count >= 1 or problem.code == "truncated"
            assert problem.lost_bytes >= 0
            assert problem.sample >= 0
        assert chunk.used_bytes >= 0
        yield chunk
        sample, byte = sample + rows, chunk.end_byte


def read(path: Path, options: ReadOptions) -> None:
    """Read a file in all ways; AssertionError where a reader breaks its contract."""
    try:
        with open_marked(path, options) as reader:
            _read_all(reader)
    except AccelcalError as error:
        assert str(path) in str(error), f"an error without the file's name: {error}"


def _read_all(reader: Reader) -> None:
    recording = reader.recording
    assert recording.rate_hz > 0
    assert recording.lsb_per_g > 0
    chunks = checked(reader.chunks(CHUNK_SAMPLES), recording.total_bytes)
    method = make_method(recording, DEFAULT)
    facts = FactsObserver(recording, method.rest_lsb)
    survey(chunks, method.segmenter, (facts, method.procedure))
    assert 0 <= facts.result().lost_percent() <= 100
    for chunk in reader.preview(64, 4):
        chunk.clock.times(0, len(chunk))


def failing(data: bytes, made: Expected, options: ReadOptions) -> str | None:
    """What is wrong with the reading of a mutant, None where nothing is."""
    path = made.path.with_name("mutant" + made.path.suffix)
    path.write_bytes(data)
    try:
        with limited(SECONDS):
            read(path, options)
    except HangError:
        return f"takes more than {SECONDS:g} s"
    except Exception:
        return traceback.format_exc()
    return None


def fuzz(item: Format, number: int, seed: int, folder: Path) -> list[str]:
    """Read so many mutants of a format; what went wrong, the mutants kept."""
    made = make(item, folder)
    for layout in made.path.parent.glob("*.layout.toml"):
        layout.with_name("mutant.layout.toml").write_bytes(layout.read_bytes())
    wrong = []
    before = _peak_bytes()
    for index, data in enumerate(mutants(made.path.read_bytes(), number, seed)):
        named = replace(made.options, format=item.name if index % 4 else None)
        found = failing(data, made, named)
        if found is None and _peak_bytes() - before > MEMORY_BYTES:
            found, before = f"takes more than {MEMORY_BYTES >> 20} MiB", _peak_bytes()
        if found is not None:
            FAILURES.mkdir(exist_ok=True)
            kept = FAILURES / f"{item.name}-{seed}-{index}{made.path.suffix}"
            kept.write_bytes(data)
            wrong.append(f"{kept}: {found}")
    return wrong


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def main() -> int:
    """Fuzz the formats named on the command line, all without one; gives the number of failures."""
    seed = int(os.environ.get("ACCELCAL_FUZZ_SEED", "1"))
    failures = 0
    for item in all_formats():
        if sys.argv[1:] and item.name not in sys.argv[1:]:
            continue
        with tempfile.TemporaryDirectory() as folder:
            wrong = fuzz(item, MUTANTS, seed, Path(folder))
        failures += len(wrong)
        print(f"{item.name}: {MUTANTS} mutants, {len(wrong)} failures", flush=True)
        print("\n".join(wrong), end="\n" if wrong else "", flush=True)
    return min(failures, 100)


if __name__ == "__main__":
    sys.exit(main())
