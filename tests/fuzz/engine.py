"""Makes mutants by their numbers, tries each, and counts what came of it.

A target is a module `tests.fuzz.mutate_<format>` (SUFFIX and `mutant(random)`, and BESIDE if the file beside
a mutant is no layout), or one of our own files in `tests.fuzz.own`. The same seed and number make the same
mutant, whichever process makes it.
"""

from __future__ import annotations

import importlib
import os
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random

from accelcal_cli.core.errors import AccelcalError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import all_formats
from tests.fuzz import command, limits
from tests.fuzz.mutant import Mutant, verdict
from tests.fuzz.own import TARGETS
from tests.fuzz.reading import OTHER_CHUNKS, read

FAILURES = Path("fuzz_failures")
NUMBER = "number"
"""The file that tells which mutant is being tried, and since when."""

KEPT_OF_EACH = 3
WHOLE_EACH, OTHER_CHUNKS_EACH, COMMAND_EACH, UNNAMED_EACH = 16, 16, 500, 4
"""One mutant in so many goes through the first pass of a calibration, is read in other chunks, goes through
the command, and has its format recognised."""

ABOUT_ALL = "rows hold usable values"
"""An error about all of a file names the line in which its rows begin."""

FORMATS = tuple(item.name for item in all_formats())
SHARES = {"flash": 4, "raw": 3, "gt3x": 3, "csv": 1, "hdf5": 1, "opal": 1}
USUAL_SHARE = 2
"""Formats that are quickly read have more mutants, so that each takes about as long."""

OWN_PART = 100
"""Our own files go through the whole command, which takes longer: one in so many, of each kind."""

NAMES = (*FORMATS, *TARGETS)


