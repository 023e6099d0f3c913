"""The contracts of a format: how it is recognised and read (`Format`), and how it is written (`Encoder`).

Each folder `formats/NAME/` binds its reader as FORMAT in `__init__.py` and its writer as ENCODER in
`writer.py`.
"""

from __future__ import annotations

import codecs
import importlib
import stat
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from accelcal_cli.core.clock import FIRST_US, LAST_US, MICROSECONDS
from accelcal_cli.core.errors import COPY_AGAIN, UnreadableError, UsageError, listed, unread
from accelcal_cli.core.local_time import Retiming, retimed
from accelcal_cli.core.recording import Chunk, Reader, Recording
from accelcal_cli.core.settings import Option, setting, setting_of
from accelcal_cli.core.unpacking import Packing, packing_of, plain_name, unpacked
from accelcal_cli.core.vocabulary import UNIT_CHOICES

HEAD_BYTES = 65_536
ZIP_MAGIC = b"PK\x03\x04"
WIDE_MARKS = (
    *((codecs.BOM_UTF32_LE, "utf-32", 3), (codecs.BOM_UTF32_BE, "utf-32", 0)),
    *((codecs.BOM_UTF16_LE, "utf-16", None), (codecs.BOM_UTF16_BE, "utf-16", None)),
)
"""First bytes of text in UTF-32 and UTF-16, and which of four bytes is 0 in every letter; a mark of UTF-32
may begin with one of UTF-16."""

WIDE_LETTERS = (("utf-16-le", 2, 0), ("utf-16-be", 2, 1), ("utf-32-le", 4, 0), ("utf-32-be", 4, 3))
"""Encodings, bytes of a letter, and which of them is not 0 in Latin text without a mark."""

WIDE_BYTES = 256
"""Bytes by which text without its mark is known: all but every second or fourth one are 0."""

PRINTABLE = bytes([9, 10, 13, *range(32, 127)])

RATE_AGREEMENT = 0.05

EACH, EVERY_ROW = "each", "all"
"""Values of --sensor: a study makes a recording of each sensor of a file; all rows are of one sensor."""


