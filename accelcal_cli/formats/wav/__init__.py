"""Recordings that omconvert wrote as sound files (.wav): how they are recognised.

Sources: omconvert's description of its files and its program (github.com/digitalinteraction/omconvert,
src/omconvert/README.md and omconvert.c); what each field means to this reader is described in
docs/more-devices.md.
"""

from __future__ import annotations

import re

from accelcal_cli.core.formats import NOT_FOR_DEVICES, Format, Probe

MAGIC = b"RIFF"
KIND, KIND_AT = b"WAVE", 8
CHANNEL = re.compile(rb"Channel-\d+: *Accel-[XYZ]")


def sniff(probe: Probe) -> int:
    """Return 100 for a sound file whose comment names an axis of acceleration; 0 for any other sound."""
    if not probe.head.startswith(MAGIC) or not probe.head.startswith(KIND, KIND_AT):
        return 0
    return 100 if CHANNEL.search(probe.head) else 0


FORMAT = Format(
    "wav",
    "omconvert's sound files (.wav)",
    (".wav",),
    sniff,
    reader="accelcal_cli.formats.wav.reader:open_recording",
    ignores=NOT_FOR_DEVICES,
)
