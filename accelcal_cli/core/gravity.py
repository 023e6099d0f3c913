"""Local gravity by latitude and altitude (Grammenos, Mascolo, Crowcroft 2018, eq. 16-18)."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import radians, sin

STANDARD_GRAVITY = 9.80665
"""m/s2 in one g (BIPM, 3rd CGPM 1901)."""

_EQUATOR = 9.780327
_FREE_AIR_PER_M = 3.086e-6
_DECIMALS = 9


def local_gravity(latitude: float, altitude_m: float = 0.0) -> float:
    """Return gravity [m/s2] at a latitude [degrees] and an altitude above the sea [m].

    The International Gravity Formula of 1980 (Moritz 2000, J. Geodesy 74: 128), and the free-air correction.
    """
    angle = radians(latitude)
    at_sea_level = _EQUATOR * (1 + 0.0053024 * sin(angle) ** 2 - 0.0000058 * sin(2 * angle) ** 2)
    return at_sea_level - _FREE_AIR_PER_M * altitude_m


def standard_g(metres_per_s2: float) -> Fraction:
    """Convert a gravity to units of standard g, with nine decimals.

    Rounding makes it the same number on every machine, whatever the last bit of a latitude's sine.
    """
    return Fraction(round(metres_per_s2 / STANDARD_GRAVITY * 10**_DECIMALS), 10**_DECIMALS)


UNKNOWN_PLACE_G = 0.0015
"""Standard deviation of local gravity where people live [g]: from 0.997 near the equator to 1.001."""


@dataclass(frozen=True, slots=True)
class Gravity:
    """The place of a recording; without a latitude, rest measures 1 standard g.

    Attributes:
        latitude: degrees, north positive.
        altitude_m: metres above the sea; None: 0.
    """

    latitude: float | None = None
    altitude_m: float | None = None

    def local_g(self) -> Fraction:
        """Return local gravity in units of standard g; exactly 1 without a latitude."""
        if self.latitude is None:
            return Fraction(1)
        return standard_g(local_gravity(self.latitude, self.altitude_m or 0.0))

    def uncertainty_g(self) -> float:
        """Return the standard deviation of what is not known of local gravity [g]; 0 with a latitude."""
        return UNKNOWN_PLACE_G if self.latitude is None else 0.0


STANDARD = Gravity()
"""A place where rest measures 1 standard g."""