def is_text(head: bytes) -> bool:
    """Return True if all bytes are such as text has."""
    return not head.translate(None, b"\t\n\r\f\x1b" + bytes(range(32, 127)) + bytes(range(128, 256)))


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """Statements of the user about a recording; None: to be found out from the file.

    Attributes:
        unit: one of g, mg, m/s2, counts.
        zero: count that stands for 0 g.
        columns: names (or numbers from 0) of x, y and z; one name thrice: an array of three numbers a row.
        time_format: form of times, as strptime writes it, or the unit of numbers.
        date_format: order of day, month and year in dates: dmy, mdy or ymd.
        layout: a layout file for raw dumps.
        sensor: which sensor of a file with several; EACH: a reader lists them when all rows were read.
        gyro_columns: like `columns`, for the gyroscope; gyro_unit: deg/s, rad/s, or none: it is not read.
    """

    format: str | None = setting(None, "--format", "Format, if the content does not show it.", "NAME")
    rate_hz: float | None = setting(
        None, "--rate", "Sampling rate, if the file has no times.", "HZ", within=(1e-3, 100_000), above=0
    )
    unit: str | None = setting(None, "--unit", "Unit, if the file does not state it.", choices=UNIT_CHOICES)
    lsb_per_g: float | None = setting(
        None, "--lsb-per-g", "Counts per g.", "N", within=(1e-9, 10**9), above=0
    )
    zero: int | None = setting(
        None, "-R zero", "Count that means 0 g in a table, such as 512 for a 10-bit converter.", "N",
        within=(-(2**30), 2**30))  # fmt: skip
    columns: tuple[str, str, str] | None = setting(
        None, "--columns", "Names of the columns, or numbers from 0."
    )
    time_column: str | None = setting(None, "-R time_column", "Column of the times.", "NAME")
    date_format: str | None = setting(
        None, "-R date_format", "Order of day, month and year in dates such as 04/03/2024.",
        choices=("dmy", "mdy", "ymd"))  # fmt: skip
    time_format: str | None = setting(
        None, "-R time_format",
        "Form of a table's times, in strptime codes: '%d/%m/%Y %H:%M:%S.%f'. Numbers: s, ms, us or ns.",
        "FORM")  # fmt: skip
    timezone: str | None = setting(
        None, "--timezone", "Time zone of its clock, such as Europe/Berlin.", "ZONE"
    )
    force_timezone: bool = setting(
        False, "-R force_timezone", "Use --timezone even if a file states another zone."
    )
    start: str | None = setting(None, "-R start", "Start time, for files that do not contain one.", "ISO")
    shift_s: float | None = setting(
        None, "-R shift", "Add SECONDS to all times, to correct a clock that was wrong.", "SECONDS",
        within=(-1e9, 1e9))  # fmt: skip
    configured_zone: str | None = setting(
        None, "-R configured_zone", "Time zone that the device's clock was set to (with worn_zone).", "ZONE"
    )
    worn_zone: str | None = setting(
        None, "-R worn_zone",
        "Time zone where the device was worn, if it differs from the zone its clock was set to.",
        "ZONE")  # fmt: skip
    layout: Path | None = setting(None, "--layout", "Layout of a raw dump.", "FILE.toml")
    sensor: str | None = setting(None, "--sensor", "One of several sensors in the file.", "NAME")
    gyro_columns: tuple[str, str, str] | None = setting(
        None, "-R gyro_columns", "Columns of the gyroscope's x, y and z."
    )
    gyro_unit: str | None = setting(
        None, "-R gyro_unit", "Unit of the gyroscope; none: do not read it.",
        choices=("deg/s", "rad/s", "none"))  # fmt: skip
    lsb_per_dps: float | None = setting(
        None, "-R lsb_per_dps", "Counts of the gyroscope per deg/s.", "N", within=(1e-9, 10**9), above=0
    )

    only_motion: bool = setting(
        False, "--only-motion",
        "Leave light, buttons, battery, pressure and the like out of the calibrated data.",
        rare=True)  # fmt: skip

    @property
    def one_sensor(self) -> str | None:
        """The sensor that is chosen; those within it may be listed. None also where each is asked for."""
        if self.sensor is None or self.sensor == EACH:
            return None
        return self.sensor.removesuffix(f",{EACH}")

    @property
    def times(self) -> Retiming:
        """The user's statements about the times."""
        by_user = "--timezone" if self.configured_zone is None else "-R configured_zone"
        zone = self.configured_zone or self.timezone
        shift_us = round((self.shift_s or 0) * MICROSECONDS)
        return Retiming(zone, by_user, self.force_timezone, self.start, shift_us, self.worn_zone)


TIMES_OF_TABLES = ("time_column", "date_format", "time_format")
"""Options on times, which only tables understand."""

UNUSED = "unused"
"""Key of a report's `settings.input` for options that were given and mean nothing for the recording."""

ONLY_TABLES = ("gyro_columns", "gyro_unit", "lsb_per_dps", "zero")
"""Options that only tables understand, besides those on times."""

NOT_FOR_DEVICES = ("unit", "columns", *TIMES_OF_TABLES, "layout", "sensor", *ONLY_TABLES)
"""Options that mean nothing for a device's own file with a single sensor."""

IF_GIVEN = ("time_format", "start", "shift_s", "configured_zone", "worn_zone", "only_motion", *ONLY_TABLES)
"""Options that a report names only if they were given."""


COLUMNS = ("columns", "gyro_columns")
"""Options that name three columns."""


def three_names(value: Any) -> list[str] | None:
    """Return three columns, of a list or a text with commas; a single one thrice.

    None for another number of columns, or if a name is empty.
    """
    parts = [str(part).strip() for part in (value.split(",") if isinstance(value, str) else value)]
    names = parts * 3 if len(parts) == 1 else parts
    return names if len(names) == 3 and all(names) else None


def reading_option(name: str) -> Option:
    """Return the option of a field of `ReadOptions`."""
    option = setting_of(ReadOptions, name).option
    assert option is not None
    return option


