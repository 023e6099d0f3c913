"""GENEActiv recordings (.bin), text with pages of 300 samples in hexadecimal digits: how they are recognised.

Sources: Activinsights, GENEActiv instructions, "Understanding .bin files"; what each field means
to this reader is described in docs/geneactiv-files.md. Times are the device's clock, which shows the local
time of the computer that set it up.
"""

from __future__ import annotations

from accelcal_cli.core.formats import GYRO_OPTIONS, Format, Probe

HEADER_MAGIC = b"Device Identity"
MARK = b"Recorded Data"
"""The first line of a page."""


def sniff(probe: Probe) -> int:
    """100 by the header's first line; 97 by the text of a page where the header is damaged."""
    if probe.head.startswith(HEADER_MAGIC):
        return 100
    if MARK not in probe.head:
        return 0
    # Few files get as far as to need the pattern of a whole page.
    from accelcal_cli.formats.geneactiv.scan import HEAD

    return 97 if HEAD.search(probe.head) else 0


FORMAT = Format(
    "geneactiv",
    "GENEActiv (.bin)",
    (".bin",),
    sniff,
    reader="accelcal_cli.formats.geneactiv.reader:open_recording",
    ignores=("unit", "columns", "time_column", "date_format", "layout", "sensor", *GYRO_OPTIONS),
)
