"""What a fit's operations cost on small processors (Farago, Maczak, Gingl 2024, Table 1).

The times are predictions from counted additions and multiplications alone, as the paper's are: 0.70 s
for 90 150 of each on an ATmega328. Loads, stores, narrowing and range checks come on top.
"""

from __future__ import annotations

from dataclasses import dataclass

from accelcal_cli.core.points import Arithmetic, Operations


@dataclass(frozen=True, slots=True)
class Cycles:
    """Clock cycles of one operation."""

    addition: int
    multiplication: int


@dataclass(frozen=True, slots=True)
class Microcontroller:
    """A processor of Table 1.

    Attributes:
        name: as in the table.
        clock_hz: the clock that the paper's times in section II.C refer to.
        current_ma: what it typically draws then, by the same section; that of the Cortex-M3, which it does
            not give, is taken to be that of the M4.
        cycles: cost by kind of number.
    """

    name: str
    clock_hz: int
    current_ma: float
    cycles: dict[Arithmetic, Cycles]

    def seconds(self, operations: Operations, arithmetic: Arithmetic) -> float:
        """Predicted time of so many operations [s]."""
        cost = self.cycles[arithmetic]
        cycles = operations.additions * cost.addition + operations.multiplications * cost.multiplication
        return cycles / self.clock_hz


MICROCONTROLLERS = (
    Microcontroller("ATmega328", 16_000_000, 9.2, {"integer": Cycles(28, 97), "float": Cycles(123, 160)}),
    Microcontroller("ARM Cortex-M3", 80_000_000, 8.45, {"integer": Cycles(14, 14), "float": Cycles(96, 68)}),
    Microcontroller("ARM Cortex-M4", 80_000_000, 8.45, {"integer": Cycles(7, 6), "float": Cycles(11, 11)}),
)


def predicted_seconds(operations: Operations, arithmetic: Arithmetic) -> dict[str, float] | None:
    """Predicted times by processor [s]; None if no operations were counted."""
    if operations == Operations():
        return None
    return {item.name: item.seconds(operations, arithmetic) for item in MICROCONTROLLERS}


def predicted_charge_mc(operations: Operations, arithmetic: Arithmetic) -> dict[str, float] | None:
    """Charge by processor, time times current [mC, which is mA s]; None if no operations were counted."""
    seconds = predicted_seconds(operations, arithmetic)
    return seconds and {item.name: seconds[item.name] * item.current_ma for item in MICROCONTROLLERS}
