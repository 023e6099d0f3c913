"""F's collector: nine subsets of two points each, filled in the order of time.

Farago, Maczak, Gingl 2024, section II.B.1 and eq. 10: intervals [-1.25, -0.75], [-0.25, 0.25] and
[0.75, 1.25] g on each axis; a point goes to one subset, the first axis in the order x, y, z whose
interval contains it and whose subset is not full.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.cells import CellSums, plausible, to_points
from accelcal_cli.core.points import WEIGHT_ONE, PointSet, Role, Windows, WindowUses
from accelcal_cli.core.settings import Settings

INTERVALS_G = (
    (Fraction(-5, 4), Fraction(-3, 4)),
    (Fraction(-1, 4), Fraction(1, 4)),
    (Fraction(3, 4), Fraction(5, 4)),
)
AXES = "xyz"
LEVELS = ("-1 g", "0 g", "+1 g")
POINTS_PER_SUBSET = 2
"""Number of points in each of F's subsets."""

Mean = tuple[int, tuple[int, int, int]]
"""A window's number of samples and the sums of its counts."""


class SubsetCollector:
    """Collects 18 points; windows must come in the order of time.

    Args:
        most: points that a subset takes.
        least: points that a subset needs; None: `most`.
    """

    def __init__(self, lsb_per_g: float, most: int = POINTS_PER_SUBSET, least: int | None = None) -> None:
        self.lsb_per_g = lsb_per_g
        self.most = most
        self.least = most if least is None else least
        self._held: dict[tuple[int, int], list[CellSums]] = {
            (axis, level): [] for axis in range(3) for level in range(3)
        }

    def offer(self, samples: int, xyz: tuple[int, int, int]) -> bool:
        """Offer the sums of one window; returns True if it was taken."""
        subset = self.place(samples, xyz, self.most)
        if subset is not None:
            subset.append(CellSums(1, samples, xyz))
        return subset is not None

    def place(self, samples: int, xyz: tuple[int, int, int], most: int) -> list[CellSums] | None:
        """Return the subset of fewer than `most` points that would take one window's sums, or None."""
        for axis, value in enumerate(xyz):
            for level, (low, high) in enumerate(_bounds(self.lsb_per_g, samples)):
                subset = self._held[axis, level]
                if low <= value <= high and len(subset) < most:
                    return subset
        return None

    def needed(self, windows: Windows) -> NDArray[np.bool_]:
        """Return a mask (m,) of windows that lie in a subset that is not full."""
        needed = np.zeros(len(windows), np.bool_)
        for samples in sorted(set(windows.samples.tolist())):
            of_length = windows.samples == samples
            for (axis, level), subset in self._held.items():
                if len(subset) < self.most:
                    low, high = _bounds(self.lsb_per_g, samples)[level]
                    value = windows.sums[:, axis]
                    needed |= of_length & (value >= low) & (value <= high)
        return needed

    def filled(self) -> list[list[int]]:
        """Return the number of points of each subset: rows n, 0, p and columns x, y, z."""
        return [[len(self._held[axis, level]) for axis in range(3)] for level in range(3)]

    def missing(self) -> list[str]:
        """Return the names of subsets that lack points, such as `x -1 g` or `z 0 g`."""
        return [
            f"{AXES[axis]} {LEVELS[level]}"
            for (axis, level), subset in sorted(self._held.items())
            if len(subset) < self.least
        ]

    def points(self) -> PointSet:
        """Return the collected points, subset by subset."""
        sums = [item for _, subset in sorted(self._held.items()) for item in subset]
        return to_points(sums, [WEIGHT_ONE] * len(sums), self.lsb_per_g, temperature=False)


@cache
def _bounds(lsb_per_g: float, samples: int) -> list[tuple[int, int]]:
    """Return the intervals of eq. 10 in sums of counts."""
    count = Fraction(lsb_per_g) * samples
    return [(ceil(low * count), floor(high * count)) for low, high in INTERVALS_G]


class PaperCollector:
    """Collects F's two distinct sets: what the first does not take is offered to the second (control).

    If subsets take more points than they need, both sets get the points that they need first.

    A mean is offered only if it "differs sufficiently from the already acquired" ones (F section
    II.B.1): it is at least `min_distance_g` away from every point of both sets, in raw local g.

    Attributes:
        full_after: samples of the recording up to the end of the window that completed the first set.
    """

    def __init__(self, lsb_per_g: float, settings: Settings) -> None:
        self.lsb_per_g = lsb_per_g
        self.settings = settings
        self.implausible = 0
        most, least = settings.max_subset_points, settings.min_subset_points
        self.fit = SubsetCollector(lsb_per_g, most, least)
        self.control = SubsetCollector(lsb_per_g, most, least)
        self._limits = (least, most) if least < most else (most,)
        distance = Fraction(str(settings.min_distance_g)) * Fraction(lsb_per_g)
        self._distance = distance.numerator, distance.denominator
        self._taken: list[Mean] = []
        self._role_of_sample: dict[int, Role] = {}
        self._most = 2 * 9 * most
        self.full_after: int | None = None

    def add(self, windows: Windows) -> None:
        """Take still windows in, in the order of time."""
        usable = plausible(windows, self.lsb_per_g, self.settings)
        self.implausible += int(len(windows) - usable.sum())
        near_1_g = windows.select(usable)
        if len(self._taken) == self._most:
            return
        near_1_g = near_1_g.select(self.fit.needed(near_1_g) | self.control.needed(near_1_g))
        columns = (near_1_g.first_sample, near_1_g.samples, near_1_g.sums)
        for first_sample, samples, (x, y, z) in zip(*(column.tolist() for column in columns), strict=True):
            mean = (samples, (x, y, z))
            if not self._differs(mean):
                continue
            role, subset = self._place(mean)
            if subset is not None:
                subset.append(CellSums(1, *mean))
                self._taken.append(mean)
                self._role_of_sample[first_sample] = role
                if self.full_after is None and not self.fit.missing():
                    self.full_after = first_sample + samples

    def __len__(self) -> int:
        """Return the number of points of both sets."""
        return len(self._taken)

    def window_uses(self, windows: Windows) -> WindowUses:
        """Return what became of windows that were added, without the numbers of their points."""
        roles = [self._role_of_sample.get(first, Role.NOT_TAKEN) for first in windows.first_sample.tolist()]
        role = np.array(roles, np.int64)
        role[~plausible(windows, self.lsb_per_g, self.settings)] = Role.IMPLAUSIBLE
        return WindowUses(role, np.full(len(windows), -1))

    def _place(self, mean: Mean) -> tuple[Role, list[CellSums] | None]:
        """Return the role of a mean, and the subset of the first or else the second set that takes it."""
        for most in self._limits:
            for role, collector in ((Role.FIT, self.fit), (Role.CONTROL, self.control)):
                if (subset := collector.place(*mean, most)) is not None:
                    return role, subset
        return Role.NOT_TAKEN, None

    def _differs(self, mean: Mean) -> bool:
        """Return True if a mean is far enough from all points.

        The point that it is near is moved to the front: a rest lasts for many windows, so that one comparison
        settles most of them.
        """
        numerator, denominator = self._distance
        samples, (x, y, z) = mean
        for place, (others, (u, v, w)) in enumerate(self._taken):
            squares = (x * others - u * samples) ** 2 + (y * others - v * samples) ** 2
            squares += (z * others - w * samples) ** 2
            if squares * denominator**2 < (numerator * samples * others) ** 2:  # exact integers
                self._taken.insert(0, self._taken.pop(place))
                return False
        return True
