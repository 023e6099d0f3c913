"""The time of a file's last row, without reading what lies before."""

from __future__ import annotations

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import GZIP_MAGIC
from accelcal_cli.readers._csv.blocks import lone_block
from accelcal_cli.readers._csv.sheet import Sheet
from accelcal_cli.readers._csv.time import NO_TIME

TAIL_BYTES = 1 << 16


def last_time(sheet: Sheet) -> int | None:
    """Time of the last row [us]; None where the file is compressed or has no times."""
    with sheet.path.open("rb") as file:
        if sheet.time is None or file.read(2) == GZIP_MAGIC or sheet.dialect.bare_returns:
            return None
        size = file.seek(0, 2)
        file.seek(max(sheet.dialect.offset, size - TAIL_BYTES))
        lines = file.read().splitlines(keepends=True)[-3:]
    whole = [line for line in lines if line.endswith((b"\n", b"\r")) and line.strip()][-1:]
    try:
        stamps = sheet.cells(lone_block(b"".join(whole), 1, 0)).time_us
    except UnreadableError:
        return None
    usable = stamps is not None and len(stamps) and stamps[-1] != NO_TIME
    return int(stamps[-1]) if stamps is not None and usable else None
