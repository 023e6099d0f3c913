"""The flash page format, our own dump of a wrist logger's memory: how its header and pages are recognised.

Specified in docs/flash-format.md.
"""

from __future__ import annotations

from accelcal_cli.core.formats import GYRO_OPTIONS, Format, Probe

PAGE_BYTES = 512
HEADER_MAGIC = b"\x89ACL\r\n\x1a\n"
PAGE_MAGIC = b"ACLP"


def sniff(probe: Probe) -> int:
    """100 by the header's signature; 90 by a valid data page where the header is damaged."""
    if probe.head.startswith(HEADER_MAGIC):
        return 100
    places = range(PAGE_BYTES, len(probe.head), PAGE_BYTES)
    if not any(probe.head.startswith(PAGE_MAGIC, place) for place in places):
        return 0
    # Few files get as far as to need the checksum of a page.
    from accelcal_cli.formats.flash.reader import recording_id_in

    return 90 if recording_id_in(probe.head[PAGE_BYTES:]) is not None else 0


FORMAT = Format(
    "flash",
    "flash pages of a wrist logger (docs/flash-format.md)",
    (".bin",),
    sniff,
    reader="accelcal_cli.formats.flash.reader:open_recording",
    ignores=("unit", "columns", "time_column", "date_format", "layout", "sensor", *GYRO_OPTIONS),
)
