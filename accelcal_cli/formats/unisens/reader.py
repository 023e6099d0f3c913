"""Reads Unisens recordings: the accelerations, and the rotation rates and temperatures measured with them.

`unisens.xml` describes the signals: rates, types of numbers, scales, units, channels. A value is
(number - baseline) * lsbValue, in the signal's unit; `adcZero`, the middle of the converter's range, plays no
part in that. All signals begin at the description's time, each with its own rate and in a file of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import StartTime, rate_fraction
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate
from accelcal_cli.core.paths import is_file, open_found
from accelcal_cli.core.recording import (
    FLOAT_LSB_PER_G,
    LARGEST_LSB_PER_G,
    Channels,
    Counts,
    Device,
    OtherColumn,
    Others,
    Problem,
    Reader,
    Recording,
    first_row,
    no_others,
    uniquely_named,
)
from accelcal_cli.core.vocabulary import (
    ACCELERATION_UNITS,
    PER_G,
    THERMOMETER,
    UNKNOWN_UNIT,
    Quantity,
    acceleration_unit,
    quantity_of,
    unit_of,
)
from accelcal_cli.core.written_times import iso_start
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats._frames import FrameFile, FrameReader, Frames
from accelcal_cli.formats._gravity import usual_length
from accelcal_cli.formats._rows import MISSING, first_values
from accelcal_cli.formats.unisens import DESCRIPTION, MOST_BYTES

AXES = "xyz"
ACCELEROMETERS, GYROSCOPES = ("acc",), ("gyro", "angularrate")
"""Classes of signals of the two sensors."""

LARGEST_G, WARMEST_MC, MOST_FIRST_ROWS, SMALLEST_LSB_PER_G, MOST_RATIO = 100.0, 200_000, 1 << 16, 1e-6, 100
WIDE = np.iinfo(np.int32)
LARGEST_DPS = 100_000.0
"""Largest step of rotation rates that any sensor has."""

NO_START = "the description does not tell when the recording began: times count from its start"
OTHER_GYRO = (
    "{name} was not used: it has another rate, length or unit than rotation rates with {acc} may have"
)
TYPES = {
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8"},
}
RATES_HZ = (1e-3, 100_000.0)
LARGEST_BASELINE = 1 << 31
COPY_AGAIN = "copy the whole folder again"


@dataclass(frozen=True, slots=True)
class Signal:
    """One signal of even rate.

    Attributes:
        name: name of its file.
        kind: its content class, in lower case.
        number: numpy's name of the type of its numbers; None if it is not a binary file or of another type.
        lsb: the unit's value of one step.
        bits: resolution of the converter, None if unknown.
        channels: names.
    """

    name: str
    kind: str
    number: str | None
    rate_hz: float
    lsb: float
    baseline: int
    bits: int | None
    unit: str
    channels: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Description:
    """The description of a recording, with the start of all its signals."""

    signals: tuple[Signal, ...]
    start: StartTime | None
    device: Device

    def of_kind(self, *kinds: str) -> Signal | None:
        """Return the first binary signal of one of these content classes."""
        return next((one for one in self.signals if one.kind in kinds and one.number is not None), None)


class _NoDeclarations(ElementTree.TreeBuilder):
    """Builds the tree of a description without declarations, whatever its encoding."""

    def doctype(self, _name: str, _public: str | None, _system: str | None) -> None:
        """Refuse a type of document, before its entities are read, which may grow without bound."""
        raise UnreadableError("has declarations, which Unisens does not use", hint=COPY_AGAIN)


def load_description(path: Path) -> Description:
    """Read `unisens.xml`; raises UnreadableError if it cannot be read, or is not XML of Unisens."""
    try:
        with open_found(path) as file:
            text = file.read(MOST_BYTES)
        root = ElementTree.fromstring(text, ElementTree.XMLParser(target=_NoDeclarations()))
    except UnreadableError as error:
        error.path = path
        raise
    except OSError as error:
        what = f"cannot be read ({error.strerror or error})"
        raise UnreadableError(what, path=path, hint=COPY_AGAIN) from error
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise UnreadableError(f"is damaged ({error})", path=path, hint=COPY_AGAIN) from error
    if _tag(root) != "unisens":
        raise UnreadableError("is not a description of Unisens", path=path, hint=COPY_AGAIN)
    pairs = (item for group in _children(root, "customAttributes") for item in group)
    attributes = {item.get("key", ""): (item.get("value") or "").strip() for item in pairs}
    about = [attributes.get(f"sensor{name}") or None for name in ("Type", "SerialNumber", "FirmwareVersion")]
    signals = tuple(_signal(item) for item in _children(root, "signalEntry"))
    return Description(signals, iso_start(root.get("timestampStart", "")), Device(*about))


def _tag(item: ElementTree.Element) -> str:
    return item.tag.rpartition("}")[2] if isinstance(item.tag, str) else ""


def _children(item: ElementTree.Element, tag: str) -> Iterator[ElementTree.Element]:
    return (child for child in item if _tag(child) == tag)


def _signal(item: ElementTree.Element) -> Signal:
    binary = next(_children(item, "binFileFormat"), None)
    order = "<" if binary is None or binary.get("endianess", "LITTLE").upper() == "LITTLE" else ">"
    code = TYPES.get(item.get("dataType", "").lower())
    bits = round(_number(item.get("adcResolution"), 0.0))
    return Signal(
        name=item.get("id", ""),
        kind=item.get("contentClass", "").lower(),
        number=None if binary is None or code is None else order + code,
        rate_hz=_number(item.get("sampleRate"), 0.0),
        lsb=_number(item.get("lsbValue"), 1.0),
        baseline=round(max(-LARGEST_BASELINE, min(LARGEST_BASELINE, _number(item.get("baseline"), 0.0)))),
        bits=bits if 1 < bits <= 32 else None,
        unit=item.get("unit", "").strip(),
        channels=tuple(channel.get("name", "") for channel in _children(item, "channel")),
    )


def _number(text: str | None, default: float) -> float:
    """Return a finite number, with a point or a comma for decimals; `default` if the text is not one."""
    try:
        value = float((text or "").replace(",", "."))
    except ValueError:
        return default
    return value if math.isfinite(value) else default


@dataclass(frozen=True, slots=True)
class SiblingSignal:
    """A signal in a file of its own with `frames` samples, `ratio` for each row of the accelerations."""

    path: Path
    signal: Signal
    ratio: Fraction
    frames: int

    def values(self, first: int, rows: int) -> NDArray[np.float64]:
        """Return its numbers less the baseline, (rows, channels), that held while each row was measured."""
        ratio, width = self.ratio, frame_bytes(self.signal)
        since = np.arange(rows, dtype=np.int64) * ratio.numerator + first * ratio.numerator
        wanted = np.minimum(since // ratio.denominator, self.frames - 1)
        begin = int(wanted[0]) if rows else 0
        with ByteSource(self.path) as source:
            source.seek(begin * width)
            data = source.read_exact((int(wanted[-1]) - begin + 1) * width if rows else 0)
        numbers = numbers_of(np.frombuffer(data, np.uint8).reshape(-1, width), self.signal)
        with np.errstate(invalid="ignore"):
            return np.asarray(numbers[wanted - begin].astype(np.float64) - float(self.signal.baseline))

    def recorded(self, first: int, rows: int) -> NDArray[np.float64]:
        """Return its values, (rows, channels), each at the first row that it holds for; else NaN."""
        since = np.arange(first - 1, first + rows, dtype=np.int64) * self.ratio.numerator
        since //= self.ratio.denominator
        fresh = (since[1:] > since[:-1]) & (since[1:] < self.frames)
        values = self.values(first, rows) * self.signal.lsb
        return np.where(fresh[:, None], values, np.nan)


@dataclass(frozen=True, slots=True)
class OtherSignals:
    """Further signals, at most as fast as the accelerations."""

    signals: tuple[SiblingSignal, ...]

    @property
    def columns(self) -> tuple[OtherColumn, ...]:
        """Their channels, named by quantity or content class, and if there are several by their names."""
        found = []
        for one in self.signals:
            signal, stem = one.signal, Path(one.signal.name).stem.lower()
            name = quantity_of([signal.kind]) or quantity_of([stem]) or signal.kind or stem
            parts = [f"{name}_{part}" for part in signal.channels] if len(signal.channels) > 1 else [name]
            found += [OtherColumn(part, signal.unit or UNKNOWN_UNIT) for part in parts]
        return uniquely_named(found)

    def __call__(self, first: int, rows: int) -> Others:
        """Return the values of some rows, those of each sample at its first row."""
        others, column = no_others(rows, sum(max(1, len(one.signal.channels)) for one in self.signals)), 0
        for one in self.signals:
            values = one.recorded(first, rows)
            with np.errstate(over="ignore"):
                others[:, column : column + values.shape[1]] = values
            column += values.shape[1]
        return others


def other_signals(description: Description, signal: Signal, data: Path) -> OtherSignals:
    """Return the signals besides motion and temperature, at most as fast as the accelerations."""
    kinds = (*ACCELEROMETERS, *GYROSCOPES, *THERMOMETER)
    named = [one for one in description.signals if one.number is not None and one.kind not in kinds]
    found = (sibling_signal(one, signal, data) for one in named if one.name != signal.name)
    return OtherSignals(tuple(one for one in found if one is not None and one.ratio <= 1))


def frame_bytes(signal: Signal) -> int:
    """Return the bytes of one sample of all channels."""
    return np.dtype(signal.number or "u1").itemsize * max(1, len(signal.channels))


def numbers_of(table: NDArray[np.uint8], signal: Signal) -> NDArray[np.generic]:
    """Return samples (n, bytes) as numbers, (n, channels)."""
    return np.ascontiguousarray(table).view(np.dtype(signal.number))


@dataclass(frozen=True, slots=True)
class Decoder:
    """Decodes the file of accelerations, channels `axes`, to rows.

    The grid is the number of counts in one unit of floating-point numbers; None for whole numbers.
    """

    signal: Signal
    axes: tuple[int, ...]
    grid: float | None
    gyro: SiblingSignal | None
    thermometer: SiblingSignal | None

    def __call__(self, table: NDArray[np.uint8], first: int) -> Frames:
        """Decode some frames to rows."""
        numbers = numbers_of(table, self.signal)[:, self.axes]
        counts, faulty = self._whole(numbers) if self.grid is None else self._rounded(numbers, self.grid)
        return Frames(counts, faulty if faulty.any() else None, None, self.channels(first, len(table)))

    def _whole(self, numbers: NDArray[np.generic]) -> tuple[Counts, NDArray[np.bool_]]:
        if self.signal.baseline == 0 and numbers.dtype.itemsize <= 2 and numbers.dtype != np.uint16:
            return numbers.astype(np.int16), np.zeros(len(numbers), np.bool_)
        counts = numbers.astype(np.int64) - self.signal.baseline
        faulty = np.asarray(((counts < WIDE.min) | (counts > WIDE.max)).any(axis=1))
        return np.where(faulty[:, None], 0, counts).astype(np.int32), faulty

    def _rounded(self, numbers: NDArray[np.generic], grid: float) -> tuple[Counts, NDArray[np.bool_]]:
        with np.errstate(invalid="ignore", over="ignore"):
            counts = (numbers.astype(np.float64) - self.signal.baseline) * grid
        faulty = np.asarray(~(np.abs(counts) <= LARGEST_G * FLOAT_LSB_PER_G).all(axis=1))
        return np.rint(np.where(faulty[:, None], 0, counts)).astype(np.int32), faulty

    def channels(self, first: int, rows: int) -> Channels:
        """Return what was measured together with the accelerations of some rows."""
        channels: Channels = {}
        if self.gyro is not None:
            values = self.gyro.values(first, rows)
            channels["gyro_counts"] = np.clip(values, WIDE.min, WIDE.max).astype(np.int32)
        if self.thermometer is not None:
            with np.errstate(invalid="ignore", over="ignore"):
                values = self.thermometer.values(first, rows)[:, 0] * (self.thermometer.signal.lsb * 1000)
            known = np.abs(values) <= WARMEST_MC
            whole = np.rint(np.where(known, values, 0))
            channels["temperature_mc"] = np.where(known, whole, MISSING).astype(np.int32)
        return channels


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a folder by its `unisens.xml` or its accelerations; `Format.open` says what is raised."""
    is_description = path.name == DESCRIPTION or path.suffix.lower() == ".xml"
    xml = path if is_description else path.with_name(DESCRIPTION)
    description = load_description(xml)
    signal = signal_of(description, xml, None if is_description else path.name)
    data = path.with_name(signal.name)
    rows = frames_of(data, signal)
    gyro, notes = gyroscope_of(description, signal, data, rows)
    signal, doubts = with_baseline(signal, data, rows, lsb_per_g_of(signal, options, xml))
    notes = (*notes, *doubts)
    scale, is_float = lsb_per_g_of(signal, options, xml), np.dtype(signal.number).kind == "f"
    decoder = Decoder(
        signal,
        axes_of(signal, xml),
        FLOAT_LSB_PER_G / scale if is_float else None,
        gyro,
        sibling_signal(description.of_kind(*THERMOMETER), signal, data),
    )
    start = description.start
    start_us, zone = (None, None) if start is None else (start.start_us, start.timezone)
    first = first_values(decoder.channels(0, min(rows, MOST_FIRST_ROWS)))
    others = other_signals(description, signal, data)
    file = FrameFile(data, 0, frame_bytes(signal), None, False, start_us or 0, decoder, first, others=others)
    recording = Recording(
        path=path,
        format="unisens",
        rate_hz=agreed_rate(options, signal.rate_hz, path),
        lsb_per_g=FLOAT_LSB_PER_G if is_float else scale,
        total_bytes=data.stat().st_size,
        device=description.device,
        range_g=None if signal.bits is None or is_float else 2.0 ** (signal.bits - 1) / scale,
        start_us=start_us,
        timezone=zone,
        has_offsets=zone is not None,
        duration_s=rows / signal.rate_hz,
        has_temperature=first.get("temperature_mc") is not None,
        gyro_dps_per_lsb=None if gyro is None else (gyro.signal.lsb,) * 3,
        others=others.columns,
        companion=data if is_description else xml,
        zero_counts=first_row(decoder(np.zeros((1, frame_bytes(signal)), np.uint8), 0).counts),
        notes=notes,
    )
    problems = () if start_us is not None else (Problem("no_start_time", NO_START, None, 0),)
    return FrameReader(recording, file, problems)


