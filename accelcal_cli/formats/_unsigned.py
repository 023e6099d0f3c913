"""Counts that are never negative, as converters give them: the count that stands for 0 g.

Rest lies on a sphere around that count, as far from it as 1 g. A converter of n bits has it near 2^(n-1),
such as 512 or 32768. How far off it is does not matter, since offsets of half a g are fitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.formats._gravity import usual_length

BLOCK, QUIET_SHARES = 8, (0.5, 0.15)
"""Consecutive rows whose mean and range are taken, and shares of such blocks, the quietest, for rest."""

CELLS, LEAST_CELLS = 12, 9
"""Parts of the range of an axis in which rest counts once; orientations of rest that a sphere needs."""

TURNED, OUTSIDE, LARGEST_SCATTER = 1.2, 1.1, 0.08
"""Least range of each axis and distance of 0 from the centre, and largest scatter of rest, in radii."""

NEAR_G, LEAST_RANGE_G = 0.5, 1.25
"""Largest offset [g] from the middle of the range of a converter, and its least range on either side."""

ABOUT_1_G, FAR_FROM_1_G = (0.75, 1.3), (0.5, 2.0)
"""Usual lengths [g] with the right scale and zero, and those between which counts have no other zero."""

MIDDLES, EXACT = tuple(1 << bits for bits in range(6, 31)), 1000
"""Middles of the ranges of converters, and radius [counts] from which on all digits are shown."""

FOUND_ZERO = "0 g is at {} counts, around which rest lies (-R zero says it)"

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Sphere:
    """The sphere on which rest lies: its centre and radius in counts."""

    centre: tuple[float, float, float]
    radius: float

    def middle(self) -> int | None:
        """Return the middle of the range of a converter that is the centre, within half a g; None if none."""
        off = {middle: max(abs(at - middle) for at in self.centre) for middle in MIDDLES}
        nearest = min(MIDDLES, key=lambda middle: off[middle])
        return nearest if off[nearest] < NEAR_G * self.radius else None


def sphere_of_rest(values: Floats) -> Sphere | None:
    """Return the sphere on which rest lies away from 0; None unless rows (n, 3) are counts that show it."""
    if not are_unsigned(values):
        return None
    values = values[np.isfinite(values).all(axis=1) & values.any(axis=1)]
    blocks = values[: len(values) // BLOCK * BLOCK].reshape(-1, BLOCK, 3)
    if not len(blocks):
        return None
    spread, means = np.ptp(blocks, axis=1).max(axis=1), blocks.mean(axis=1)
    spheres = (_sphere_of(means[spread <= np.quantile(spread, share)]) for share in QUIET_SHARES)
    return next((sphere for sphere in spheres if sphere is not None), None)


def _sphere_of(means: Floats) -> Sphere | None:
    """Return the sphere of means of rest (m, 3): the linear least squares of |v|^2 = 2 c v + d.

    None unless they turn on all axes, lie near it, and 0 is far from it.
    """
    low, widest = means.min(axis=0), float(np.ptp(means, axis=0).max())
    if not widest:
        return None
    _, first = np.unique((means - low) // (widest / CELLS), axis=0, return_index=True)
    points, middle = means[first] - low, widest / 2
    if len(points) < LEAST_CELLS:
        return None
    rows = np.column_stack([2 * (points - middle), np.ones(len(points))])
    (x, y, z, rest), *_ = np.linalg.lstsq(rows, ((points - middle) ** 2).sum(axis=1), rcond=None)
    centre = np.array([x, y, z])
    radius = float(np.sqrt(max(rest + centre @ centre, 0.0)))
    off = np.linalg.norm(points - middle - centre, axis=1) - radius
    turned = bool((np.ptp(points, axis=0) > TURNED * radius).all())
    centre += low + middle
    if np.sqrt(np.mean(off**2)) > LARGEST_SCATTER * radius or not turned or (centre < OUTSIDE * radius).any():
        return None
    return Sphere((float(centre[0]), float(centre[1]), float(centre[2])), radius)


def are_unsigned(values: Floats) -> bool:
    """Return True if all values that are not missing are whole, and none is negative."""
    known = values[np.isfinite(values)]
    return bool(len(known) and known.min() >= 0 and (known == np.rint(known)).all())


def refuse_other_zero(values: Floats, path: Path) -> None:
    """Raise UnreadableError if rest lies around another count than 0, in counts of an unknown scale."""
    if (sphere := sphere_of_rest(values)) is not None:
        raise _off_zero(sphere, path)


def zero_of(values: Floats, lsb_per_g: float, path: Path) -> int | None:
    """Return the count of 0 g that counts (n, 3) of a known scale show; None where it is 0, or unknown.

    Raises UnreadableError if rest lies around a count that is not the middle of a converter's range, or the
    scale does not fit.
    """
    length = usual_length(values) / lsb_per_g
    if FAR_FROM_1_G[0] < length < FAR_FROM_1_G[1] or not are_unsigned(values):
        return None
    if (sphere := sphere_of_rest(values)) is not None:
        middle, fits = sphere.middle(), ABOUT_1_G[0] < sphere.radius / lsb_per_g < ABOUT_1_G[1]
        if middle is None or not fits:
            raise _off_zero(sphere, path, lsb_per_g if fits else None)
        return middle
    reaching = [middle for middle in MIDDLES if middle > LEAST_RANGE_G * lsb_per_g]
    lengths = {middle: usual_length(values - middle) / lsb_per_g for middle in reaching}
    near = [middle for middle, one in lengths.items() if ABOUT_1_G[0] < one < ABOUT_1_G[1]]
    return near[0] if len(near) == 1 else None


def scale_hint(values: Floats, zero: int | None) -> str:
    """Return the advice to give the scale of counts, with about what it is where their zero is known."""
    length = 0.0 if zero is None else usual_length(values - zero)
    return "give --lsb-per-g, the counts in one g" + (f", about {length:.3g}" if length else "")


def _off_zero(sphere: Sphere, path: Path, lsb_per_g: float | None = None) -> UnreadableError:
    """Return the error that rest lies around another count than 0, with the options that say so."""
    about = ", ".join(f"{at:.0f}" for at in sphere.centre)
    radius = f"{sphere.radius:.0f}" if sphere.radius >= EXACT else f"{sphere.radius:.3g}"
    scale = radius if lsb_per_g is None else f"{lsb_per_g:.10g}"
    zero = sphere.middle() or round(sum(sphere.centre) / 3)
    return UnreadableError(
        f"its values are counts above 0: at rest they lie {radius} counts from the middle {about}",
        path=path,
        hint=f"give -R zero={zero} --lsb-per-g {scale}, or the counts of 0 g and of 1 g in the data sheet",
    )
