"""The header page of the flash page format: see docs/flash-format.md."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from fractions import Fraction

from accelcal_cli.core.recording import Device
from accelcal_cli.readers._flash.signature import HEADER_MAGIC, PAGE_BYTES

VERSION = 1
FLAG_TEMPERATURE = 1
FLAG_CLOCK_NEVER_SET = 2
ZONE_UNKNOWN = -32768
LONGEST_ZONE_MINUTES = 18 * 60
RATES_HZ = (Fraction(1, 1000), Fraction(100_000))

LAYOUT = struct.Struct("<8sHHIIIIIIIhH32s32s32s")


@dataclass(frozen=True, slots=True)
class FlashHeader:
    """What page 0 says.

    Attributes:
        recording_id: the same number stands in every data page of the recording.
        timezone: `UTC` or an offset such as `+01:00`; None where unknown.
        clock_set: False where the times count from power-on.
    """

    recording_id: int
    rate: Fraction
    lsb_per_g: Fraction
    range_g: float | None
    has_temperature: bool
    clock_set: bool
    timezone: str | None
    device: Device


class HeaderDamageError(Exception):
    """Why a page is not a usable header, in plain words."""


def parse_header(page: bytes) -> FlashHeader:
    """Decode page 0.

    Args:
        page: its 512 bytes, or fewer at the end of a short file.

    Raises:
        HeaderDamageError: it is cut off, fails its checksum, or says something impossible.
    """
    if len(page) < PAGE_BYTES:
        raise HeaderDamageError(f"it is cut off after {len(page)} of {PAGE_BYTES} bytes")
    fields = LAYOUT.unpack_from(page)
    if fields[0] != HEADER_MAGIC:
        raise HeaderDamageError("it does not begin with the format's signature")
    if zlib.crc32(page[:-4]) != int.from_bytes(page[-4:], "little"):
        raise HeaderDamageError("its checksum is wrong")
    if fields[1:3] != (VERSION, PAGE_BYTES):
        raise HeaderDamageError(
            f"format version {fields[1]} with pages of {fields[2]} bytes is not supported"
        )
    rate, lsb_per_g = positive(fields[4:6], "sampling rate"), positive(fields[6:8], "number of counts per g")
    if not RATES_HZ[0] <= rate <= RATES_HZ[1]:
        raise HeaderDamageError(f"a sampling rate of {float(rate):g} Hz is impossible")
    return FlashHeader(
        recording_id=fields[3],
        rate=rate,
        lsb_per_g=lsb_per_g,
        range_g=fields[8] / 1000 or None,
        has_temperature=bool(fields[9] & FLAG_TEMPERATURE),
        clock_set=not fields[9] & FLAG_CLOCK_NEVER_SET,
        timezone=zone_name(fields[10]),
        device=Device(*(text_field(field) for field in (fields[13], fields[12], fields[14]))),
    )


def positive(pair: tuple[int, int], what: str) -> Fraction:
    """An exact fraction from numerator and denominator, both above 0."""
    if 0 in pair:
        raise HeaderDamageError(f"the {what} is {pair[0]}/{pair[1]}")
    return Fraction(*pair)


def text_field(data: bytes) -> str | None:
    """ASCII text up to the first zero byte; None where empty."""
    return data.split(b"\0")[0].decode("ascii", "replace").strip() or None


def zone_name(minutes: int) -> str | None:
    """The zone of an offset east of UTC."""
    if abs(minutes) > LONGEST_ZONE_MINUTES:
        return None
    hours, rest = divmod(abs(minutes), 60)
    return f"{'-' if minutes < 0 else '+'}{hours:02d}:{rest:02d}" if minutes else "UTC"
