"""Figures of the papers' tables."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Published:
    """Mean and standard deviation of the absolute errors, in the order kxx kyy kzz kxy kxz kyz ox oy oz."""

    mean: tuple[float, ...]
    sd: tuple[float, ...]


TABLE_2 = {
    1.0: Published(
        mean=(2.98e-4, 3.18e-4, 2.47e-4, 1.49e-3, 1.42e-3, 1.45e-3, 2.39e-4, 2.54e-4, 2.04e-4),
        sd=(2.37e-4, 2.27e-4, 1.68e-4, 1.22e-3, 1.23e-3, 1.26e-3, 1.88e-4, 1.91e-4, 1.5e-4),
    ),
    5.0: Published(
        mean=(1.39e-3, 1.64e-3, 1.07e-3, 2.61e-3, 2.67e-3, 3.3e-3, 1.05e-3, 1.18e-3, 1.08e-3),
        sd=(1.07e-3, 1.22e-3, 8.98e-4, 2.24e-3, 2.07e-3, 2.53e-3, 9.2e-4, 8.35e-4, 7.76e-4),
    ),
}
"""Farago, Maczak, Gingl 2024, Table 2, by noise [mg]."""

TABLE_8 = (0.6015, 0.0090)
"""Residuals with default and with local gravity, accelerometer, without a unit (Grammenos, Mascolo,
Crowcroft 2018, Table 8)."""

TABLE_8_GRAVITY = 9.81676
"""Local gravity of Table 8 [m/s2]."""