def without(options: ReadOptions, names: Iterable[str]) -> ReadOptions:
    """Return options with some fields set back to their defaults."""
    default = ReadOptions()
    changed = {name: before for name in names if (before := getattr(default, name)) != getattr(options, name)}
    return replace(options, **changed) if changed else options


def mean_nothing(names: Sequence[str]) -> str:
    """Return some options and a verb: `--unit and -R zero do not apply`."""
    verb = "does not apply" if len(names) == 1 else "do not apply"
    return f"{listed([reading_option(name).name for name in names])} {verb}"


def unused_note(names: Sequence[str], format_name: str) -> str:
    """Return the note of a recording for which some options mean nothing."""
    verb = "was" if len(names) == 1 else "were"
    return f"{mean_nothing(names)} to format {format_name} and {verb} not used"


def agreed_rate(options: ReadOptions, stated_hz: float, path: Path) -> float:
    """Return the rate that a recording states, or the user's if it agrees with that.

    Raises:
        UsageError: the two contradict each other; the file's own times would become gaps.
    """
    if options.rate_hz is None:
        return stated_hz
    if abs(options.rate_hz - stated_hz) > RATE_AGREEMENT * stated_hz:
        raise UsageError(
            f"the recording was made at {stated_hz:g} Hz, not {options.rate_hz:g}",
            path=path,
            hint="omit --rate: files of this format state their rate",
        )
    return options.rate_hz


@dataclass(frozen=True, slots=True)
class Probe:
    """The part of a file that a sniffer may look at.

    Attributes:
        path: the recording.
        head: its first 64 KiB, unpacked if the file is packed.
        size: bytes on disk.
        compressed: True if the file is packed.
        options: what the user states.
    """

    path: Path
    head: bytes
    size: int
    compressed: bool
    options: ReadOptions

    @property
    def suffix(self) -> str:
        """Lower-case suffix of the file, without that of a packing: `.cwa` for `A.CWA.gz`."""
        return Path(plain_name(self.path.name.lower())).suffix


