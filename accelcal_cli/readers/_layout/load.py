"""Reading layout files: what the pages and frames of a raw dump hold. See docs/layout-files.md."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import UsageError
from accelcal_cli.readers._layout.check import check_geometry
from accelcal_cli.readers._layout.keys import Keys
from accelcal_cli.readers._layout.model import (
    AXES,
    CHECKSUM_BYTES,
    FIELD_NAMES,
    FIELD_TYPES,
    GYRO,
    SEQUENCE_TYPES,
    TIME_TYPES,
    Checksum,
    Field,
    Layout,
    Sequence,
    Stamp,
)
from accelcal_cli.readers._layout.time import parse_start

LARGEST_NUMBER = 1e12
LARGEST_ZERO = 2**31
SMALLEST_SCALE = 1e-9


def plain_layout(rate_hz: float, lsb_per_g: float) -> Layout:
    """An unbroken stream of x, y, z as little-endian int16."""
    fields = {axis: Field(2 * number, "int16") for number, axis in enumerate(AXES)}
    return Layout(rate_hz=rate_hz, lsb_per_g=lsb_per_g, frame_bytes=6, fields=fields)


def load_layout(path: Path) -> Layout:
    """Read and check a layout file.

    Raises:
        UsageError: it cannot be read, is not TOML, or a key is missing, unknown or impossible;
            the message names the key.
    """
    try:
        text = path.read_text(encoding="utf-8")
        document = tomllib.loads(text)
    except OSError as error:
        raise UsageError(f"the layout cannot be read ({error.strerror or error})", path=path) from error
    except UnicodeDecodeError as error:
        raise UsageError("the layout is not UTF-8 text", path=path, byte_offset=error.start) from error
    except tomllib.TOMLDecodeError as error:
        found = re.search(r"at line (\d+)", str(error))
        line = int(found[1]) if found else None
        raise UsageError(f"the layout is not valid TOML ({error})", path=path, line=line) from error
    return parse_layout(document, path)


def parse_layout(document: Mapping[str, Any], path: Path) -> Layout:
    """Check a layout's keys and sizes.

    Raises:
        UsageError: see `load_layout`.
    """
    top = Keys(document, path, "")
    dump, fields, page = top.table("dump"), top.table("fields"), top.optional_table("page")
    top.finish()
    found = {name: parse_field(fields.table(name)) for name in FIELD_NAMES if name in fields}
    fields.finish()
    check_fields(found, fields)
    layout = Layout(
        rate_hz=dump.number("rate_hz", low=0.001, high=100_000),
        lsb_per_g=dump.number("lsb_per_g", low=1e-6, high=1e12),
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
        frame_bytes=dump.whole("frame_bytes", max(field.end for field in found.values()), low=1),
        fields=found,
        sequence=parse_sequence(page.optional_table("sequence")) if page else None,
        stamp=parse_stamp(page.optional_table("time")) if page else None,
        checksum=parse_checksum(page.optional_table("crc")) if page else None,
    )
    dump.finish()
    if page:
        page.finish()
    check_geometry(layout, path, paged="page_bytes" in dump)
    return layout


def parse_field(keys: Keys) -> Field:
    """One entry of [fields]."""
    field = Field(
        offset=keys.whole("offset", None),
        type=keys.choice("type", tuple(FIELD_TYPES), None),
        per_unit=keys.optional_number("per_unit", low=-LARGEST_NUMBER, high=LARGEST_NUMBER),
        zero=keys.optional_number("zero", low=-LARGEST_NUMBER, high=LARGEST_NUMBER) or 0.0,
    )
    keys.finish()
    return field


def check_fields(found: Mapping[str, Field], fields: Keys) -> None:
    """x, y and z must be there, the gyroscope whole, and scales where they mean something."""
    for name in AXES:
        if name not in found:
            raise fields.error(name, "is missing")
        if found[name].per_unit is not None:
            raise fields.error(
                f"{name}.per_unit", "is not for x, y and z; their scale is lsb_per_g in [dump]"
            )
        if found[name].zero % 1 or abs(found[name].zero) > LARGEST_ZERO:
            raise fields.error(f"{name}.zero", "must be a whole number of counts")
    present = [name for name in GYRO if name in found]
    if 0 < len(present) < len(GYRO):
        raise fields.error(present[0], f"needs all of {', '.join(GYRO)}")
    for name in present:
        if found[name].scale < SMALLEST_SCALE:
            raise fields.error(f"{name}.per_unit", f"must be at least {SMALLEST_SCALE:g}")
        if abs(found[name].zero / found[name].scale) > LARGEST_ZERO:
            raise fields.error(f"{name}.zero", "is too large for its per_unit")


def parse_sequence(keys: Keys | None) -> Sequence | None:
    """`sequence` of [page]."""
    if keys is None:
        return None
    sequence = Sequence(keys.whole("offset", None), keys.choice("type", tuple(SEQUENCE_TYPES), None))
    keys.finish()
    return sequence


def parse_stamp(keys: Keys | None) -> Stamp | None:
    """`time` of [page]."""
    if keys is None:
        return None
    offset, kind = keys.whole("offset", None), keys.choice("type", tuple(TIME_TYPES), None)
    per_unit = keys.optional_number("per_unit", low=1e-6, high=60)
    keys.finish()
    return Stamp(offset, kind, 1.0 if per_unit is None else per_unit)


def parse_checksum(keys: Keys | None) -> Checksum | None:
    """`crc` of [page]."""
    if keys is None:
        return None
    offset, kind = keys.whole("offset", None), keys.choice("type", tuple(CHECKSUM_BYTES), None)
    start, stop = keys.pair("covers")
    keys.finish()
    return Checksum(offset, kind, start, stop)