def with_baseline(signal: Signal, data: Path, rows: int, scale: float) -> tuple[Signal, tuple[str, ...]]:
    """Return the signal without a baseline that signed numbers contradict, and a note that says so.

    Some converters were unsigned, and their program stored signed numbers with the baseline taken away.
    """
    number, baseline = np.dtype(signal.number), float(signal.baseline)
    if number.kind != "i" or not baseline:
        return signal, ()
    count = min(rows, MOST_FIRST_ROWS)
    with ByteSource(data) as source:
        table = np.frombuffer(source.read_exact(count * frame_bytes(signal)), np.uint8)
    values = numbers_of(table.reshape(count, -1), signal)[:, -3:].astype(np.float64)
    low, high = ACCELERATION_UNITS["g"].rest or (0.0, 0.0)
    plain_g, less_g = (usual_length(values - zero) / scale for zero in (0.0, baseline))
    if low <= less_g <= high or not low <= plain_g <= high:
        return signal, ()
    note = f"the baseline {signal.baseline} of unisens.xml does not fit the signed data: 0 is used"
    return replace(signal, baseline=0), (note,)


def signal_of(description: Description, xml: Path, name: str | None) -> Signal:
    """Return the accelerations, of this name if one is given, in a binary file of a possible rate."""
    found = [one for one in description.signals if one.kind in ACCELEROMETERS and name in (None, one.name)]
    signal = next((one for one in found if one.number is not None), None)
    if signal is None and found:
        hint = f"if it is a table, read it alone: --format csv --rate {found[0].rate_hz:g} --unit g"
        what = f"the accelerations ({found[0].name}) are in no binary file"
        raise UnreadableError(what, path=xml, hint=hint)
    if signal is None:
        what = f"lists no signal of class acc{'' if name is None else f' called {name}'}"
        raise UnreadableError(what, path=xml, hint="name the folder's unisens.xml")
    if not RATES_HZ[0] <= signal.rate_hz <= RATES_HZ[1]:
        what = f"gives {signal.name} an impossible sampling rate of {signal.rate_hz:g} Hz"
        raise UnreadableError(what, path=xml, hint=COPY_AGAIN)
    if not has_file(xml, signal):
        what = f"lists {signal.name!r}, which is not a file in its folder"
        raise UnreadableError(what, path=xml, hint=COPY_AGAIN)
    return signal


