"""Reads EDF and BDF files: data records are pages, with their own times in EDF+D."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, rate_fraction, start_of
from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions, agreed_rate
from accelcal_cli.core.recording import (
    CUT_SHORT,
    FLOAT_LSB_PER_G,
    LARGEST_LSB_PER_G,
    Counts,
    Device,
    Problem,
    Reader,
    Recording,
    first_row,
)
from accelcal_cli.core.vocabulary import (
    ACCELERATION_UNITS,
    ACCELEROMETER,
    GIVE_UNIT,
    GYROSCOPE,
    NOT_RAW,
    THERMOMETER,
    Quantity,
    unit_of,
)
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats._pages import pages as paged
from accelcal_cli.formats._pages.files import PagedFile, RawBlock
from accelcal_cli.formats._pages.pages import Decoded, PageBlock
from accelcal_cli.formats._pages.reader import FixedPages, PageDecoder
from accelcal_cli.formats._pages.timeline import ExactTimeline, NominalTimeline, PageTimeline, Spacing
from accelcal_cli.formats._rows import MISSING
from accelcal_cli.formats.edf import BDF_MAGIC

# The header of an EDF or BDF file, and the choice of the signals that are read.
#
# The header has fields of text, first of the recording, then of all signals one by one: 256 bytes,
# and 256 more for each signal. Widths and order are those of www.edfplus.info/specs.
#
# A physical value is physical_min + (d - digital_min) * gain, with an exact gain from the header's
# texts. The common step of all axes is the largest number of which every gain and every value of d =
# 0 is a multiple: counts in that step are whole and exact. If they would need more than 32 bits,
# values are put on the grid that decimal fractions have in all formats.

FIRST_BYTES, MOST_SIGNALS = 256, 4096
LARGEST_RECORD, PIVOT = 1 << 24, 85
"""Most bytes in a record (recommended: at most 61 440), and the first two-digit year of the last century."""

MONTHS = ("JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC")
EDF_PLUS_DATE = re.compile(r"Startdate (\d\d)-([A-Z]{3})-(\d{4}) \S+ \S+ (\S+)")
NUMBER = re.compile(r"[+-]?(\d{1,8}(\.\d{0,8})?|\.\d{1,8})([eE][+-]?\d{1,3})?")
COPY_AGAIN = "copy it again from its source"
ANNOTATIONS = ("EDF Annotations", "BDF Annotations")

RECORDING_FIELDS = (
    *(("version", 8), ("patient", 80), ("recording", 80), ("date", 8), ("time", 8), ("bytes", 8)),
    *(("reserved", 44), ("records", 8), ("seconds", 8), ("signals", 4)),
)
SIGNAL_FIELDS = (
    *(("label", 16), ("transducer", 80), ("dimension", 8), ("physical_min", 8), ("physical_max", 8)),
    *(("digital_min", 8), ("digital_max", 8), ("filter", 80), ("samples", 8), ("reserved", 32)),
)
"""Names and widths [bytes] of the fields; in the second part each field has the texts of all signals."""

GLUED = re.compile(rf"({'|'.join(sorted(ACCELEROMETER | GYROSCOPE))})([xyz])")
MOST_COUNTS = (1 << 31) - 1


@dataclass(frozen=True, slots=True)
class Signal:
    """One signal, as the header describes it.

    Attributes:
        number: its place, from 0.
        dimension: the unit of its physical values.
        limits: texts of physical minimum and maximum, and of digital minimum and maximum.
        samples: number in each record.
        offset: number of samples before it in a record.
        byte_offset: where its physical minimum stands in the file.
    """

    number: int
    label: str
    dimension: str
    limits: tuple[str, str, str, str]
    samples: int
    offset: int
    byte_offset: int


@dataclass(frozen=True, slots=True)
class Header:
    """The content of a header.

    Attributes:
        sample_bytes: 2 in EDF, 3 in BDF.
        plus: `C` or `D` (with gaps) for EDF+ and BDF+, else None.
        start_us: microseconds since 1970 on the device's clock; None if it is not a date.
        records: number of data records; None if it was not known.
        seconds: length of a record.
    """

    sample_bytes: int
    plus: str | None
    device: Device
    start_us: int | None
    records: int | None
    seconds: Fraction
    signals: tuple[Signal, ...]

    @property
    def header_bytes(self) -> int:
        """Offset of the first record [bytes]."""
        return FIRST_BYTES * (1 + len(self.signals))

    @property
    def record_bytes(self) -> int:
        """Length of a record [bytes]."""
        return self.sample_bytes * sum(signal.samples for signal in self.signals)


def number_in(text: str) -> Fraction | None:
    """Return a number as headers write it, exactly; None if the text is not a number."""
    text = text.strip().replace(",", ".")
    return Fraction(text) if NUMBER.fullmatch(text) else None


def read_header(path: Path) -> Header:
    """Read and check a header; raises UnreadableError, with the place, if it is cut off or damaged."""
    with ByteSource(path) as source:
        fields = _split(source.read_exact(FIRST_BYTES), RECORDING_FIELDS, 1)
        signals = _whole(fields["signals"][0], 252, path, "number of signals", 1, MOST_SIGNALS)
        table = _split(source.read_exact(FIRST_BYTES * signals), SIGNAL_FIELDS, signals)
    if len(table["reserved"][-1]) < SIGNAL_FIELDS[-1][1]:
        raise UnreadableError("its header is cut off", path=path, byte_offset=0, hint=COPY_AGAIN)
    _whole(fields["bytes"][0], 184, path, "length of the header", *[FIRST_BYTES * (signals + 1)] * 2)
    sample_bytes = 3 if fields["version"][0].encode("latin-1") == BDF_MAGIC else 2
    records = _whole(fields["records"][0], 236, path, "number of records", -1, 10**8)
    seconds = number_in(fields["seconds"][0])
    if seconds is None or not 0 < seconds <= 10**8:
        raise _fault("length of a record", fields["seconds"][0], 244, path)
    texts = fields["recording"][0]
    equipment = match[4].replace("_", " ") if (match := EDF_PLUS_DATE.match(texts)) else "X"
    kind = fields["reserved"][0][:5]
    header = Header(
        sample_bytes,
        kind[4] if kind in ("EDF+C", "EDF+D", "BDF+C", "BDF+D") else None,
        Device(None if equipment == "X" else equipment),
        _start_us(fields["date"][0], fields["time"][0], texts),
        None if records < 0 else records,
        seconds,
        _signals(table, signals, path),
    )
    if not 0 < header.record_bytes <= LARGEST_RECORD:
        what = f"its records would have {header.record_bytes} bytes"
        raise UnreadableError(what, path=path, byte_offset=FIRST_BYTES, hint=COPY_AGAIN)
    return header


def _split(data: bytes, parts: tuple[tuple[str, int], ...], count: int) -> dict[str, list[str]]:
    """Return `count` texts of each field; those beyond the end of the data are empty or cut."""
    fields, text, place = {}, data.decode("latin-1"), 0
    for name, width in parts:
        fields[name] = [text[place + width * k : place + width * (k + 1)] for k in range(count)]
        place += width * count
    return fields


def _whole(text: str, offset: int, path: Path, what: str, low: int, high: int) -> int:
    value = number_in(text)
    if value is None or value.denominator != 1 or not low <= value <= high:
        raise _fault(what, text, offset, path)
    return int(value)


def _fault(what: str, text: str, offset: int, path: Path) -> UnreadableError:
    return UnreadableError(
        f"the {what} in its header is {text.strip()!r}", path=path, byte_offset=offset, hint=COPY_AGAIN
    )


def _signals(table: dict[str, list[str]], count: int, path: Path) -> tuple[Signal, ...]:
    at = {name: FIRST_BYTES + count * sum(width for _, width in SIGNAL_FIELDS[:place])
          for place, (name, _) in enumerate(SIGNAL_FIELDS)}  # fmt: skip
    samples = [
        _whole(text, at["samples"] + 8 * number, path, "number of samples", 0, LARGEST_RECORD)
        for number, text in enumerate(table["samples"])
    ]
    limits = zip(*(table[name] for name, _ in SIGNAL_FIELDS[3:7]), strict=True)
    offsets = [0, *accumulate(samples)]
    columns = zip(table["label"], table["dimension"], limits, samples, strict=True)
    return tuple(
        Signal(k, label.strip(), unit.strip(), four, size, offsets[k], at["physical_min"] + 8 * k)
        for k, (label, unit, four, size) in enumerate(columns)
    )


def _start_us(date: str, time: str, recording: str) -> int | None:
    """Return the time of `02.08.51` and `20.15.00`, with EDF+'s year if given; None if it is not a time."""
    try:
        hour, minute, second = map(int, time.split("."))
        match = EDF_PLUS_DATE.match(recording)
        if match is not None and match[2] in MONTHS:
            day, month, year = int(match[1]), MONTHS.index(match[2]) + 1, int(match[3])
        else:
            day, month, year = map(int, date.split("."))
            year += 1900 if year >= PIVOT else 2000
        start = start_of(datetime(year, month, day, hour, minute, second))
    except ValueError:
        return None
    return None if start is None else start.start_us


