"""GENEActiv recordings (.bin): text with a header and pages of 300 samples in hexadecimal digits.

Sources: Activinsights, GENEActiv instructions, "Understanding .bin files"; what each field means
to this reader stands in docs/geneactiv-files.md. Times are the device's clock, which shows the local time of
the computer that set it up.
"""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.formats import Format, Probe, ReadOptions
from accelcal_cli.core.recording import Reader
from accelcal_cli.readers._geneactiv.signature import HEADER_MAGIC, MARK


def sniff(probe: Probe) -> int:
    """100 by the header's first line; 97 by the text of a page where the header is damaged."""
    if probe.head.startswith(HEADER_MAGIC):
        return 100
    if MARK not in probe.head:
        return 0
    # Few files get as far as to need the pattern of a whole page.
    from accelcal_cli.readers._geneactiv.page import HEAD

    return 97 if HEAD.search(probe.head) else 0


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording. What reads is imported only now: every start of the command lists all formats.

    Raises:
        UnreadableError: no page is intact, or the factory's calibration is lost and `lsb_per_g` not given.
        UsageError: the user's rate contradicts that of the pages.
    """
    from accelcal_cli.readers._geneactiv import opening

    return opening.open_recording(path, options)


FORMAT = Format(
    "geneactiv",
    "GENEActiv (.bin)",
    (".bin",),
    sniff,
    open_recording,
    ignores=("unit", "columns", "time_column", "date_format", "layout", "sensor"),
)