def has_file(xml: Path, signal: Signal) -> bool:
    """Return True if a signal's file is in the folder; names that lead elsewhere do not count."""
    return Path(signal.name).name == signal.name != "" and is_file(xml.with_name(signal.name))


def frames_of(data: Path, signal: Signal) -> int:
    """Return how many whole samples a file has, which has to be readable, not compressed and not empty."""
    with ByteSource(data) as source:
        size, compressed = source.file_bytes, source.compressed
    if compressed or size < frame_bytes(signal):
        what = "is compressed, which files of Unisens are not" if compressed else "holds no sample"
        raise UnreadableError(what, path=data, byte_offset=0, hint=COPY_AGAIN)
    return size // frame_bytes(signal)


def axes_of(signal: Signal, xml: Path) -> tuple[int, ...]:
    """Return the channels of x, y and z, by the last letters of their names, else the only three."""
    ends = [name[-1:].lower() for name in signal.channels]
    if all(ends.count(axis) == 1 for axis in AXES):
        return tuple(ends.index(axis) for axis in AXES)
    if len(ends) == len(AXES):
        return 0, 1, 2
    what = f"does not tell which channels of {signal.name} are x, y and z"
    raise UnreadableError(what, path=xml, hint=COPY_AGAIN)


def lsb_per_g_of(signal: Signal, options: ReadOptions, xml: Path) -> float:
    """Return the steps in one g: the user's, else those of the signal's scale, in its unit or the user's."""
    if options.lsb_per_g is not None:
        return options.lsb_per_g
    unit = acceleration_unit(options.unit or signal.unit)
    if unit is None or unit not in PER_G:
        what = f"gives {signal.name} the unit {signal.unit!r}, which is not a unit of acceleration"
        raise UnreadableError(what, path=xml, hint="give --unit or --lsb-per-g")
    found = PER_G[unit] / signal.lsb if signal.lsb > 0 else 0.0
    if not SMALLEST_LSB_PER_G <= found <= LARGEST_LSB_PER_G:
        what = f"gives {signal.name} an impossible scale of {signal.lsb:g} {signal.unit}"
        raise UnreadableError(what, path=xml, hint="give --lsb-per-g")
    return found