Signals3 = tuple[Signal, Signal, Signal]


@dataclass(frozen=True, slots=True)
class Axes:
    """Three signals, with a factor and an addend that make whole counts of each one's digital values.

    Attributes:
        step: the exact size of one count, in g or in deg/s.
        limits: counts of each signal's digital minimum and maximum; empty if these do not matter.
        on_grid: counts of that step need more than 32 bits, and are rounded to the grid of decimals.
    """

    signals: Signals3
    factors: tuple[int, ...]
    addends: tuple[int, ...]
    step: Fraction
    limits: tuple[int, ...]
    on_grid: bool = False

    def may_fail(self, sample_bytes: int) -> bool:
        """Return True if samples beyond the digital limits may have no count."""
        widest, lines = 1 << (8 * sample_bytes - 1), zip(self.factors, self.addends, strict=True)
        return max(abs(factor) * widest + abs(addend) for factor, addend in lines) * self._grid > MOST_COUNTS

    @property
    def _grid(self) -> Fraction:
        return self.step * int(FLOAT_LSB_PER_G) if self.on_grid else Fraction(1)

    def counts(self, digital: list[NDArray[Any]], faulty: NDArray[np.bool_] | None) -> Counts:
        """Return digital values (n,) of the signals as counts (n, 3), and mark rows (n,) that have none."""
        if self.factors == (1, 1, 1) and self.addends == (0, 0, 0):
            return np.stack(digital, axis=1)
        grid = self._grid
        values = np.empty((len(digital[0]), 3))
        for axis, column in enumerate(digital):
            values[:, axis] = column * float(self.factors[axis] * grid) + float(self.addends[axis] * grid)
        if faulty is not None:
            faulty |= np.any(np.abs(values) > MOST_COUNTS, axis=1)
            values[faulty] = 0
        return np.rint(values).astype(np.int32)

    @property
    def per_unit(self) -> float:
        """Counts in one unit."""
        return FLOAT_LSB_PER_G if self.on_grid else float(1 / self.step)


