"""Windows made by hand, and points as plain tuples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from accelcal_cli.core.points import PointSet, Windows


def windows(
    length: int | Sequence[int],
    sums: Sequence[Sequence[int]],
    spread: Sequence[Sequence[int]] | int = 3,
    temperature_sums: Sequence[int] | None = None,
) -> Windows:
    """Windows of one length or of several, one after another from sample 0 on."""
    number = len(sums)
    samples = np.full(number, length, np.int64)
    spreads = np.full((number, 3), spread, np.int64) if isinstance(spread, int) else spread
    return Windows(
        samples,
        np.cumsum(samples) - samples,
        np.array(sums, np.int64).reshape(number, 3),
        np.array(spreads, np.int64).reshape(number, 3),
        None if temperature_sums is None else np.array(temperature_sums, np.int64),
    )


def plain(points: PointSet) -> tuple[object, ...]:
    """All that a point set holds, comparable with ==."""
    tau = None if points.tau is None else points.tau.tolist()
    return (points.xyz.tolist(), points.weights.tolist(), points.windows.tolist(), tau, points.temperature)
