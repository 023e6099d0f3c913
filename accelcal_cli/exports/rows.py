"""Rows of a calibrated Parquet file: read back a portion at a time, resampled to a fixed rate, smoothed.

Both filters work on one stretch without a gap at a time: gaps stay gaps, and nothing is made up beyond the
ends of a stretch.

The resampling filter is that of `scipy.signal.resample_poly` by default: a sinc with its cutoff at the lower
of the two Nyquist frequencies, ten zero crossings to each side, in a Kaiser window of beta 5. It is evaluated
at the times of the outputs by the samples' own times, since a device's clock is hardly ever at its nominal
rate: at a ratio of nominal rates, times would be wrong by minutes after a week. Its weights are scaled to a
sum of 1, so that a device at rest measures the same as before, also at the ends of a stretch.

The rolling mean is G's noise filter (Grammenos, Mascolo, Crowcroft 2018, section 4.6 and Table 2), as wide as
the sampling rate asks, but centred, so that nothing is delayed; G, whose filter runs while it measures, takes
the samples before. Rows that the device filled in, and those of damaged blocks, stay as they are and end a
stretch. Only values that are written are filtered: a filter before the test of stillness would make movement
look still.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime
from fractions import Fraction
from itertools import pairwise
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, StampClock
from accelcal_cli.core.errors import UnreadableError, printable
from accelcal_cli.core.identity import SAMPLES, refuse_other
from accelcal_cli.core.local_time import UTC
from accelcal_cli.core.paths import is_file
from accelcal_cli.core.recording import Validity
from accelcal_cli.core.results import Outcome
from accelcal_cli.output.files import metadata_of, stored_schema
from accelcal_cli.output.report_reading import section

if TYPE_CHECKING:
    from accelcal_cli.parquet import ParquetSource

NAMES = ("time", "x", "y", "z")
NAME_ONE = "name a Parquet file that accelcal wrote, NAME.calibrated.parquet"
NOT_MEASURED = (Validity.FILLED, Validity.RECOVERED)
"""Marks of rows that `--measured-only` leaves out; a clipped row was measured, up to the sensor's limit."""

CROSSINGS = 10
BETA = 5.0
PHASES = 2048
"""Positions between two samples for which the filter is tabulated; linear between them it is within 1e-6."""

LONGEST_STEP = 1.5
"""Longest step within a stretch, in periods."""

RESAMPLED_ROWS = 1 << 13

SMOOTHED_ROWS = 1 << 17
"""Number of rows that are averaged at a time."""

WIDTHS = (3, 5, 10, 20)
"""Widths of the filter [samples], as in Table 2."""

UP_TO_HZ = (20.0, 80.0, 120.0)
"""Rates [Hz] up to which each width but the last is meant; the table has 80 Hz twice."""

WIDEST = 1000
"""The widest filter [samples]."""

STEPS_PER_UNIT = float(1 << 32)
"""Steps in one unit: values are summed as whole numbers of them, so that their order does not matter."""

LAST = 1 << 62
LEAST_RATIO, LARGEST_RATIO = 0.01, 100.0
"""Smallest and largest ratio of output rate to input rate.

Beyond them, one output would need thousands of samples.
"""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class SampleRows:
    """n consecutive rows.

    Attributes:
        time_us: (n,) us since 1970.
        xyz: (n, 3) calibrated acceleration [g], float32.
        celsius: (n,) temperature [degrees C], float32; None without thermometer.
        others: (n,) further columns, by name; resampled rows have none.
    """

    time_us: NDArray[np.int64]
    xyz: NDArray[np.float32]
    celsius: NDArray[np.float32] | None
    others: dict[str, NDArray[Any]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.time_us)

    @property
    def clock(self) -> StampClock:
        """The times as a clock."""
        return StampClock(self.time_us)

    def part(self, start: int, stop: int) -> SampleRows:
        """Return rows start..stop-1."""
        return self.kept(slice(start, stop))

    def kept(self, rows: Any) -> SampleRows:
        """Return some of the rows, by a slice or a mask."""
        celsius = None if self.celsius is None else self.celsius[rows]
        others = {name: values[rows] for name, values in self.others.items()}
        return SampleRows(self.time_us[rows], self.xyz[rows], celsius, others)

    @property
    def validity(self) -> NDArray[np.uint8]:
        """Origin of each row, (n,); measured if no column says it."""
        marks = self.others.get("validity")
        return np.zeros(len(self), np.uint8) if marks is None else marks


