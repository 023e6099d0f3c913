"""From a sector's temperature word to degrees C: which part the hardware carries.

The word's low ten bits stand for 3 V. Sources, all in github.com/digitalinteraction/openmovement:

- `Docs/ax3/cwa.h` and `ax3-auxiliary.md` give raw * 75 / 256 - 50, an MCP9700 (500 mV at 0 C, 10 mV
  per degree). It holds for units that declare no hardware version (0x00, 0xff) and for the AX6
  (0x64): a recording of such a unit on the body gives 24-35 C, the other formula 17-23 C.
- The firmware's profiles of AX3 hardware 1.6 to 1.8 (`Firmware/Flux.AX3/include/Hardware/
  HardwareProfile-CWA1.7.h`) define an MCP9701 (400 mV at 0 C, 19.5 mV per degree): raw * 0.15 - 20.5,
  the formula of the vendor's omconvert. Such units declare themselves as 0x16 to 0x18.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

TEMPERATURE_MASK = 0x3FF
NO_SENSOR = (0, TEMPERATURE_MASK)
"""Readings at either end of the converter: nothing is fitted."""


@dataclass(frozen=True, slots=True)
class Thermometer:
    """A temperature sensor: thousandths of a degree C = raw * slope / divisor - zero.

    Attributes:
        formula: for people, in degrees C.
    """

    part: str
    slope: int
    divisor: int
    zero: int
    formula: str

    def temperature_mc(self, raw: NDArray[np.uint16]) -> NDArray[np.int32]:
        """Thousandths of a degree C of temperature words, rounded to the nearest."""
        scaled = (raw & TEMPERATURE_MASK).astype(np.int32) * self.slope
        return (scaled + self.divisor // 2) // self.divisor - np.int32(self.zero)

    @property
    def note(self) -> str:
        """A note for the report."""
        return f"temperature = {self.formula} degrees C ({self.part})"


MCP9700 = Thermometer("MCP9700", 75_000, 256, 50_000, "raw * 75 / 256 - 50")
MCP9701 = Thermometer("MCP9701", 150, 1, 20_500, "raw * 0.15 - 20.5")
_BY_HARDWARE = {0x16: MCP9701, 0x17: MCP9701, 0x18: MCP9701}


def thermometer(hardware: int | None) -> Thermometer:
    """The sensor of a hardware type (header byte 4); that of the format document where unknown."""
    return MCP9700 if hardware is None else _BY_HARDWARE.get(hardware, MCP9700)
