"""Recognises GENEActiv recordings (.bin), text with pages of 300 samples in hexadecimal digits.

Source: Activinsights, GENEActiv instructions, "Understanding .bin files"; docs/geneactiv-files.md says
what each field means to the reader. Times are those of the device's clock, which shows the local time of the
computer that set it up.
"""

from __future__ import annotations

import re

from accelcal_cli.core.formats import NOT_FOR_DEVICES, Format, Probe

HEADER_MAGIC = b"Device Identity"
MARK = b"Recorded Data"
"""First line of a page."""

_END = rb"[ \t]{0,32}\r?\n"
_ANY = rb"[^\r\n]{0,64}\r?\n"
PAGE_HEAD = (
    MARK
    + _END
    + rb"Device Unique Serial Code:([^\r\n]{0,64})\r?\n"
    + rb"Sequence Number:(\d{1,10})"
    + _END
    + rb"Page Time:(20\d\d-\d\d?-\d\d? \d\d?:\d\d?:\d\d?:\d{3})"
    + _END
    + rb"Unassigned:"
    + _ANY
    + rb"Temperature:([^\r\n]{0,64})\r?\n"
    + rb"Battery voltage:([^\r\n]{0,64})\r?\n"
    + rb"Device Status:"
    + _ANY
    + rb"Measurement Frequency:([^\r\n]{0,64})\r?\n"
)
"""Pattern of a page's text; the groups are serial number, sequence number, time, temperature, battery's
voltage and rate."""


def sniff(probe: Probe) -> int:
    """Return 100 for the header's first line, 97 for the text of a page where the header is damaged."""
    if probe.head.startswith(HEADER_MAGIC):
        return 100
    if MARK not in probe.head:
        return 0
    return 97 if re.search(PAGE_HEAD, probe.head) else 0


FORMAT = Format(
    "geneactiv",
    "GENEActiv (.bin)",
    (".bin",),
    sniff,
    reader="accelcal_cli.formats.geneactiv.reader:open_recording",
    ignores=NOT_FOR_DEVICES,
)