@dataclass
class Tally:
    """What came of the mutants of a target.

    Attributes:
        failures: kind and text of each, and the file that is kept.
        refusals: what the errors of refused mutants say.
        rows: that readers gave, filled ones included.
        lost: rows of the files that they did not give, and told so.
        slowest_s: of a processor.
    """

    mutants: int = 0
    refused: int = 0
    rows: int = 0
    lost: int = 0
    slowest_s: float = 0.0
    peak_bytes: int = 0
    failures: list[str] = field(default_factory=list)
    refusals: Counter[str] = field(default_factory=Counter)

    def add(self, other: Tally) -> None:
        for name in ("mutants", "refused", "rows", "lost"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.slowest_s = max(self.slowest_s, other.slowest_s)
        self.peak_bytes = max(self.peak_bytes, other.peak_bytes)
        self.failures += other.failures
        self.refusals += other.refusals

    def line(self, name: str) -> str:
        read_ones = self.mutants - self.refused
        return (
            f"{name:<10} {self.mutants:>8} {self.refused:>8} {read_ones:>8} {self.rows:>11} {self.lost:>9} "
            f"{len(self.failures):>8} {self.slowest_s:>9.2f} {self.peak_bytes / 2**20:>8.0f}"
        )


HEAD = (
    f"{'target':<10} {'mutants':>8} {'refused':>8} {'read':>8} {'rows':>11} {'lost,told':>9} "
    f"{'failures':>8} {'slowest s':>9} {'peak MB':>8}"
)

Try = Callable[[Random, int, Path, Tally], "tuple[bytes, str, str | None]"]
"""Makes and tries one mutant: its bytes, what was changed, what was wrong."""


def fuzz(name: str, seed: int, numbers: range, folder: Path) -> Tally:
    warnings.simplefilter("error")
    tally, kinds = Tally(), Counter[str]()
    attempt = TARGETS[name](folder) if name in TARGETS else format_target(name, folder)
    for number in numbers:
        random = Random(f"{name} {seed} {number}")
        (folder / NUMBER).write_text(str(number))
        found, what = tried(name, attempt, random, number, folder, tally)
        tally.mutants += 1
        if found is not None:
            kind = found.strip().splitlines()[-1][:60]
            kinds[kind] += 1
            kept = keep(f"{name}-{seed}-{number}", folder) if kinds[kind] <= KEPT_OF_EACH else None
            tally.failures.append(f"{kept or 'as above'} ({what}): {found}")
    return tally


def tried(
    name: str, attempt: Try, random: Random, number: int, folder: Path, tally: Tally
) -> tuple[str | None, str]:
    """Try one mutant within the limits: what was wrong, what was changed."""
    data, what = b"", ""
    limits.forget_peak()
    before, begun, rows = limits.peak_bytes(), time.process_time(), tally.rows
    try:
        with limits.limited(limits.SECONDS if name in FORMATS else limits.FIT_SECONDS):
            data, what, found = attempt(random, number, folder, tally)
    except limits.HangError:
        found = "HANGS: takes too many seconds"
    except Exception:
        found = traceback.format_exc()
    seconds, peak = time.process_time() - begun, limits.peak_bytes()
    tally.slowest_s, tally.peak_bytes = max(tally.slowest_s, seconds), max(tally.peak_bytes, peak)
    if found is None and peak - before > limits.MEMORY_BYTES:
        found = f"MEMORY: takes {peak >> 20} MB"
    allowed = limits.allowed_seconds(len(data), tally.rows - rows)
    if found is None and name in FORMATS and seconds > allowed:
        found = f"SLOW: {seconds:.1f} s for {len(data)} bytes, {tally.rows - rows} rows"
    return found, what


def keep(name: str, folder: Path) -> Path:
    """Copy the mutant that lies in a folder, and what lies beside it, to where failures are kept."""
    FAILURES.mkdir(exist_ok=True)
    files = [path for path in folder.glob("mutant*") if path.is_file()]
    for path in files:
        (FAILURES / path.name.replace("mutant", name, 1)).write_bytes(path.read_bytes())
    return FAILURES / (files[0].name.replace("mutant", name, 1) if files else name)


def format_target(name: str, folder: Path) -> Try:
    """Tries the mutants of a format."""
    module = importlib.import_module(f"tests.fuzz.mutate_{name}")
    path = folder / f"mutant{module.SUFFIX}"
    layout = folder / f"mutant{getattr(module, 'BESIDE', '.layout.toml')}"

    def attempt(random: Random, number: int, folder: Path, tally: Tally) -> tuple[bytes, str, str | None]:
        made: Mutant = module.mutant(random)
        path.write_bytes(made.data)
        if made.layout is not None:
            layout.write_bytes(made.layout)
        found = judged(name, made, path, number, random, tally)
        if found is None and number % COMMAND_EACH == 0:
            found = through_command(made, path, folder)
        return made.data, made.what, found

    return attempt


def judged(name: str, made: Mutant, path: Path, number: int, random: Random, tally: Tally) -> str | None:
    """Read a mutant, and hold its rows against what it holds."""
    options = replace(made.options, format=name if number % UNNAMED_EACH or made.truth else None)
    other = random.choice(OTHER_CHUNKS) if number % OTHER_CHUNKS_EACH == 1 else 0
    rows = read(path, options, whole=number % WHOLE_EACH == 0, other_chunks=other)
    if isinstance(rows, AccelcalError):
        tally.refused += 1
        tally.refusals[rows.message] += 1
        return blames_a_sound_line(rows, made)
    tally.rows += rows.number
    found, lost = (None, 0) if made.truth is None else verdict(rows, made.truth)
    tally.lost += lost
    return found


def blames_a_sound_line(error: AccelcalError, made: Mutant) -> str | None:
    """An error that sends its reader to a line in which nothing is wrong."""
    if error.line in (None, 1) or not made.sound_lines or ABOUT_ALL in error.message:
        return None
    line = made.data.decode("utf-8", "replace").split("\n")[error.line - 1]
    return f"BLAMES A SOUND LINE: {error}" if line in made.sound_lines else None


def through_command(made: Mutant, path: Path, folder: Path) -> str | None:
    """What `calibrate` and `inspect` do with it that they may not."""
    options = words(made.options)
    out = folder / "out"
    for run in (["calibrate", path, "-d", out, *options], ["inspect", path, *options]):
        _, found = command.checked_run(run, out)
        if found is not None:
            return found
    return None


def words(options: ReadOptions) -> list[str]:
    named = {"--sensor": options.sensor, "--rate": options.rate_hz, "--lsb-per-g": options.lsb_per_g}
    return [str(word) for pair in named.items() if pair[1] is not None for word in pair]


def number_of_mutants(name: str, number: int) -> int:
    """Those of one target, of so many of all formats together."""
    share = number * SHARES.get(name, USUAL_SHARE) // sum(SHARES.get(item, USUAL_SHARE) for item in FORMATS)
    return max(1, share if name in FORMATS else number // OWN_PART)


MUTANTS = int(os.environ.get("ACCELCAL_FUZZ", "500"))
