"""`accelcal evaluate homogeneity`: how alike devices are that were moved together, raw and calibrated.

Deviations from the mean of all, the normalized aggregate trace (Grammenos, Mascolo, Crowcroft 2018,
Definition 5.2 and Table 5).

Their clocks are brought together first: lags behind the first recording, hour by hour, by cross-correlation
of calibrated |a| (raw |a| follows the posture, too), and a straight line through them. All are then
read side by side, an hour at a time, as means of a second. Sums are of whole numbers of 2**-32 g: the length
of the chunks makes no difference.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from accelcal_cli.cli import exit_codes, options
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.options import Positive
from accelcal_cli.cli.output import aligned, progress_bars, refuse_both
from accelcal_cli.core.calibration import Transform
from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.core.recording import Chunk, Validity
from accelcal_cli.core.results import Outcome
from accelcal_cli.output.files import csv_text
from accelcal_cli.output.numbers import figure, formatted
from accelcal_cli.output.sentences import explained
from accelcal_cli.pipeline.activity import LEAST_MEASURED, MG, fixed, lengths, versions_of
from accelcal_cli.pipeline.calibrate import OwnCalibration, RecordingRun, open_run
from accelcal_cli.pipeline.jobs import Job, ProgressMaker, Request, no_progress
from accelcal_cli.pipeline.options import chosen_settings, read_options

HOUR_US = 3600 * MICROSECONDS
CELL_US = MICROSECONDS
"""Length [us] of the means that are compared, in which the noise of single samples is small."""

FINE_US = 100_000
"""Length [us] of the means that are correlated."""

LEAST_MOVED_MG = 5.0
"""Smallest standard deviation of |a| [mg] in an hour that can show a lag."""

LEAST_CORRELATION = 0.6
"""Smallest correlation in an hour whose lag counts."""

HOURS_OF_DRIFT = 6
"""Smallest number of hours with a lag that can show a drift of the clock."""

AXES = ("x", "y", "z", "norm")
AFTER = 1
"""Index of the calibrated values among raw and calibrated ones."""

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Shift:
    """Lead of a clock over the first recording's: `lag_us` at the time `at_us`, and a drift from there."""

    lag_us: float = 0.0
    drift: float = 0.0
    at_us: int = 0

    def on_common_clock(self, time_us: Integers) -> Integers:
        """Convert times (n,) of the device to those of the first recording's clock."""
        ahead = np.rint(self.lag_us + self.drift * (time_us - self.at_us))
        return np.asarray(time_us - ahead.astype(np.int64))


@dataclass(frozen=True, slots=True)
class Clock:
    """A device's clock compared with the first recording's.

    Attributes:
        lag_s: lead over the first recording's clock, in the middle of their common time.
        drift_ppm: relative rate by which it is faster.
        residual_ms: root mean square distance of the hours' lags from that.
        correlation: median of the hours' correlations; None for the first recording.
        hours: number of hours that showed a lag.
    """

    lag_s: float = 0.0
    drift_ppm: float = 0.0
    residual_ms: float = 0.0
    correlation: float | None = None
    hours: int = 0


@dataclass(frozen=True, slots=True)
class Likeness:
    """Deviations of one device, or of all together.

    Attributes:
        before, after: mean squared deviation from the common trace of x, y, z and |a| [g2].
    """

    before: tuple[float, ...]
    after: tuple[float, ...]

    def rms_mg(self) -> list[list[float]]:
        """Return the roots of the mean squares [mg], before and after."""
        return [[1000 * value**0.5 for value in values] for values in (self.before, self.after)]


@dataclass(frozen=True, slots=True)
class Compared:
    """One recording of the comparison.

    Attributes:
        clock, likeness: None for a refused recording, which is left out.
    """

    path: Path
    serial: str | None
    outcome: str
    message: str
    clock: Clock | None = None
    likeness: Likeness | None = None


@dataclass(frozen=True, slots=True)
class Homogeneity:
    """All recordings, and the deviations of those that could be calibrated.

    Attributes:
        seconds: length of the common trace.
    """

    recordings: tuple[Compared, ...]
    seconds: int
    together: Likeness


