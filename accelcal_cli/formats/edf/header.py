"""The header of an EDF or BDF file: fields of text, first of the recording, then of all signals one by one.

Widths and order are those of www.edfplus.info/specs; a header says 256 bytes and 256 more for each signal.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from itertools import accumulate
from pathlib import Path

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import Device
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats.edf import BDF_MAGIC

FIRST_BYTES = 256
MOST_SIGNALS = 4096
LARGEST_RECORD = 1 << 24
"""Bytes of a record: the standard recommends at most 61 440."""

PIVOT = 85
"""Years 85 to 99 are of the last century; EDF+ gives all four digits elsewhere."""

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
MONTHS = ("JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC")
EDF_PLUS_DATE = re.compile(r"Startdate (\d\d)-([A-Z]{3})-(\d{4}) \S+ \S+ (\S+)")
NUMBER = re.compile(r"[+-]?(\d{1,8}(\.\d{0,8})?|\.\d{1,8})([eE][+-]?\d{1,3})?")
COPY_AGAIN = "copy it again from its source"
ANNOTATIONS = ("EDF Annotations", "BDF Annotations")

PARTS = (
    *(("version", 8), ("patient", 80), ("recording", 80), ("date", 8), ("time", 8), ("bytes", 8)),
    *(("reserved", 44), ("records", 8), ("seconds", 8), ("signals", 4)),
)
OF_SIGNALS = (
    *(("label", 16), ("transducer", 80), ("dimension", 8), ("physical_min", 8), ("physical_max", 8)),
    *(("digital_min", 8), ("digital_max", 8), ("filter", 80), ("samples", 8), ("reserved", 32)),
)
"""Names and widths of all fields; each of the latter stands there for all signals before the next one."""


@dataclass(frozen=True, slots=True)
class Signal:
    """One signal, as the header describes it.

    Attributes:
        number: its place, from 0.
        dimension: the unit of its physical values.
        limits: texts of physical minimum and maximum, and of digital minimum and maximum.
        samples: in each record.
        offset: of its samples in a record, in samples.
        byte_offset: of its physical minimum in the file.
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
    """What the header says.

    Attributes:
        sample_bytes: 2 of EDF, 3 of BDF.
        plus: `C` or `D` (with gaps) of EDF+ and BDF+, else None.
        start_us: microseconds since 1970 on the device's clock; None if it is no date.
        records: how many there are; None if that was not known.
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
        """Where the first record begins."""
        return FIRST_BYTES * (1 + len(self.signals))

    @property
    def record_bytes(self) -> int:
        """Length of a record."""
        return self.sample_bytes * sum(signal.samples for signal in self.signals)


def number_in(text: str) -> Fraction | None:
    """A number as headers write it, exactly; None if it is none."""
    text = text.strip().replace(",", ".")
    return Fraction(text) if NUMBER.fullmatch(text) else None


def read_header(path: Path) -> Header:
    """Read and check a header.

    Raises:
        UnreadableError: it is cut off or damaged; says where.
    """
    with ByteSource(path) as source:
        fields = _split(source.read_exact(FIRST_BYTES), PARTS, 1)
        signals = _whole(fields["signals"][0], 252, path, "number of signals", 1, MOST_SIGNALS)
        table = _split(source.read_exact(FIRST_BYTES * signals), OF_SIGNALS, signals)
    if len(table["reserved"][-1]) < OF_SIGNALS[-1][1]:
        raise UnreadableError("its header is cut off", path=path, byte_offset=0, hint=COPY_AGAIN)
    _whole(fields["bytes"][0], 184, path, "length of the header", *[FIRST_BYTES * (signals + 1)] * 2)
    sample_bytes = 3 if fields["version"][0].encode("latin-1") == BDF_MAGIC else 2
    records = _whole(fields["records"][0], 236, path, "number of records", -1, 10**8)
    seconds = number_in(fields["seconds"][0])
    if seconds is None or not 0 < seconds <= 10**8:
        raise _fault("length of a record", fields["seconds"][0], 244, path)
    texts, equipment = fields["recording"][0], None
    if match := EDF_PLUS_DATE.match(texts):
        equipment = None if match[4] == "X" else match[4].replace("_", " ")
    kind = fields["reserved"][0][:5]
    header = Header(
        sample_bytes,
        kind[4] if kind in ("EDF+C", "EDF+D", "BDF+C", "BDF+D") else None,
        Device(equipment),
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
    """`count` texts of each field; those behind the end of the data are empty or cut."""
    fields, place = {}, 0
    for name, width in parts:
        ends = [place + width * number for number in range(count + 1)]
        texts = [data[start : start + width] for start in ends[:-1]]
        fields[name], place = [text.decode("latin-1") for text in texts], ends[-1]
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
    at = {name: FIRST_BYTES + count * sum(width for _, width in OF_SIGNALS[:place])
          for place, (name, _) in enumerate(OF_SIGNALS)}  # fmt: skip
    samples = [
        _whole(text, at["samples"] + 8 * number, path, "number of samples", 0, LARGEST_RECORD)
        for number, text in enumerate(table["samples"])
    ]
    limits = zip(*(table[name] for name, _ in OF_SIGNALS[3:7]), strict=True)
    offsets = [0, *accumulate(samples)]
    columns = zip(table["label"], table["dimension"], limits, samples, strict=True)
    return tuple(
        Signal(
            number, label.strip(), unit.strip(), four, size, offsets[number], at["physical_min"] + 8 * number
        )
        for number, (label, unit, four, size) in enumerate(columns)
    )


def _start_us(date: str, time: str, recording: str) -> int | None:
    """Of `02.08.51` and `20.15.00`; the year as EDF+ gives it, where it does."""
    try:
        hour, minute, second = map(int, time.split("."))
        match = EDF_PLUS_DATE.match(recording)
        if match is not None and match[2] in MONTHS:
            day, month, year = int(match[1]), MONTHS.index(match[2]) + 1, int(match[3])
        else:
            day, month, year = map(int, date.split("."))
            year += 1900 if year >= PIVOT else 2000
        start = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None
    return (start - EPOCH) // timedelta(microseconds=1)