@dataclass(frozen=True, slots=True)
class ChosenSignals:
    """The signals that are read.

    With the thermometer's go the thousandths of a degree C in one digital step and at 0; `range_g` is the
    distance from 0 to the nearest end of any axis' digital range.
    """

    accel: Axes
    gyro: Axes | None
    temperature: tuple[Signal, float, float] | None
    range_g: float | None


def label_words(label: str) -> tuple[str, ...]:
    """Split a label into words: `AccX`, `acc_x` and `Accelerometer-X` have the words of sensor and axis."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", re.sub(r"[\[(].*", "", label))
    parts: list[str] = []
    for word in re.findall(r"[a-z]+|\d+", spaced.lower()):
        glued = GLUED.fullmatch(word)
        parts += glued.groups() if glued else [word]
    return tuple(parts)


def choose(header: Header, options: ReadOptions, path: Path) -> ChosenSignals:
    """Choose the signals of the accelerometer, and those that belong to it; raises an error without any."""
    by_label = options.columns is None
    signals = (_signals_by_label if by_label else _signals_by_option)(header, options, path)
    if len({signal.samples for signal in signals}) > 1 or not signals[0].samples:
        rates = ", ".join(f"{signal.label}: {signal.samples}" for signal in signals)
        raise UnreadableError(f"x, y and z have different rates (samples in a record: {rates})", path=path,
                              hint="name three signals of one rate with --columns")  # fmt: skip
    accel = _acceleration_axes(signals, options, path)
    ends = [abs(limit) / accel.per_unit for limit in accel.limits]
    crosses = [low * high < 0 for low, high in zip(accel.limits[::2], accel.limits[1::2], strict=True)]
    range_g = min(ends) if crosses and all(crosses) else None
    return ChosenSignals(accel, _gyro(header, signals, path), _temperature(header, path), range_g)


def _signals_by_option(header: Header, options: ReadOptions, path: Path) -> Signals3:
    usable = [signal for signal in header.signals if signal.label not in ANNOTATIONS]
    picked: list[Signal] = []
    for wanted in map(str.strip, options.columns or ()):
        found = [signal for signal in usable if signal.label.lower() == wanted.lower()]
        if not found and wanted.isdecimal():
            found = [signal for signal in usable if signal.number == int(wanted)]
        if len(found) != 1:
            what = f"--columns {wanted!r} is {'several signals' if found else 'no signal'} of this file"
            raise UsageError(what, path=path, hint=f"its signals are {_labels(header)}")
        picked += found
    x, y, z = picked
    if len({x.number, y.number, z.number}) < 3:
        raise UsageError("--columns names one signal twice", path=path, hint="give x, y and z")
    return x, y, z


def _labels(header: Header) -> str:
    shown = [f"{signal.number} ({signal.label})" for signal in header.signals[:40]]
    return ", ".join(shown) + ", ..." * (len(header.signals) > len(shown))


def _groups(header: Header, names: frozenset[str], quantity: Quantity) -> dict[str, Signals3]:
    """Return the sensors of a kind that have one signal for each axis, by the other words of their labels."""
    found: dict[str, tuple[list[Signal], ...]] = {}
    others = (ACCELEROMETER | GYROSCOPE) - names | NOT_RAW
    for signal in header.signals:
        parts = label_words(signal.label)
        axes = [part for part in parts if part in ("x", "y", "z")]
        known = names & set(parts) or unit_of(signal.dimension, quantity)
        if len(axes) == 1 and known and others.isdisjoint(parts):
            rest = " ".join(part for part in parts if part not in (*axes, *names, "axis"))
            found.setdefault(rest, ([], [], []))["xyz".index(axes[0])].append(signal)
    return {name: (x[0], y[0], z[0]) for name, (x, y, z) in found.items() if len(x) == len(y) == len(z) == 1}


def _signals_by_label(header: Header, options: ReadOptions, path: Path) -> Signals3:
    groups = every = _groups(header, ACCELEROMETER, Quantity.ACCELERATION)
    sensor = options.one_sensor
    if sensor is not None:
        wanted = " ".join(label_words(sensor))
        groups = {name: group for name, group in every.items() if name == wanted}
    if len(groups) == 1:
        return next(iter(groups.values()))
    if groups or sensor is not None:
        names = ", ".join(name or "(no name)" for name in every)
        what = f"no sensor is called {sensor!r}" if sensor else "it has several accelerometers"
        hint = f"give --sensor NAME ({names}), or --columns with three signals"
        raise UsageError(what, path=path, hint=hint, sensors=() if sensor else [*every])
    raise UnreadableError(
        f"cannot tell which signals are x, y and z of an accelerometer: {_labels(header)}",
        path=path,
        hint="name them with --columns, by label or number",
    )


def _scaling(signal: Signal, path: Path) -> tuple[Fraction, Fraction, int, int]:
    """Return the physical value of one digital step and of 0, and the digital limits, or raise an error."""
    low, high, first, last = map(number_in, signal.limits)
    if low is None or high is None or first is None or last is None or low == high or first >= last:
        limits = ", ".join(map(str.strip, signal.limits))
        raise UnreadableError(
            f"the range of signal {signal.label!r} is not usable ({limits})",
            path=path,
            byte_offset=signal.byte_offset,
            hint="name other signals with --columns, or give --unit counts with --lsb-per-g",
        )
    gain = (high - low) / (last - first)
    return gain, low - first * gain, math.floor(first), math.ceil(last)


def _acceleration_axes(signals: Signals3, options: ReadOptions, path: Path) -> Axes:
    """Return the axes of the acceleration in g; raises an error for an unknown unit or impossible scale."""
    if options.unit == "counts" or (options.unit is None and options.lsb_per_g is not None):
        if options.lsb_per_g is None:
            hint = "give --lsb-per-g, the counts in one g"
            raise UsageError("counts need their scale", path=path, hint=hint)
        return Axes(signals, (1, 1, 1), (0, 0, 0), 1 / Fraction(options.lsb_per_g), ())
    found = [unit_of(signal.dimension, Quantity.ACCELERATION) for signal in signals]
    units = {options.unit or (None if unit is None else unit.name) for unit in found}
    unit = units.pop()
    if units or unit is None:
        what = ", ".join(repr(signal.dimension) for signal in signals)
        raise UnreadableError(
            f"the unit of the acceleration is not known ({what})", path=path, hint=GIVE_UNIT
        )
    axes = _axes(signals, ACCELERATION_UNITS[unit].per_g, path)
    if not 1 <= axes.per_unit <= LARGEST_LSB_PER_G:
        what, at = f"{axes.per_unit:g} counts in one g are impossible", signals[0].byte_offset
        hint = "give --unit, or --unit counts with --lsb-per-g"
        raise UnreadableError(what, path=path, byte_offset=at, hint=hint)
    return axes


def _is_plain(signal: Signal, quantity: Quantity) -> bool:
    """Return True for a signal in deg/s, or in degrees Celsius."""
    unit = unit_of(signal.dimension, quantity)
    return unit is not None and unit.per == 1.0 and unit.name in ("deg/s", "C")


def _axes(signals: Signals3, per_unit: Fraction, path: Path) -> Axes:
    """Return axes with counts of the largest step of which all values are multiples."""
    lines = [_scaling(signal, path) for signal in signals]
    values = [value / per_unit for line in lines for value in line[:2]]
    denominator = math.lcm(*(value.denominator for value in values))
    step = Fraction(math.gcd(*(int(value * denominator) for value in values)), denominator)
    factors, addends = (tuple(int(line[place] / per_unit / step) for line in lines) for place in (0, 1))
    ends = tuple(
        int(line[place]) * factor + addend
        for line, factor, addend in zip(lines, factors, addends, strict=True)
        for place in (2, 3)
    )
    fine = max(map(abs, ends)) > MOST_COUNTS or 1 / step > LARGEST_LSB_PER_G
    if fine:
        grid = step * int(FLOAT_LSB_PER_G)
        ends = tuple(int(end * grid) for end in ends)
    return Axes(signals, factors, addends, step, ends, fine)


def _gyro(header: Header, accel: Signals3, path: Path) -> Axes | None:
    """Return the one gyroscope of the same rate in deg/s; None if there is none with a usable scale."""
    groups = _groups(header, GYROSCOPE, Quantity.ROTATION)
    fitting = [
        group
        for group in groups.values()
        if all(_is_plain(one, Quantity.ROTATION) and one.samples == accel[0].samples for one in group)
    ]
    with suppress(UnreadableError):
        if len(fitting) == 1 and not (axes := _axes(fitting[0], Fraction(1), path)).on_grid:
            return axes
    return None


def _temperature(header: Header, path: Path) -> tuple[Signal, float, float] | None:
    named = [signal for signal in header.signals if {*THERMOMETER} & set(label_words(signal.label))]
    found = [signal for signal in named if _is_plain(signal, Quantity.TEMPERATURE) and signal.samples]
    with suppress(UnreadableError):
        if len(found) == 1:
            gain, zero, _, _ = _scaling(found[0], path)
            return found[0], float(1000 * gain), float(1000 * zero)
    return None


# Reads EDF and BDF files.

ONSET = re.compile(rb"([+-])(\d{1,9})(?:\.(\d{0,9}))?\x14", re.ASCII)
"""First annotation of each record: seconds from the start at which the record begins."""

RATES_HZ = (0.001, 100_000.0)
NO_START = "the header has no date; times count from 1970-01-01"
MILLIKELVIN_ZERO, HOTTEST = -273_150, 1_000_000


class RecordDecoder(PageDecoder[RawBlock]):
    """Decodes blocks of data records; says at the end if they are not as many as the header claims."""

    def __init__(self, header: Header, chosen: ChosenSignals, start_us: int) -> None:
        self._header, self._chosen, self._start_us = header, chosen, start_us
        self._annotations = annotations_of(header)
        sensors = [axes for axes in (chosen.accel, chosen.gyro) if axes is not None]
        self._may_fail = any(axes.may_fail(header.sample_bytes) for axes in sensors)

    def decode(self, raw: RawBlock) -> Decoded:
        """Decode the records of a block; in EDF+D, only those whose time can be read."""
        pages, position = raw.pages, raw.first_position + np.arange(len(raw.pages))
        bad: list[paged.BadRun] = []
        stamps = None
        if self._header.plus == "D" and self._annotations is not None:
            onsets = [self.onset_us(page) for page in pages]
            status = np.array([paged.GOOD if onset is not None else paged.TEXT for onset in onsets], np.uint8)
            bad = paged.bad_runs(status, raw.first_position)
            pages, position = pages[status == paged.GOOD], position[status == paged.GOOD]
            stamps = np.array([self._start_us + onset for onset in onsets if onset is not None], np.int64)
        return Decoded(self._block(pages, position, stamps), bad, raw.tail)

    def ending(self, raw: RawBlock, sample: int) -> tuple[Problem, ...]:
        """See PageDecoder."""
        records, seen = self._header.records, raw.next_position
        if records is None or records == seen:
            return ()
        text = f"the header says {records} data records, and the file holds {seen}"
        if seen > records:
            return (Problem("wrong_count", text, raw.offset(seen), sample),)
        missing = (records - seen) * self._header.record_bytes - len(raw.tail)
        return (Problem(CUT_SHORT, text, raw.offset(seen), sample, missing_bytes=missing),)

    def onset_us(self, page: NDArray[np.uint8]) -> int | None:
        """Return the microseconds from the header's start to a record's; None if it does not say."""
        if self._annotations is None:
            return None
        match = ONSET.match(self._bytes(page[np.newaxis], self._annotations).tobytes())
        if match is None:
            return None
        fraction = int((match[3] or b"").ljust(9, b"0")) + 500
        onset = int(match[2]) * MICROSECONDS + fraction // 1000
        return -onset if match[1] == b"-" else onset

    def _block(
        self, pages: NDArray[np.uint8], position: NDArray[np.int64], stamps: NDArray[np.int64] | None
    ) -> PageBlock:
        chosen, rows = self._chosen, self._chosen.accel.signals[0].samples
        faulty = np.zeros(len(pages) * rows, np.bool_) if self._may_fail else None
        counts = chosen.accel.counts([self._digital(pages, one) for one in chosen.accel.signals], faulty)
        channels: dict[str, NDArray[Any]] = {}
        if chosen.gyro is not None:
            turning = [self._digital(pages, one) for one in chosen.gyro.signals]
            channels["gyro_counts"] = chosen.gyro.counts(turning, faulty)
        if chosen.temperature is not None:
            channels["temperature_mc"] = self._temperature(pages, rows)
        return PageBlock(
            position=position,
            rows=np.full(len(pages), rows, np.int64),
            counts=counts,
            time_us=stamps,
            faulty=faulty,
            channels=channels,
        )

    def _bytes(self, pages: NDArray[np.uint8], signal: Signal) -> NDArray[np.uint8]:
        size = self._header.sample_bytes
        start = signal.offset * size
        return np.ascontiguousarray(pages[:, start : start + signal.samples * size])

    def _digital(self, pages: NDArray[np.uint8], signal: Signal) -> NDArray[Any]:
        """Return a signal's digital values, (n,): int16, or int32 for BDF."""
        data = self._bytes(pages, signal)
        if self._header.sample_bytes == 2:
            return data.view("<i2").reshape(-1).astype(np.int16)
        low, middle, high = data.reshape(-1, 3).T.astype(np.int32)
        return np.asarray(low | middle << 8 | (high ^ 0x80) - 0x80 << 16)

    def _temperature(self, pages: NDArray[np.uint8], rows: int) -> NDArray[np.int32]:
        """Return for each row the last value before its end, (n,) thousandths of a degree C."""
        assert self._chosen.temperature is not None
        signal, gain, zero = self._chosen.temperature
        values = np.rint(self._digital(pages, signal) * gain + zero)
        measured = (values >= MILLIKELVIN_ZERO) & (values <= HOTTEST)
        milli = np.where(measured, values, MISSING).astype(np.int32)
        place = np.arange(rows) * signal.samples // rows
        return milli.reshape(len(pages), signal.samples)[:, place].reshape(-1)


