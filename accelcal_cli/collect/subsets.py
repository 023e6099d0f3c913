"""F's collector: nine subsets of two points each, filled in the order of time.

Farago, Maczak, Gingl 2024, section II.B.1 and eq. 10: intervals [-1.25, -0.75], [-0.25, 0.25] and
[0.75, 1.25] g on each axis; a point goes to one subset, the first axis in the order x, y, z whose
interval contains it and whose subset is not full.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from math import ceil, floor

from accelcal_cli.collect.cells import Sums, plausible, to_points
from accelcal_cli.core.points import WEIGHT_ONE, PointSet, Windows
from accelcal_cli.core.settings import Settings

INTERVALS_G = (
    (Fraction(-5, 4), Fraction(-3, 4)),
    (Fraction(-1, 4), Fraction(1, 4)),
    (Fraction(3, 4), Fraction(5, 4)),
)
AXES = "xyz"
LEVELS = "n0p"
POINTS_PER_SUBSET = 2


class SubsetCollector:
    """Collects 18 points; windows must come in the order of time."""

    def __init__(self, lsb_per_g: float, per_subset: int = POINTS_PER_SUBSET) -> None:
        self.lsb_per_g = lsb_per_g
        self.per_subset = per_subset
        self._held: dict[tuple[int, int], list[Sums]] = {
            (axis, level): [] for axis in range(3) for level in range(3)
        }

    def offer(self, samples: int, xyz: tuple[int, int, int]) -> bool:
        """Offer one window's sums of so many samples' counts; says whether it was taken."""
        for axis, value in enumerate(xyz):
            for level, (low, high) in enumerate(_bounds(self.lsb_per_g, samples)):
                subset = self._held[axis, level]
                if low <= value <= high and len(subset) < self.per_subset:
                    subset.append(Sums(1, samples, xyz))
                    return True
        return False

    def missing(self) -> list[str]:
        """Names of subsets that are not full, such as `xn` (x negative) or `z0`."""
        return [
            AXES[axis] + LEVELS[level]
            for (axis, level), subset in sorted(self._held.items())
            if len(subset) < self.per_subset
        ]

    def points(self) -> PointSet:
        """The collected points, subset by subset."""
        sums = [item for _, subset in sorted(self._held.items()) for item in subset]
        return to_points(sums, [WEIGHT_ONE] * len(sums), self.lsb_per_g, temperature=False)


@cache
def _bounds(lsb_per_g: float, samples: int) -> list[tuple[int, int]]:
    """The intervals of eq. 10 in sums of so many samples' counts."""
    count = Fraction(lsb_per_g) * samples
    return [(ceil(low * count), floor(high * count)) for low, high in INTERVALS_G]


class PaperCollector:
    """F's two distinct sets: what the first does not take is offered to the second (control)."""

    def __init__(self, lsb_per_g: float, settings: Settings) -> None:
        self.lsb_per_g = lsb_per_g
        self.settings = settings
        self.implausible = 0
        self.fit = SubsetCollector(lsb_per_g)
        self.control = SubsetCollector(lsb_per_g)

    def add(self, windows: Windows) -> None:
        """Take still windows in, in the order of time."""
        usable = plausible(windows, self.lsb_per_g, self.settings)
        self.implausible += int(len(windows) - usable.sum())
        near_1_g = windows.select(usable)
        for samples, (x, y, z) in zip(near_1_g.samples.tolist(), near_1_g.sums.tolist(), strict=True):
            if not self.fit.offer(samples, (x, y, z)):
                self.control.offer(samples, (x, y, z))
