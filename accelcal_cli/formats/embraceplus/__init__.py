"""Empatica EmbracePlus: raw data as Avro files of half an hour each, and how they are recognised."""

from __future__ import annotations

from accelcal_cli.core.formats import ONLY_TABLES, TIMES_OF_TABLES, Format, Probe

AVRO_MAGIC = b"Obj\x01"
SCHEMA_WORDS = (b"empatica", b"rawData")


def sniff(probe: Probe) -> int:
    """Return 100 for an Avro file whose schema speaks of Empatica or of raw data."""
    is_avro = probe.head.startswith(AVRO_MAGIC)
    return 100 if is_avro and any(word in probe.head for word in SCHEMA_WORDS) else 0


FORMAT = Format(
    "embraceplus",
    "Empatica EmbracePlus raw data (Avro)",
    (".avro",),
    sniff,
    reader="accelcal_cli.formats.embraceplus.reader:open_recording",
    ignores=("unit", "lsb_per_g", "columns", *TIMES_OF_TABLES, "layout", "sensor", *ONLY_TABLES),
)