def sibling_signal(other: Signal | None, signal: Signal, data: Path) -> SiblingSignal | None:
    """Return a signal's file in the folder of the accelerations; None if it is missing, empty or too fast."""
    if other is None or Path(other.name).name != other.name:
        return None
    if not RATES_HZ[0] <= other.rate_hz <= RATES_HZ[1]:
        return None
    path = data.with_name(other.name)
    frames = path.stat().st_size // frame_bytes(other) if is_file(path) else 0
    ratio = rate_fraction(other.rate_hz) / rate_fraction(signal.rate_hz)
    return SiblingSignal(path, other, ratio, frames) if frames and 0 < ratio < MOST_RATIO else None


def gyroscope_of(
    description: Description, signal: Signal, data: Path, rows: int
) -> tuple[SiblingSignal | None, tuple[str, ...]]:
    """Return rotation rates with the rows of the accelerations, or None; and a note on others."""
    gyro = sibling_signal(description.of_kind(*GYROSCOPES), signal, data)
    if gyro is None or (gyro.ratio == 1 and gyro.frames >= rows and is_rotation(gyro.signal)):
        return gyro, ()
    return None, (OTHER_GYRO.format(name=gyro.signal.name, acc=signal.name),)


def is_rotation(signal: Signal) -> bool:
    """Return True if a signal holds rotation rates of three axes, as whole numbers."""
    unit, whole = unit_of(signal.unit, Quantity.ROTATION), np.dtype(signal.number).kind in "iu"
    known = unit is not None and unit.per == 1.0 and 0 < signal.lsb <= LARGEST_DPS
    return whole and known and len(signal.channels) == len(AXES)
