"""Reads layout files, which describe the pages and frames of a raw dump (docs/layout-files.md).

Errors name the key. Sizes and offsets must fit together.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

from accelcal_cli.core.clock import StartTime, start_of
from accelcal_cli.core.errors import UsageError, did_you_mean
from accelcal_cli.core.input_files import read_toml
from accelcal_cli.core.recording import LARGEST_LSB_PER_G

AXES = ("x", "y", "z")
GYRO = ("gx", "gy", "gz")
CHANNEL_FIELDS = {"temperature": ("temperature_mc", 1000, 1_000_000.0)}
"""Fields of a single value: its channel in Chunk, the number of the channel's units in one of the field's,
and the largest value of the channel that can be measured."""

FIELD_NAMES = (*AXES, *CHANNEL_FIELDS, *GYRO)
FIELD_TYPES = ("int8", "uint8", "int16", "uint16", "int24", "int32", "float32")
CHECKSUM_TYPES = ("crc32", "crc16-ccitt")
PAGE_TYPES = {"sequence": ("uint8", "uint16", "uint32"), "time": ("uint32",), "crc": CHECKSUM_TYPES}
"""Types of the values of [page]: its number, the time of its first sample, and its checksum."""

TYPE_BYTES = {
    **{"int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int24": 3, "int32": 4, "uint32": 4, "float32": 4},
    **{"crc32": 4, "crc16-ccitt": 2},
}

LARGEST_COVERS, STREAM_FRAMES = {"crc32": 1 << 24, "crc16-ccitt": 1 << 16}, 256
"""Most bytes that a checksum covers (a CRC-16 takes a step for each), and frames of a stream in a page."""

LARGEST_LAYOUT, LARGEST_FRAME, LARGEST_PAGE, LARGEST_BYTES = 1 << 16, 1 << 16, 1 << 24, 1 << 40
"""Most bytes of a layout file, a frame, a page, and of anything else."""

Span = tuple[int, int, str]
T = TypeVar("T")

HINT = 'write it as "2024-03-04T00:00:00", with an offset such as +01:00 if it is known'

LARGEST_NUMBER, LARGEST_ZERO, SMALLEST_SCALE = 1e12, 2**31, 1e-9
LONGEST_SHOWN = 80


@dataclass(frozen=True, slots=True)
class Field:
    """A value at one place of every frame, or of every page.

    In a frame it stands for `raw * scale + zero`, or for `raw - zero` counts of x, y and z. The time of a
    page is in units of `per_unit` seconds since 1970; `covers` is the first byte that a checksum covers, and
    one past the last.
    """

    offset: int
    type: str
    per_unit: float | None = None
    zero: float = 0.0
    covers: tuple[int, int] = (0, 0)

    @property
    def bytes(self) -> int:
        """Length of the value."""
        return TYPE_BYTES[self.type]

    @property
    def scale(self) -> float:
        """Degrees C, deg/s or seconds in one raw unit."""
        return 1.0 if self.per_unit is None else self.per_unit


@dataclass(frozen=True, slots=True)
class Layout:
    """A raw dump's description; sizes in bytes. `page_bytes` 0 is an unbroken stream of frames.

    `fields` are the values of a frame, `page` those of a page, by the keys of PAGE_TYPES.
    """

    rate_hz: float
    lsb_per_g: float
    frame_bytes: int
    fields: Mapping[str, Field]
    range_g: float | None = None
    start: StartTime | None = None
    serial: str | None = None
    model: str | None = None
    firmware: str | None = None
    endian: str = "little"
    header_bytes: int = 0
    page_bytes: int = 0
    page_header_bytes: int = 0
    page_trailer_bytes: int = 0
    page: Mapping[str, Field] = field(default_factory=dict)

    @property
    def page_frames(self) -> int:
        """Samples in a full page."""
        if not self.page_bytes:
            return STREAM_FRAMES
        return (self.page_bytes - self.page_header_bytes - self.page_trailer_bytes) // self.frame_bytes

    @property
    def block_bytes(self) -> int:
        """Bytes of a page, or of the frames of an unbroken stream that are treated as one."""
        return self.page_bytes or STREAM_FRAMES * self.frame_bytes


def contradictions(layout: Layout, *, paged: bool) -> Iterator[str]:
    """Yield what is wrong with sizes and places, and names the key; a `paged` layout gives page_bytes."""
    if layout.frame_bytes > LARGEST_FRAME:
        yield f"dump.frame_bytes is {layout.frame_bytes}, more than {LARGEST_FRAME}"
    yield from misplaced(spans("fields", layout.fields), layout.frame_bytes, "dump.frame_bytes")
    outside = layout.page_header_bytes + layout.page_trailer_bytes
    if not paged:
        if outside:
            yield "dump.page_bytes is missing, but a page header or trailer is given"
        if layout.page:
            yield "dump.page_bytes is missing, but [page] is given"
        return
    if layout.page_bytes > LARGEST_PAGE:
        yield f"dump.page_bytes is {layout.page_bytes}, more than {LARGEST_PAGE}"
    if outside + layout.frame_bytes > layout.page_bytes:
        needed = f"header, trailer and one frame take {outside + layout.frame_bytes} bytes"
        yield f"dump.page_bytes is {layout.page_bytes}, but {needed}"
    first, frame_bytes = layout.page_header_bytes, layout.page_frames * layout.frame_bytes
    frames = (first, first + frame_bytes, "the frames (dump.page_header_bytes and dump.page_trailer_bytes)")
    yield from misplaced([*spans("page", layout.page), frames], layout.page_bytes, "dump.page_bytes")
    if (crc := layout.page.get("crc")) is not None:
        yield from wrong_covers(crc, layout.page_bytes)


def wrong_covers(crc: Field, page_bytes: int) -> Iterator[str]:
    """Yield what is wrong with the bytes that a checksum covers."""
    start, stop = crc.covers
    if stop > page_bytes:
        yield f"page.crc.covers ends at {stop}, but dump.page_bytes is {page_bytes}"
    if start < crc.offset + crc.bytes and crc.offset < stop:
        yield "page.crc.covers includes the checksum itself"
    if stop - start > LARGEST_COVERS[crc.type]:
        yield f"page.crc.covers is {stop - start} bytes, {crc.type} at most {LARGEST_COVERS[crc.type]}"


def spans(table: str, fields: Mapping[str, Field]) -> list[Span]:
    """Return the first byte, the byte after the last, and the name of each value."""
    return [(one.offset, one.offset + one.bytes, f"{table}.{name}") for name, one in fields.items()]


def misplaced(places: list[Span], size: int, key: str) -> Iterator[str]:
    """Yield which values end beyond `size`, the value of `key`, and which share a byte."""
    for _, end, name in places:
        if end > size:
            yield f"{name} ends at byte {end}, but {key} is {size}"
    for (_, end, name), (start, _, other) in pairwise(sorted(places)):
        if start < end:
            yield f"{name} and {other} overlap at byte {start}"


def shown(value: object) -> str:
    """Return a value as errors show it, no longer than a line."""
    short = reprlib.Repr()
    short.maxstring = short.maxother = LONGEST_SHOWN
    return short.repr(value)


class Keys:
    """One table of a layout; `finish` refuses keys that were never read."""

    def __init__(self, table: Mapping[str, Any], path: Path, name: str) -> None:
        self._table, self._path, self._name = table, path, name
        self._known: set[str] = set()

    def __contains__(self, key: str) -> bool:
        return key in self._table

    def error(self, key: str, message: str, hint: str | None = None) -> UsageError:
        """Return an error about one key."""
        place = f"{self._name}.{key}" if self._name else f"[{key}]"
        return UsageError(f"layout: {place} {message}", path=self._path, hint=hint)

    def raw(self, key: str) -> Any:
        """Return the value as TOML gave it, None if absent."""
        self._known.add(key)
        return self._table.get(key)

    def _required(self, key: str, value: T | None) -> T:
        if value is None:
            raise self.error(key, "is missing")
        return value

    def finish(self, *also: str) -> None:
        """Refuse keys that were never read, except those in `also`."""
        self._known.update(also)
        for key in self._table:
            if key not in self._known:
                known = f"valid keys: {', '.join(sorted(self._known))}"
                raise self.error(key, "is not a known key", did_you_mean(key, self._known) or known)

    def table(self, key: str) -> Keys:
        """Return a required table."""
        return self._required(key, self.optional_table(key))

    def optional_table(self, key: str) -> Keys | None:
        """Return a table, None if absent."""
        value = self.raw(key)
        if value is None:
            return None
        if not isinstance(value, Mapping):
            raise self.error(key, f"must be a table, not {shown(value)}")
        return Keys(value, self._path, f"{self._name}.{key}" if self._name else key)

    def number(self, key: str, low: float = -math.inf, high: float = math.inf) -> float:
        """Return a required number."""
        return self._required(key, self.optional_number(key, low, high))

    def optional_number(self, key: str, low: float = -math.inf, high: float = math.inf) -> float | None:
        """Return a finite number within low..high, None if absent."""
        value = self.raw(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e300:
            raise self.error(key, f"must be a number, not {shown(value)}")
        if not low <= value <= high:
            raise self.error(key, f"is {shown(value)}, which is not between {low:g} and {high:g}")
        return float(value)

    def whole(self, key: str, default: int | None, low: int = 0) -> int:
        """Return a whole number of at least `low`; it is required if `default` is None."""
        found = self.raw(key)
        value = self._required(key, default if found is None else found)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, f"must be a whole number, not {shown(value)}")
        if value is not default and not low <= value <= LARGEST_BYTES:
            what = f"is {shown(value)}; it must be at least {low}, and a size that a file can have"
            raise self.error(key, what)
        return value

    def text(self, key: str) -> str | None:
        """Return a text, None if absent."""
        value = self.raw(key)
        if value is not None and not isinstance(value, str):
            raise self.error(key, f"must be text in quotes, not {shown(value)}")
        return value

    def choice(self, key: str, allowed: tuple[str, ...], default: str | None) -> str:
        """Return one of a few words; it is required if `default` is None."""
        value = self._required(key, self.text(key) or default)
        if value not in allowed:
            raise self.error(key, f"is {value!r}", f"allowed: {', '.join(allowed)}")
        return value

    def pair(self, key: str) -> tuple[int, int]:
        """Return a required pair of whole numbers."""
        value = self._required(key, self.raw(key))
        whole = isinstance(value, list) and [type(item) for item in value] == [int, int]
        if not whole or not 0 <= value[0] < value[1]:
            raise self.error(key, f"must be two byte numbers [first, one past the last], not {shown(value)}")
        return value[0], value[1]


def parse_start(dump: Keys) -> StartTime | None:
    """Parse `start_time` of [dump], an ISO 8601 text or a TOML date and time."""
    value = dump.raw("start_time")
    if value is None:
        return None
    if isinstance(value, str):
        try:
            value = datetime.fromisoformat(value.strip())
        except ValueError:
            raise dump.error("start_time", f"is {value!r}, which is not a date and time", HINT) from None
    if not isinstance(value, datetime):
        raise dump.error("start_time", f"is {value}, which is not a date and time", HINT)
    start = start_of(value)
    if start is None:
        raise dump.error("start_time", f"is {value}, which in UTC lies outside the years 1 to 9999", HINT)
    return start


def plain_layout(rate_hz: float, lsb_per_g: float) -> Layout:
    """Return the layout of an unbroken stream of x, y, z as little-endian int16."""
    fields = {axis: Field(2 * number, "int16") for number, axis in enumerate(AXES)}
    return Layout(rate_hz=rate_hz, lsb_per_g=lsb_per_g, frame_bytes=6, fields=fields)


def load_layout(path: Path) -> Layout:
    """Read and check a layout file; raises UsageError that names a key which is missing or impossible."""
    top = Keys(read_toml(path, "the layout", LARGEST_LAYOUT), path, "")
    page = top.optional_table("page")
    top.finish("dump", "fields")
    dump, fields = top.table("dump"), top.table("fields")
    wide = dict.fromkeys(("per_unit", "zero"), (-LARGEST_NUMBER, LARGEST_NUMBER))
    parsed = {n: parse_field(fields.table(n), FIELD_TYPES, **wide) for n in FIELD_NAMES if n in fields}
    fields.finish()
    check_fields(parsed, fields)
    layout = Layout(
        rate_hz=dump.number("rate_hz", low=0.001, high=100_000),
        lsb_per_g=dump.number("lsb_per_g", low=1e-6, high=LARGEST_LSB_PER_G),
        range_g=dump.optional_number("range_g", low=0.001, high=10_000),
        start=parse_start(dump),
        serial=dump.text("serial"),
        model=dump.text("model"),
        firmware=dump.text("firmware"),
        endian=dump.choice("endian", ("little", "big"), "little"),
        header_bytes=dump.whole("header_bytes", 0),
        page_bytes=dump.whole("page_bytes", 0, low=1),
        page_header_bytes=dump.whole("page_header_bytes", 0),
        page_trailer_bytes=dump.whole("page_trailer_bytes", 0),
        frame_bytes=dump.whole("frame_bytes", max(end for _, end, _ in spans("", parsed)), low=1),
        fields=parsed,
        page={} if page is None else parse_page(page),
    )
    dump.finish()
    if page is not None:
        page.finish()
    for fault in contradictions(layout, paged="page_bytes" in dump):
        raise UsageError(f"layout: {fault}", path=path)
    return layout


def parse_page(page: Keys) -> dict[str, Field]:
    """Parse [page]."""
    bounds = {"time": {"per_unit": (1e-6, 60.0)}}
    return {
        name: parse_field(keys, types, **bounds.get(name, {}))
        for name, types in PAGE_TYPES.items()
        if (keys := page.optional_table(name)) is not None
    }


def parse_field(keys: Keys, types: tuple[str, ...], **bounds: tuple[float, float]) -> Field:
    """Parse a value of one of some types, with `bounds` of `per_unit` and `zero` if it may have them."""
    offset, kind = keys.whole("offset", None), keys.choice("type", types, None)
    numbers = {name: keys.optional_number(name, *limits) for name, limits in bounds.items()}
    covers = keys.pair("covers") if types is CHECKSUM_TYPES else (0, 0)
    keys.finish()
    return Field(offset, kind, numbers.get("per_unit"), numbers.get("zero") or 0.0, covers)


def check_fields(parsed: Mapping[str, Field], fields: Keys) -> None:
    """Check that x, y and z are there, that the gyroscope is complete, and that scales have a meaning."""
    for name in AXES:
        if name not in parsed:
            raise fields.error(name, "is missing")
        if parsed[name].per_unit is not None:
            what = "cannot be used for x, y and z; their scale is lsb_per_g in [dump]"
            raise fields.error(f"{name}.per_unit", what)
        if parsed[name].zero % 1 or abs(parsed[name].zero) > LARGEST_ZERO:
            raise fields.error(f"{name}.zero", "must be a whole number of counts")
    present = [name for name in GYRO if name in parsed]
    if 0 < len(present) < len(GYRO):
        raise fields.error(present[0], f"needs all of {', '.join(GYRO)}")
    for name in present:
        if parsed[name].scale < SMALLEST_SCALE:
            raise fields.error(f"{name}.per_unit", f"must be at least {SMALLEST_SCALE:g}")
        if abs(parsed[name].zero / parsed[name].scale) > LARGEST_ZERO:
            raise fields.error(f"{name}.zero", "is too large for its per_unit")