def joined_rows(parts: Sequence[SampleRows]) -> SampleRows:
    """Join rows that follow each other, at least one stretch of them."""
    if len(parts) == 1:
        return parts[0]
    celsius = [part.celsius for part in parts if part.celsius is not None]
    return SampleRows(
        np.concatenate([part.time_us for part in parts]),
        np.concatenate([part.xyz for part in parts]),
        np.concatenate(celsius) if len(celsius) == len(parts) else None,
        {name: np.concatenate([part.others[name] for part in parts]) for name in parts[0].others},
    )


@dataclass(frozen=True, slots=True)
class CalibratedFile:
    """The description of a calibrated file.

    Attributes:
        rate_hz: nominal sampling rate, or the rate of resampled rows.
        utc: times are in UTC; else the device's clock, of an unknown zone.
        clock_ahead_s: seconds that the device's clock is ahead of UTC; 0 if unknown.
        has_temperature: True if rows have a temperature.
        more: names of further columns, without `validity`.
        smoothed: samples of the rolling mean that the file says it has been through; None: of none.
        metadata: the metadata of the file.
    """

    path: Path
    rate_hz: float
    range_g: float | None
    utc: bool
    clock_ahead_s: int
    has_temperature: bool
    recording: dict[str, Any]
    more: tuple[str, ...] = ()
    smoothed: int | None = None
    metadata: dict[str, Any] = field(default_factory=dict)


class CalibratedRows:
    """An open calibrated file.

    Attributes:
        measured_only: leave out rows that the device filled in, and those of damaged blocks.
    """

    def __init__(
        self, source: ParquetSource, about: CalibratedFile, more: Sequence[str] = (), *, measured_only: bool
    ) -> None:
        self._source, self._more, self.about, self.measured_only = source, more, about, measured_only
        self.rows = source.rows

    def portions(self, number: int) -> Iterator[SampleRows]:
        """Yield all rows, at most `number` at a time; no portion is empty.

        Raises:
            UnreadableError: the file is damaged.
        """
        while len((columns := dict(zip(self._source.names, self._source.take(number), strict=True)))["time"]):
            for name in ("time", "validity"):  # numpy has whole numbers that are missing as floats
                if not np.issubdtype(columns[name].dtype, np.integer):
                    text = f"has rows without a value in its column {name}"
                    raise UnreadableError(text, path=self.about.path, hint=NAME_ONE)
            xyz = np.stack([columns[name] for name in "xyz"], axis=1).astype(np.float32, copy=False)
            others = {name: columns[name] for name in (*self._more, "validity")}
            rows = SampleRows(columns["time"], xyz, columns.get("temperature"), others)
            if self.measured_only:
                rows = rows.kept(~np.isin(rows.validity, NOT_MEASURED))
            if len(rows):
                yield rows


@contextmanager
def open_calibrated(
    path: Path, *, measured_only: bool = False, everything: bool = False
) -> Iterator[CalibratedRows]:
    """Open a calibrated file.

    Args:
        everything: rows have all columns of the file.

    Raises:
        UnreadableError: it cannot be read, or accelcal did not write it.
    """
    from accelcal_cli.parquet import ParquetSource  # pyarrow, which no help needs

    about = described_file(path)
    temperature = ("temperature",) if about.has_temperature else ()
    more = about.more if everything else ()
    names = (*NAMES, *temperature, *more, "validity")
    _refuse_other_types(path, names)
    with ParquetSource(path, names) as source:
        yield CalibratedRows(source, about, more, measured_only=measured_only)