def annotations_of(header: Header) -> Signal | None:
    """Return the signal whose first annotation is the time of a record."""
    return next((one for one in header.signals if one.label in ANNOTATIONS and one.samples), None)


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open an EDF or BDF file; `Format.open` says what is raised."""
    header = read_header(path)
    chosen = choose(header, options, path)
    rate_hz = float(chosen.accel.signals[0].samples / header.seconds)
    if not RATES_HZ[0] <= rate_hz <= RATES_HZ[1]:
        what = f"a sampling rate of {rate_hz:g} Hz is impossible"
        raise UnreadableError(what, path=path, byte_offset=244, hint=COPY_AGAIN)
    rate = rate_fraction(agreed_rate(options, rate_hz, path))
    file = PagedFile.at(path, header.header_bytes, header.record_bytes, proved=False)
    decoder = RecordDecoder(header, chosen, header.start_us or 0)
    spacing = Spacing(rate, chosen.accel.signals[0].samples)
    timed = header.plus == "D" and annotations_of(header) is not None
    start_us = header.start_us or 0
    if not timed:  # EDF+ may add a fraction of a second to the header's start
        first = next(file.blocks(file.amount(1))).pages[:1]
        onset = decoder.onset_us(first[0]) if len(first) else None
        start_us += onset if onset is not None and 0 <= onset < MICROSECONDS else 0

    def timeline() -> PageTimeline:
        return ExactTimeline(spacing) if timed else NominalTimeline(spacing, start_us)

    scheme = FixedPages(file, spacing, lambda: decoder, timeline)
    opening = scheme.look_inside()
    if opening is None:
        what = "has no usable data record" + (" whose time can be read" if timed else "")
        raise UnreadableError(what, path=path, byte_offset=header.header_bytes, hint=COPY_AGAIN)
    problems = () if header.start_us is not None else (Problem("no_start_time", NO_START, 168, 0),)
    about = recording(path, rate, file.size, header, chosen)
    return scheme.reader(opening, about, problems, dated=header.start_us is not None)


def recording(path: Path, rate: Fraction, size: int, header: Header, chosen: ChosenSignals) -> Recording:
    """Describe the file as far as the header does."""
    labels = ", ".join(f"{one.label} [{one.dimension}]" for one in chosen.accel.signals)
    notes = [f"x, y, z: {labels}"]
    if chosen.accel.on_grid:
        notes.append("x, y and z have scales without a common step; they were rounded to 0.06 micro-g")
    return Recording(
        path=path,
        format="edf",
        rate_hz=float(rate),
        lsb_per_g=chosen.accel.per_unit,
        total_bytes=size,
        device=header.device,
        range_g=chosen.range_g,
        gyro_dps_per_lsb=None if chosen.gyro is None else (float(chosen.gyro.step),) * 3,
        zero_counts=first_row(chosen.accel.counts([np.zeros(1, np.int16)] * 3, np.zeros(1, np.bool_))),
        notes=tuple(notes),
    )