@dataclass(frozen=True, slots=True)
class Format:
    """One recording format.

    Attributes:
        name: as in `--format` and in the report.
        title: for people, one line.
        suffixes: usual lower-case suffixes, with the dot; they only decide which formats are asked first.
        sniff: confidence 0..100 that the probed file is of this format. 0: certainly not;
            100: a magic number or signature matches. Never raises.
        reader: "module:function" that opens a file, imported by the first file that is opened.
        ignores: reading options that mean nothing to it, such as `columns`: the one place that says so.
        is_table: such files hold tables of all kinds; that of a study may be no recording.
        belongs_to: the recording whose further sensors or description a file holds; None for any other file.
        refuse_others: raises NoRecordingError if the beginning shows that a file of it is not a recording.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    sniff: Callable[[Probe], int]
    reader: str
    ignores: tuple[str, ...] = ()
    is_table: bool = False
    belongs_to: Callable[[Path], Path | None] = lambda _path: None
    refuse_others: Callable[[Probe], None] = lambda _probe: None

    def unused(self, options: ReadOptions) -> tuple[str, ...]:
        """Return the options that are given and mean nothing to this format."""
        return tuple(name for name in self.ignores if getattr(options, name) is not None)

    def open(self, path: Path, options: ReadOptions) -> Reader:
        """Open a recording for streaming.

        Raises:
            UnreadableError: it is not of this format, or holds no samples.
            UsageError: an option is missing or contradicts the file.
        """
        module, _, function = self.reader.partition(":")
        try:
            reader: Reader = getattr(importlib.import_module(module), function)(path, options)
        except OSError as error:
            raise UnreadableError(f"cannot be read ({error.strerror or error})", path=path) from error
        _refuse_no_calendar(reader.recording)
        if options.only_motion:
            reader.recording = replace(reader.recording, others=())
        reader = retimed(reader, options.times)
        _refuse_no_calendar(reader.recording)
        return reader


def _refuse_no_calendar(recording: Recording) -> None:
    if not FIRST_US <= (recording.start_us or 0) <= LAST_US:
        what = "begins outside the years 1 to 9999"
        hint = f"{COPY_AGAIN}, or correct the start time that it is given"
        raise UnreadableError(what, path=recording.path, hint=hint)


def wide_text(head: bytes) -> str | None:
    """Return the encoding of text in UTF-16 or UTF-32: by its mark, or by its zeros; None for all else."""
    for mark, name, zero in WIDE_MARKS:
        if head.startswith(mark) and (zero is None or not head[zero:WIDE_BYTES:4].strip(b"\0")):
            return name
    if 0 not in head[:2]:
        return None
    for name, width, place in WIDE_LETTERS:
        units = head[: min(len(head), WIDE_BYTES) // width * width]
        zeros = b"".join(units[other::width] for other in range(width) if other != place)
        latin = len(units) > width and not zeros.strip(b"\0")
        if latin and not units[place::width].translate(None, PRINTABLE):
            return name
    return None


def as_utf8(head: bytes) -> bytes:
    """Return text in UTF-16 or UTF-32 as UTF-8; anything else as it is."""
    name = wide_text(head)
    width = 4 if name is not None and "32" in name else 2
    return head if name is None else head[: len(head) // width * width].decode(name, "replace").encode()


def probe_file(path: Path, options: ReadOptions) -> Probe:
    """Read the beginning of a file.

    Raises:
        UnreadableError: it is missing, empty, not a file, or nothing of it can be unpacked.
    """
    try:
        status = path.stat()
        size = status.st_size
        if stat.S_ISDIR(status.st_mode):
            raise UnreadableError("is a folder, not a recording", path=path, hint="name the files in it")
        if not stat.S_ISREG(status.st_mode):
            what, hint = "is a pipe or a device, and a recording is read twice", "write it to a file first"
            raise UnreadableError(what, path=path, hint=hint)
        if size == 0:
            raise UnreadableError("the file is empty", path=path, byte_offset=0, hint=COPY_AGAIN)
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
        packing = packing_of(head)
        if packing is not None:
            head = _packed_head(path, packing)
    except OSError as error:
        raise unread(error, path) from error
    return Probe(path, as_utf8(head)[:HEAD_BYTES], size, packing is not None, options)


def _packed_head(path: Path, packing: Packing) -> bytes:
    """Return the first unpacked bytes of a file, as many as a truncated one still gives.

    Raises:
        UnreadableError: nothing can be unpacked.
    """
    head, fault = bytearray(), None
    with path.open("rb") as file:
        for piece in unpacked(file, packing):
            head += piece.data
            fault = piece.fault
            if len(head) >= HEAD_BYTES:
                break
    if fault is not None and not head:
        packing.refuse_large(fault, path)
        what, hint = f"damaged {packing.name} data ({fault.value})", "copy it again from its source"
        raise UnreadableError(what, path=path, byte_offset=0, hint=hint)
    return bytes(head[:HEAD_BYTES])


@dataclass(frozen=True, slots=True)
class Companion:
    """A text file next to a recording: the end of its name, and its text."""

    suffix: str
    text: Callable[[Recording], str]


@dataclass(frozen=True, slots=True)
class Sampling:
    """How the device of a format samples.

    Attributes:
        rate_hz: the device's rate for a requested one: for 66.7 Hz a GENEActiv takes 200 samples in 3 s.
        unit_samples: a recording's number of samples is a multiple of this, such as a page.
    """

    rate_hz: float
    unit_samples: int = 1


@dataclass(frozen=True, slots=True)
class Encoder:
    """A writer of recordings of one format.

    Attributes:
        name: the format's name, as in `--format`; a reader of that name reads it back.
        suffix: what the file name ends with.
        write: writes all chunks to a path that the caller chose (temporary; the caller renames).
        companion: a file that must lie next to the recording, such as a layout; None if the
            recording stands alone.
        sampling: how a requested recording is sampled; by default, any rate, scale and number of samples
            are taken. Raises UsageError if no device of the format has such a rate, scale or range.
        gyroscope: True if it writes the gyroscope of recordings that have one.
    """

    name: str
    suffix: str
    write: Callable[[Path, Recording, Iterable[Chunk]], None]
    companion: Companion | None = None
    sampling: Callable[[Recording], Sampling] = lambda recording: Sampling(recording.rate_hz)
    gyroscope: bool = False