def _refuse_other_types(path: Path, names: Sequence[str]) -> None:
    """Raise UnreadableError for a column of another type than accelcal writes, as after a change by hand."""
    from pyarrow import types

    schema = stored_schema(path, UnreadableError)
    assert schema is not None
    for name, kind in ((name, schema.field(name).type) for name in names):
        if name == "time":
            fits = types.is_timestamp(kind) and kind.unit == "us"
        else:
            fits = types.is_integer(kind) or (name != "validity" and types.is_floating(kind))
        if not fits:
            text = f"holds {kind} in its column {printable(name)}, as no calibrated recording of accelcal"
            raise UnreadableError(text, path=path, hint=NAME_ONE)


def described_file(path: Path) -> CalibratedFile:
    """Return the description of a calibrated file; raises UnreadableError as `open_calibrated`."""
    if not is_file(path):
        raise UnreadableError("is not a file that can be read", path=path, hint=NAME_ONE)
    from accelcal_cli.output.columns import described  # pyarrow

    metadata, schema = metadata_of(path, UnreadableError), stored_schema(path, UnreadableError)
    refuse_other(metadata, SAMPLES, path)
    recording = section(metadata, "recording")
    if metadata.get("outcome") == Outcome.REFUSED:
        text = f"holds raw values, since its recording was refused ({metadata.get('message')})"
        raise UnreadableError(printable(text), path=path, hint="export a calibrated recording")
    rate_hz, range_g = recording.get("sample_rate_hz"), recording.get("range_g")
    if schema is None or not isinstance(rate_hz, int | float) or not 0 < rate_hz < 1e6:
        raise UnreadableError("is not a calibrated recording of accelcal", path=path, hint=NAME_ONE)
    file_columns = described(schema)
    if not {*NAMES, "validity"} <= file_columns["columns"].keys():
        raise UnreadableError("lacks columns of a calibrated recording", path=path, hint=NAME_ONE)
    return CalibratedFile(
        path,
        float(rate_hz),
        float(range_g) if isinstance(range_g, int | float) else None,
        file_columns["time_zone"] == UTC,
        _clock_ahead_s(recording.get("start_time")),
        "temperature" in file_columns["columns"],
        recording,
        tuple(name for name in file_columns["columns"] if name not in (*NAMES, "temperature", "validity")),
        section(metadata, "smoothed").get("samples"),
        metadata,
    )


def _clock_ahead_s(start: Any) -> int:
    """Return the offset from UTC of an ISO time [s]; 0 if it has none."""
    try:
        offset = datetime.fromisoformat(str(start)).utcoffset()
    except ValueError:
        return 0
    return 0 if offset is None else round(offset.total_seconds())


def starts_in(rows: SampleRows, last_us: int | None, rate_hz: float) -> NDArray[np.int64]:
    """Return the numbers of the rows that begin a new stretch, by the time of the row before, if any."""
    steps = np.diff(rows.time_us if last_us is None else np.append(last_us, rows.time_us))
    found = np.flatnonzero((steps <= 0) | (steps > LONGEST_STEP * MICROSECONDS / rate_hz))
    return found + (last_us is None)


def resampled(portions: Iterable[SampleRows], rate_hz: float, wanted_hz: float) -> Iterator[SampleRows]:
    """Yield rows at a fixed rate within each unbroken stretch, whatever the portions are.

    Times are those of a stretch's first sample and exact multiples of 1 / wanted_hz after it, to the nearest
    us, up to its last sample. Temperature is linear between samples.
    """
    sampler = _Resampler(rate_hz, wanted_hz)
    for rows in portions:
        starts = starts_in(rows, sampler.last_us, rate_hz).tolist()
        for start, stop in zip([0, *starts], [*starts, len(rows)], strict=True):
            if start in starts:
                yield from sampler.made(finish=True)
            if stop > start:
                sampler.add(rows.part(start, stop))
        yield from sampler.made(finish=False)
    yield from sampler.made(finish=True)


