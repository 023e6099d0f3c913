"""The first 1024 bytes of a .cwa file: who recorded. What the data say goes before what they say.

Source: `Docs/ax3/cwa.h` (github.com/digitalinteraction/openmovement).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from fractions import Fraction

from accelcal_cli.core.recording import Device
from accelcal_cli.readers._cwa.sector import Settings, rate_of
from accelcal_cli.readers._cwa.signature import HEADER_BYTES, HEADER_MAGIC, SECTOR_BYTES, SECTOR_MAGIC

NO_DEVICE = Device()
AX3, AX6 = "AX3", "AX6"
MODELS = {0x00: AX3, 0x16: AX3, 0x17: AX3, 0x18: AX3, 0xFF: AX3, 0x64: AX6}
UNSET_WORD = 0xFFFF
UNSET_BYTE = 0xFF
FRACTION_FLAG = 0x8000


@dataclass(frozen=True, slots=True)
class Header:
    """What the header tells.

    Attributes:
        data_start: where the first data sector lies, bytes.
        intact: whether the file begins with a header at all.
        device: all None where it does not.
        rate: the configured one, None where unset.
        hardware: the hardware type it declares, None where the header is lost.
    """

    data_start: int
    intact: bool
    device: Device = NO_DEVICE
    rate: Fraction | None = None
    hardware: int | None = None


def parse_header(head: bytes) -> Header:
    """Look at the beginning of a file; without a header, the data may begin at once."""
    if not head.startswith(HEADER_MAGIC) or len(head) < HEADER_BYTES:
        found = (at for at in (0, SECTOR_BYTES) if head.startswith(SECTOR_MAGIC, at))
        return Header(next(found, HEADER_BYTES), False)
    hardware, low = struct.unpack_from("<BH", head, 4)
    (high,) = struct.unpack_from("<H", head, 11)
    rate, firmware = head[36], head[41]
    number = low | (0 if high == UNSET_WORD else high << 16)
    device = Device(
        model=MODELS.get(hardware),
        serial=None if number in (0, UNSET_WORD) else str(number),
        firmware=None if firmware == UNSET_BYTE else str(firmware),
    )
    return Header(HEADER_BYTES, True, device, None if rate in (0, UNSET_BYTE) else rate_of(rate), hardware)


def device_of_sector(settings: Settings, fraction: int) -> Device:
    """What a data sector tells of its device, where the header is lost.

    Args:
        fraction: the word that holds either the fraction of the second or the device's number.
    """
    model = AX6 if settings.scale_bits >> 3 or settings.width > 3 else AX3
    numbered = fraction and not fraction & FRACTION_FLAG
    return Device(model, str(fraction) if numbered else None)
