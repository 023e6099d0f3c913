"""Archives of NumPy arrays (.npz).

Source: NumPy's documentation, "numpy.lib.format": a zip file whose members, NAME.npy, are an array each.
"""

from __future__ import annotations

from accelcal_cli.core.formats import ZIP_MAGIC, Format, Probe

MEMBER_SUFFIX = b".npy"
NAME_LENGTH, NAME = slice(26, 28), 30
"""Places of the length of the first member's name, and of the name."""


def sniff(probe: Probe) -> int:
    """Return 100 for a zip file whose first member is an array."""
    if not probe.head.startswith(ZIP_MAGIC):
        return 0
    length = int.from_bytes(probe.head[NAME_LENGTH], "little")
    return 100 if probe.head[NAME : NAME + length].endswith(MEMBER_SUFFIX) else 0


FORMAT = Format(
    name="npz",
    title="NumPy archive (.npz) with an array of acceleration",
    suffixes=(".npz",),
    sniff=sniff,
    reader="accelcal_cli.formats.npz.reader:open_recording",
    ignores=("layout", "date_format"),
    is_table=True,
)
