"""The contract of a vendor's export: one frozen record that each file of this folder binds as VENDOR.

A vendor's file tells whether the head of a file is its export, and describes what the header says.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from functools import cache
from pathlib import Path

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import NoRecordingError, UnreadableError
from accelcal_cli.core.formats import HEAD_BYTES, ReadOptions, is_text
from accelcal_cli.core.plugins import find_plugins
from accelcal_cli.core.reasons import Reason
from accelcal_cli.core.recording import Device
from accelcal_cli.core.written_times import ORDERS, read_date
from accelcal_cli.formats.csv.cells import BYTE_ORDER_MARK, decode
from accelcal_cli.formats.csv.times import unclear_date

HEAD_LINES = 200
DAY_US = 86_400 * MICROSECONDS
EPOCH = date(1970, 1, 1)
NO_DEVICE = Device()

Head = tuple[str, ...]
"""The first lines of a file without their ends, at most HEAD_LINES; the last may be cut."""


@dataclass(frozen=True, slots=True)
class Start:
    """When a header says that its recording began.

    Attributes:
        time_us: microseconds since midnight of its date; without a date, since 1970.
        written: its date, as it is written.
        line: the line of the date, from 1.
    """

    time_us: int
    written: str | None = None
    line: int = 1

    def days(self, order: str | None) -> set[date]:
        """Return the dates that it may be: in this order, or in any order if none is given."""
        orders = ORDERS if order is None else (order,)
        return {day for item in orders if (day := read_date(self.written or "", item))}

    def us(self, order: str | None, path: Path) -> int:
        """Return the start in microseconds since 1970.

        Raises:
            UnreadableError: the date does not fit the order, or no order is known and several fit.
        """
        if self.written is None:
            return self.time_us
        days = self.days(order)
        if len(days) != 1:
            fitting = [item for item in ORDERS if self.days(item)]
            raise unclear_date(self.written, fitting, path, self.line)
        return self.time_us + (days.pop() - EPOCH).days * DAY_US


@dataclass(frozen=True, slots=True)
class Doubt:
    """Message and hint for a file of a known vendor that holds no raw acceleration; `epochs`: but counts."""

    message: str
    hint: str
    epochs: bool = False


@dataclass(frozen=True, slots=True)
class ExportDescription:
    """The facts that a vendor's header states. The rest is found out as in any other file.

    Attributes:
        title: whose export this is, for people.
        preamble: lines before the names of the columns, or before the first row.
        names: of the columns, where no line of the file names them.
        xyz, time: numbers of the columns, where the names need not tell.
        gyro: numbers of the columns of a gyroscope; gyro_unit: its unit, where no name says it.
        unit: of the acceleration, as in `--unit`; `lsb_per_g` where they are counts, and `zero`, the count
            that stands for 0 g.
        rate_hz: sampling rate.
        start: of the recording; used where rows carry no times.
        timezone: of its clock.
        range_g: the sensor clips at +- this.
        date_order: of day, month and year, such as `mdy`.
        repeats_idle: the device sleeps, and then writes zeros, or repeats a row for a second or more.
        time_unit_us: microseconds in one unit of the numbers of the time column.
        counts_from_start: these count from `start`, which has a date.
        companion: the sidecar that says all this, if it is not in the file itself.
        counts_from_zero: numbers of the time column count from `start`, which is that of the time 0.
        pauses: how often it was paused without its times saying so.
        notes: on what the header says, for people.
        doubt: why it cannot be calibrated as it is; None for raw data.
    """

    title: str = ""
    device: Device = NO_DEVICE
    preamble: int = 0
    names: tuple[str, ...] | None = None
    xyz: tuple[int, int, int] | None = None
    time: int | None = None
    unit: str | None = None
    lsb_per_g: float | None = None
    zero: int = 0
    rate_hz: float | None = None
    start: Start | None = None
    timezone: str | None = None
    range_g: float | None = None
    date_order: str | None = None
    repeats_idle: bool = False
    companion: Path | None = None
    time_unit_us: float | None = None
    counts_from_start: bool = False
    counts_from_zero: bool = False
    pauses: int = 0
    notes: tuple[str, ...] = ()
    doubt: Doubt | None = None
    gyro: tuple[int, int, int] | None = None
    gyro_unit: str | None = None


@dataclass(frozen=True, slots=True)
class Vendor:
    """One vendor's way to write text files.

    Attributes:
        name: of the file that binds it.
        recognise: tells whether the first lines are this vendor's. Never raises.
        describe: returns what they say. Never raises: what is damaged is left out.
        from_name: adds to this what the name of the file says. Never raises.
    """

    name: str
    recognise: Callable[[Head], bool]
    describe: Callable[[Head], ExportDescription]
    from_name: Callable[[str, ExportDescription], ExportDescription] = lambda _name, export: export


@cache
def all_vendors() -> tuple[Vendor, ...]:
    """Return every vendor, by name."""
    return tuple(find_plugins(__name__, __path__, "VENDOR"))


def export_description(head: bytes, name: str = "") -> ExportDescription | None:
    """Return what the head and the name of a vendor's export say; None if it is not a known vendor's."""
    if not is_text(head[:HEAD_BYTES]):
        return None
    raw = head[:HEAD_BYTES].removeprefix(BYTE_ORDER_MARK).splitlines()[:HEAD_LINES]
    lines = tuple(map(decode, raw))
    vendor = next((item for item in all_vendors() if lines and item.recognise(lines)), None)
    return None if vendor is None else vendor.from_name(name, vendor.describe(lines))


def refuse_doubtful(export: ExportDescription, options: ReadOptions, path: Path) -> None:
    """Raise UnreadableError for the export of a known vendor that holds no raw acceleration.

    Counts of epochs raise a NoRecordingError. Who gives a unit insists on it.
    """
    doubt = export.doubt
    if doubt is None or options.unit is not None:
        return
    if doubt.epochs:
        reason = Reason("epochs", {"whose": f"{export.title}'s"})
        raise NoRecordingError(doubt.message, path=path, line=1, hint=doubt.hint, reason=reason)
    raise UnreadableError(doubt.message, path=path, line=1, hint=doubt.hint)