@dataclass(frozen=True, slots=True)
class _Device:
    """An open recording, and its transforms of counts to g before and after calibration."""

    run: RecordingRun
    serial: str | None
    outcome: str
    message: str
    utc_offset_us: int
    transforms: tuple[Transform, ...]

    def hours(self, cell_us: int, shift: Shift, transforms: Sequence[Transform]) -> Iterator[Hour]:
        """Yield its hours, in cells of the common clock."""
        chunks = self.run.reader.chunks(self.run.request.chunk_samples)
        return hours(chunks, transforms, cell_us, shift, self.utc_offset_us)


Hour = tuple[int, Integers]
"""Number of an hour since 1970; (cells, 1 + 4 versions) number of rows and sums of x, y, z and |a|."""


def homogeneity(
    paths: Sequence[Path], request: Request, largest_lag_s: float, progress: ProgressMaker = no_progress
) -> Homogeneity:
    """Compare recordings of devices that were moved together.

    Args:
        largest_lag_s: largest difference of their clocks.

    Raises:
        AccelcalError: one cannot be read.
        UsageError: fewer than two can be calibrated, or they have no movement or no time in common.
    """
    with ExitStack() as stack:
        devices = [_open(path, request, stack, progress) for path in paths]
        good = [one for one in devices if one.outcome != Outcome.REFUSED]
        if len(good) < 2:
            raise UsageError(
                "fewer than two of the recordings can be calibrated", hint="see accelcal inspect"
            )
        found = _clocks(good, largest_lag_s)
        sums, cells = _deviations(good, [shift for shift, _ in found])
    if not cells:
        raise UsageError("the recordings have no second in common", hint="check their clocks and time zones")
    alike = [_likeness(one / cells) for one in sums]
    pairs = iter(zip(found, alike, strict=True))
    recordings = []
    for one in devices:
        (_, clock), likeness = next(pairs) if one in good else ((None, None), None)
        recordings.append(Compared(one.run.job.source, one.serial, one.outcome, one.message, clock, likeness))
    together = _likeness(sums.mean(axis=0) / cells)
    return Homogeneity(tuple(recordings), cells * CELL_US // MICROSECONDS, together)


def _likeness(squares: Floats) -> Likeness:
    before, after = (tuple(part.tolist()) for part in squares.reshape(2, len(AXES)))
    return Likeness(before, after)


def _open(path: Path, request: Request, stack: ExitStack, progress: ProgressMaker) -> _Device:
    """Open a recording and calibrate it from its own stillness."""
    run = stack.enter_context(open_run(Job(path, path, path), request, progress))
    data = run.result(OwnCalibration(run.request.recording_settings)).data
    made, verdict = versions_of(data), data.judgement
    offset_us = (data.facts.utc_offset_s or 0) * MICROSECONDS
    transforms = (made[0].transform, made[-1].transform)
    serial = data.recording.device.serial
    return _Device(run, serial, str(verdict.outcome), explained(verdict.reason), offset_us, transforms)


def hours(
    chunks: Iterable[Chunk],
    transforms: Sequence[Transform],
    cell_us: int,
    shift: Shift,
    utc_offset_us: int = 0,
) -> Iterator[Hour]:
    """Yield sums of a recording's measured rows by the hour; rows of an hour that is past are left out."""
    cells = HOUR_US // cell_us
    current, table = -1, _no_rows(cells, transforms)
    for chunk in chunks:
        for hour, cell, sums in _cells(chunk, transforms, cell_us, shift, utc_offset_us):
            if hour > current:
                if current >= 0:
                    yield current, table
                current, table = hour, _no_rows(cells, transforms)
            if hour == current:
                table[cell] += sums
    if current >= 0:
        yield current, table


def _no_rows(cells: int, transforms: Sequence[Transform]) -> Integers:
    return np.zeros((cells, 1 + len(AXES) * len(transforms)), np.int64)


def _cells(
    chunk: Chunk, transforms: Sequence[Transform], cell_us: int, shift: Shift, utc_offset_us: int
) -> Iterator[tuple[int, Integers, Integers]]:
    """Yield number, cells (k,) and their sums of each hour, or part of one, of a chunk."""
    if not len(chunk):
        return
    columns = [np.ones(len(chunk), np.int64)]
    for transform in transforms:
        xyz = transform.apply(chunk)
        columns += [*(fixed(axis) for axis in xyz), lengths(xyz)]
    rows, times = np.stack(columns, axis=1), chunk.time_us - utc_offset_us
    if chunk.validity is not None and chunk.validity.any():
        kept = chunk.validity == Validity.MEASURED
        rows, times = rows[kept], times[kept]
    if not len(rows):
        return
    cell = shift.on_common_clock(times) // cell_us
    start = np.flatnonzero(np.diff(cell, prepend=cell[0] - 1))
    sums, cell = np.add.reduceat(rows, start, axis=0), cell[start]
    number = cell // (HOUR_US // cell_us)
    ends = [*np.flatnonzero(np.diff(number)) + 1, len(number)]
    for first, end in zip([0, *ends], ends, strict=False):
        places, which = np.unique(cell[first:end] % (HOUR_US // cell_us), return_inverse=True)
        total = np.zeros((len(places), rows.shape[1]), np.int64)
        np.add.at(total, which, sums[first:end])
        yield int(number[first]), places, total


def side_by_side(streams: Sequence[Iterator[Hour]]) -> Iterator[tuple[int, list[Integers | None]]]:
    """Yield hours of several recordings together, with None for a recording without rows in one."""
    heads = [next(stream, None) for stream in streams]
    while known := [head[0] for head in heads if head is not None]:
        number = min(known)
        yield number, [None if head is None or head[0] != number else head[1] for head in heads]
        heads = [
            next(stream, None) if head is not None and head[0] == number else head
            for head, stream in zip(heads, streams, strict=True)
        ]


def _clocks(devices: Sequence[_Device], largest_lag_s: float) -> list[tuple[Shift, Clock]]:
    """Return the clocks of all devices, compared with the first one's."""
    found: list[list[tuple[int, float, float]]] = [[] for _ in devices]
    streams = [one.hours(FINE_US, Shift(), one.transforms[AFTER:]) for one in devices]
    for hour, tables in side_by_side(streams):
        if (first := tables[0]) is None:
            continue
        for lags, table in zip(found[1:], tables[1:], strict=True):
            lag = None if table is None else lag_between(first, table, largest_lag_s)
            if lag is not None and lag[1] >= LEAST_CORRELATION:
                lags.append((hour * HOUR_US + HOUR_US // 2, *lag))
    lost = next((one for one, lags in zip(devices[1:], found[1:], strict=True) if not lags), None)
    if lost is not None:
        text = f"shows no movement in common with {printable(devices[0].run.job.source.name)}"
        hint = (
            "give recordings of devices moved together, and a larger --largest-lag if clocks differ by more"
        )
        raise UsageError(text, path=lost.run.job.source, hint=hint)
    return [(Shift(), Clock()), *map(line_of, found[1:])]


def lag_between(first: Integers, other: Integers, largest_lag_s: float) -> tuple[float, float] | None:
    """Return the lead of another recording's clock in an hour [us], and the correlation there.

    Args:
        first, other: (cells, at least 5) as in `Hour`.

    Returns:
        None if one of them hardly moves, or the best lag is at the end of the allowed range.
    """
    signals = []  # |a| less its mean [g]; 0 in empty cells
    for table in (first, other):
        known, signal = table[:, 0] > 0, np.zeros(len(table))
        signal[known] = table[known, 4] / table[known, 0] * (MG / 1000)
        signal[known] -= signal[known].mean()
        signals.append(signal)
    power = [float(signal @ signal) for signal in signals]
    if min(power) < len(first) * (LEAST_MOVED_MG / 1000) ** 2:
        return None
    size = 2 * len(first)
    one, two = (np.fft.rfft(signal, size) for signal in signals)
    reach = min(len(first) - 1, max(1, round(largest_lag_s * MICROSECONDS / FINE_US)))
    products = np.fft.irfft(np.conj(one) * two, size)[np.arange(-reach, reach + 1)]
    best = int(np.argmax(products))
    if best in (0, 2 * reach):
        return None
    left, top, right = products[best - 1 : best + 2]
    between = float(0.5 * (left - right) / (left - 2 * top + right))
    correlation = float(products[best]) / (power[0] * power[1]) ** 0.5
    return (best - reach + between) * FINE_US, correlation


def line_of(lags: Sequence[tuple[int, float, float]]) -> tuple[Shift, Clock]:
    """Fit a clock to hours' times, lags [us] and correlations: median slope (Theil-Sen) and median rest."""
    times, lag_us, correlations = (np.array(column, np.float64) for column in zip(*lags, strict=True))
    at = int(np.median(times))
    drift = 0.0
    if len(lags) >= HOURS_OF_DRIFT:
        one, two = np.triu_indices(len(lags), 1)
        drift = float(np.median((lag_us[two] - lag_us[one]) / (times[two] - times[one])))
    left = lag_us - drift * (times - at)
    lag = float(np.median(left))
    residual_ms = float(np.sqrt(np.mean((left - lag) ** 2))) / 1000
    clock = Clock(lag / MICROSECONDS, drift * 1e6, residual_ms, float(np.median(correlations)), len(lags))
    return Shift(lag, drift, at), clock


def _deviations(devices: Sequence[_Device], shifts: Sequence[Shift]) -> tuple[Floats, int]:
    """Return sums of each device's squared deviations, (devices, 8) [g2], and the number of cells."""
    least = [LEAST_MEASURED * one.run.reader.recording.rate_hz * CELL_US / MICROSECONDS for one in devices]
    sums, cells = np.zeros((len(devices), 2 * len(AXES))), 0
    streams = [one.hours(CELL_US, shift, one.transforms) for one, shift in zip(devices, shifts, strict=True)]
    for _, tables in side_by_side(streams):
        whole = [table for table in tables if table is not None]
        if len(whole) < len(tables):
            continue
        enough = [table[:, 0] >= number for table, number in zip(whole, least, strict=True)]
        both = np.logical_and.reduce(enough)
        cells += int(both.sum())
        means = np.array([table[both, 1:] / table[both, :1] for table in whole]) * (MG / 1000)
        sums += ((means - means.mean(axis=0)) ** 2).sum(axis=1)
    return sums, cells


NORM = AXES.index("norm")
HEAD = ("lag s", "drift ppm", "residual ms", "correlation")
FIGURES = tuple(f"{axis}_{when}_mg" for axis in AXES for when in ("before", "after"))


@click.command(
    "homogeneity",
    cls=Command,
    examples=(
        "evaluate homogeneity left.cwa right.cwa",
        "evaluate homogeneity left.cwa right.cwa --accept 5",
    ),
)
@click.argument("recordings", nargs=-1, required=True, type=options.FILE)
@click.option("--largest-lag", "largest_lag_s", type=Positive(), default=60.0, show_default=True,
              metavar="SECONDS", help="How far the devices' clocks may be apart.")  # fmt: skip
@click.option("--accept", "accept_mg", type=Positive(), metavar="MG",
              help="Exit with code 1 if one is refused, or its calibrated |a| deviates by more.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object.")
@click.option("--csv", "as_csv", is_flag=True, help="Print a CSV table.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@options.laboratory_options
@options.parts_option
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Show how alike RECORDINGs are of devices that were moved together, raw and calibrated.

    Their clocks are brought together by cross-correlation. Then each is compared with the mean of all, in
    means of a second: root mean square of the deviations of x, y, z and |a|, before and after calibration.
    Devices have to be fixed to each other, with their axes in the same directions; |a| alone does not ask
    for that.
    """
    refuse_both(as_json=values["as_json"], as_csv=values["as_csv"])
    if len(recordings) < 2:
        raise UsageError("one recording has nothing to be compared with", hint="give two or more")
    request = Request(
        options=read_options(values),
        settings=chosen_settings(values),
        chunk_samples=values["chunk_samples"],
        parts=values["parts"],
        joined=values["parts"],
    )
    with progress_bars("homogeneity", quiet=values["quiet"]) as bars:
        found = homogeneity(recordings, request, values["largest_lag_s"], bars)
    exit_codes.show(_shown(found, values))
    limit_mg = values["accept_mg"]
    accepted = limit_mg is None or all(_within(one, limit_mg) for one in found.recordings)
    return exit_codes.OK if accepted else exit_codes.SOME_FAILED


def _within(one: Compared, limit_mg: float) -> bool:
    return one.likeness is not None and one.likeness.rms_mg()[1][NORM] <= limit_mg


def _shown(found: Homogeneity, values: dict[str, Any]) -> str:
    limit_mg = values["accept_mg"]
    if values["as_json"]:
        recordings = [
            {
                "recording": printable(one.path),
                **{name: getattr(one, name) for name in ("serial", "outcome", "message")},
                "clock": one.clock and asdict(one.clock),
                "likeness": one.likeness and _likeness_json(one.likeness),
                "accepted": None if limit_mg is None else _within(one, limit_mg),
            }
            for one in found.recordings
        ]
        together = _likeness_json(found.together)
        return json.dumps({"recordings": recordings, "seconds": found.seconds, "together": together})
    if values["as_csv"]:
        clock = ("lag_s", "drift_ppm", "residual_ms", "correlation")
        head = ("recording", "serial", "outcome", *clock, *FIGURES)
        return csv_text(head, [_csv_row(one) for one in found.recordings]).rstrip("\n")
    return printable(_text(found, limit_mg), kept="\n")


def _likeness_json(likeness: Likeness) -> dict[str, Any]:
    """Return mean squares [g2] and their roots [mg], by axis."""
    squares = zip(("before", "after"), (likeness.before, likeness.after), likeness.rms_mg(), strict=True)
    return {
        when: {"mean_square_g2": dict(zip(AXES, g2, strict=True)), "rms_mg": dict(zip(AXES, mg, strict=True))}
        for when, g2, mg in squares
    }


def _csv_row(one: Compared) -> list[object]:
    clock, likeness = one.clock, one.likeness
    row: list[object] = [printable(one.path), one.serial, one.outcome]
    if clock is None or likeness is None:
        return row + [None] * (4 + len(FIGURES))
    values = [value for pair in zip(*likeness.rms_mg(), strict=True) for value in pair]
    return [*row, clock.lag_s, clock.drift_ppm, clock.residual_ms, clock.correlation, *values]


def _text(found: Homogeneity, limit_mg: float | None) -> str:
    """Return a table with a row for each device, and one for all; figures in mg, before > after."""
    head = ["", *HEAD, *AXES[:NORM], "|a|", *(["accepted"] if limit_mg is not None else [])]
    rows = []
    for one in found.recordings:
        name = one.path.name if one.serial is None else f"{one.path.name} ({one.serial})"
        rows.append([name, *_clock(one), *_pairs(one.likeness)])
        if limit_mg is not None:
            rows[-1].append("yes" if _within(one, limit_mg) else "no")
    last = ["all", *["-"] * len(HEAD), *_pairs(found.together)]
    rows.append([*last, *([""] if limit_mg is not None else [])])
    before, after = (rms[NORM] for rms in found.together.rms_mg())
    times = f"{before / after:.1f} times smaller" if after else "nothing"
    return "\n".join(
        [
            f"{len(found.recordings)} recordings, {found.seconds} s in common. Root mean square deviation "
            "from their mean, before > after calibration [mg]:",
            aligned(head, rows),
            f"|a| after calibration: {times}",
            *(f"{one.path}: refused: {one.message}" for one in found.recordings if one.likeness is None),
        ]
    )


def _clock(one: Compared) -> list[str]:
    clock = one.clock
    if clock is None:
        return ["-"] * len(HEAD)
    shown = ((clock.lag_s, "+.3f"), (clock.drift_ppm, "+.1f"), (clock.residual_ms, ".1f"))
    return [*(formatted(value, form) for value, form in shown), formatted(clock.correlation, ".3f")]


def _pairs(likeness: Likeness | None) -> list[str]:
    if likeness is None:
        return ["-"] * len(AXES)
    return [f"{figure(before)} > {figure(after)}" for before, after in zip(*likeness.rms_mg(), strict=True)]