class _Resampler:
    """Resamples one stretch: keeps the samples that outputs still need, and counts the outputs."""

    def __init__(self, rate_hz: float, wanted_hz: float) -> None:
        self._period_us = Fraction(MICROSECONDS) / Fraction(str(wanted_hz))
        cutoff = min(1.0, wanted_hz / rate_hz)
        self._half = ceil(CROSSINGS / cutoff)
        self._table = _table(cutoff, self._half)
        self._parts: list[SampleRows] = []
        self._first_us: int | None = None
        self._done = 0

    @property
    def last_us(self) -> int | None:
        """Time of the last sample of the stretch; None before the first."""
        return int(self._parts[-1].time_us[-1]) if self._parts else None

    def add(self, rows: SampleRows) -> None:
        """Add samples that continue the stretch."""
        if self._first_us is None:
            self._first_us = int(rows.time_us[0])
        self._parts.append(rows)

    def made(self, *, finish: bool) -> Iterator[SampleRows]:
        """Yield the outputs that can be made now; with `finish` all, and end the stretch."""
        if not self._parts or self._first_us is None:
            return
        rows = joined_rows(self._parts)
        since_us = rows.time_us - self._first_us
        known = len(rows) - 1 if finish else len(rows) - 2 - self._half
        if known >= 0:
            stop = int(int(since_us[known]) // self._period_us) + 1
            for start in range(self._done, stop, RESAMPLED_ROWS):
                yield self._block(rows, since_us, start, min(start + RESAMPLED_ROWS, stop))
            self._done = max(self._done, stop)
        if finish:
            self._parts, self._first_us, self._done = [], None, 0
        else:
            needed = int(np.searchsorted(since_us, float(self._done * self._period_us), "right"))
            self._parts = [rows.part(min(max(0, needed - 1 - self._half), len(rows) - 1), len(rows))]

    def _block(self, rows: SampleRows, since_us: NDArray[np.int64], start: int, stop: int) -> SampleRows:
        """Return outputs start..stop-1 of the stretch."""
        period, number = self._period_us, np.arange(start, stop)
        at_us = number * float(period)
        before = np.minimum(np.searchsorted(since_us, at_us, "right") - 1, len(rows) - 1)
        after = np.minimum(before + 1, len(rows) - 1)
        step = np.maximum(since_us[after] - since_us[before], 1)
        between = np.minimum((at_us - since_us[before]) / step, 1.0)
        xyz = self._filtered(rows.xyz, before, between)
        celsius = rows.celsius
        if celsius is not None:
            celsius = (celsius[before] + between * (celsius[after] - celsius[before])).astype(np.float32)
        # The times follow from whole numbers alone.
        top, below = period.as_integer_ratio()
        assert self._first_us is not None
        numbers = number.astype(np.int64 if 2 * stop * top < LAST else object)
        time_us = (self._first_us + (2 * numbers * top + below) // (2 * below)).astype(np.int64)
        return SampleRows(time_us, xyz, celsius)

    def _filtered(
        self, xyz: NDArray[np.float32], before: NDArray[np.int64], between: Floats
    ) -> NDArray[np.float32]:
        """Filter tap by tap, so that an output does not depend on those that are made along with it."""
        phases = self._table.shape[1] - 1
        phase = between * phases
        row = np.minimum(phase.astype(np.int64), phases - 1)
        rest = phase - row
        total, weights = np.zeros((len(before), 3)), np.zeros(len(before))
        for tap, values in enumerate(self._table):
            place = before + (tap - self._half + 1)
            weight = values[row] + rest * (values[row + 1] - values[row])
            weight[(place < 0) | (place >= len(xyz))] = 0.0
            weights += weight
            total += weight[:, np.newaxis] * xyz[np.clip(place, 0, len(xyz) - 1)]
        return np.asarray(total / weights[:, np.newaxis], np.float32)


def _table(cutoff: float, half: int) -> Floats:
    """Return the filter at each of 2 half samples, for outputs at each position after the sample before them.

    Returns:
        (2 half, phases + 1); fewer phases the lower the cutoff, since the filter is as much smoother.
    """
    phases = ceil(PHASES * cutoff)
    distance = np.arange(1 - half, half + 1)[:, np.newaxis] - np.arange(phases + 1) / phases
    inside = np.sqrt(np.maximum(0.0, 1 - (distance * cutoff / CROSSINGS) ** 2))
    window = np.where(np.abs(distance * cutoff) <= CROSSINGS, np.i0(BETA * inside), 0.0)
    return np.asarray(np.sinc(cutoff * distance) * window)


def smoothed(portions: Iterable[SampleRows], rate_hz: float, width: int) -> Iterator[SampleRows]:
    """Yield the same rows with means of up to `width` samples around each, whatever the portions are."""
    stretch, last_us = _Stretch(width), None
    for rows in portions:
        starts = set(starts_in(rows, last_us, rate_hz).tolist())
        measured = ~np.isin(rows.validity, NOT_MEASURED)
        changes = np.flatnonzero(np.diff(measured)) + 1
        borders = sorted({0, len(rows), *starts, *changes.tolist()})
        for start, stop in pairwise(borders):
            if start in starts or not measured[start]:
                yield from stretch.take(None)
            if measured[start]:
                for begin in range(start, stop, SMOOTHED_ROWS):
                    yield from stretch.take(rows.part(begin, min(begin + SMOOTHED_ROWS, stop)))
            else:
                yield rows.part(start, stop)
        last_us = int(rows.time_us[-1])
    yield from stretch.take(None)


class _Stretch:
    """Averages one stretch; keeps rows until the later ones for their means are there."""

    def __init__(self, width: int) -> None:
        self._width = width
        self._before, self._after = reach(width)
        self._waiting: SampleRows | None = None
        self._done = 0

    def take(self, rows: SampleRows | None) -> Iterator[SampleRows]:
        """Yield the rows whose means are known; None ends the stretch."""
        parts = [one for one in (self._waiting, rows) if one is not None]
        if not parts:
            return
        all_rows = joined_rows(parts)
        stop = len(all_rows) - (0 if rows is None else self._after)
        if stop > self._done:
            means = rolling_means(all_rows.xyz, self._width, self._done, stop)
            yield replace(all_rows.part(self._done, stop), xyz=means)
            self._done = stop
        kept = max(0, self._done - self._before)
        self._waiting = None if rows is None else all_rows.part(kept, len(all_rows))
        self._done = 0 if rows is None else self._done - kept


def width_for(rate_hz: float) -> int:
    """Return the width of the filter for a sampling rate, by Table 2."""
    return next((width for width, most in zip(WIDTHS, UP_TO_HZ, strict=False) if rate_hz <= most), WIDTHS[-1])


def reach(width: int) -> tuple[int, int]:
    """Return how many samples before and after its own a mean includes; an even width has one more before."""
    return width // 2, (width - 1) // 2


def rolling_means(values: NDArray[np.float32], width: int, start: int, stop: int) -> NDArray[np.float32]:
    """Return means (m, k) of the samples around rows start..stop-1 of an unbroken stretch (n, k).

    Near an end of the stretch, fewer samples are averaged. Values are rounded to 2^-32 first (|value| < 2^21,
    width up to 1000), so a mean does not depend on what else is in memory.
    """
    before, after = reach(width)
    low, high = max(0, start - before), min(len(values), stop + after)
    whole = np.rint(values[low:high].astype(np.float64) * STEPS_PER_UNIT).astype(np.int64)
    # what a sum loses beyond 64 bits does not show in a difference that fits them
    sums = np.concatenate([np.zeros((1, values.shape[1]), np.int64), np.cumsum(whole, axis=0)])
    rows = np.arange(start, stop)
    first, last = np.maximum(rows - before, 0), np.minimum(rows + after + 1, len(values))
    total = sums[last - low] - sums[first - low]
    return np.asarray(total / ((last - first) * STEPS_PER_UNIT)[:, np.newaxis], np.float32)
