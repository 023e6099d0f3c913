"""Calibration points from given still-window means.

Without weights and postures of their own, the means are collected like a recording's windows, in
orientation cells. Otherwise the same cells are kept apart by posture, and what the table says of
weights stands: a point then weighs as much as its rows together.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect._to_points import Sums, to_points
from accelcal_cli.collect.cells import MAX_POINTS, CellCollector
from accelcal_cli.collect.plausible import plausible
from accelcal_cli.collect.table import Table
from accelcal_cli.core.fixed import ONE, rounded_quotient
from accelcal_cli.core.points import WEIGHT_ONE, PointSet
from accelcal_cli.core.recording import FLOAT_LSB_PER_G
from accelcal_cli.core.settings import Settings
from accelcal_cli.core.windows import Windows

WIDEST_SPREAD = 1 << 20
"""The spread within a given window is not known: none is taken for a constant one."""

Key = tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """What a table holds.

    Attributes:
        points: the points to fit, cells of orientation.
        label: (n,) the table's own postures, or None.
        rows: each plausible row as a point of its own, for errors over windows.
        implausible: rows whose length is nowhere near 1 g.
    """

    points: PointSet
    label: NDArray[np.int64] | None
    rows: PointSet
    implausible: int


def given_points(table: Table, settings: Settings) -> Given:
    """Points of a table's rows, in units of local gravity."""
    lsb_per_g = FLOAT_LSB_PER_G * float(settings.gravity.local_g())
    near = plausible(_windows(table), lsb_per_g, settings)
    kept = table.select(near)
    warm = settings.temperature and table.temperature_mc is not None
    if table.weight is None and table.posture is None:
        collector = CellCollector(lsb_per_g, settings, temperature=warm)
        collector.add(_windows(kept))
        points, label = collector.points(), None
    else:
        points, label = _kept_apart(kept, lsb_per_g, settings, warm=warm)
    return Given(points, label, _rows(kept, lsb_per_g, points), int((~near).sum()))


def _windows(table: Table) -> Windows:
    number = len(table)
    order, spread = np.arange(number), np.full((number, 3), WIDEST_SPREAD)
    return Windows(np.ones(number, np.int64), order, table.counts, spread, table.temperature_mc)


def _kept_apart(
    table: Table, lsb_per_g: float, settings: Settings, *, warm: bool
) -> tuple[PointSet, NDArray[np.int64] | None]:
    """Cells within postures; wider ones where there would be too many."""
    width: float = settings.cells_per_g
    shares = _shares(table)
    while len(cells := _cells(table, shares, _keys(table, lsb_per_g, width, warm=warm))) > MAX_POINTS:
        width = width / 2
    ordered = sorted(cells.items())
    weights = _own_weights(ordered) if table.weight is not None else _group_weights(ordered)
    points = to_points([sums for _, sums in ordered], weights, lsb_per_g, temperature=warm)
    label = None if table.posture is None else np.array([key[0] for key, _ in ordered], np.int64)
    return points, label


def _shares(table: Table) -> NDArray[np.int64]:
    """Weights as integers, the largest is WEIGHT_ONE; ones without weights."""
    if table.weight is None:
        return np.ones(len(table), np.int64)
    if not len(table):
        return np.zeros(0, np.int64)
    relative = np.rint(table.weight / table.weight.max() * WEIGHT_ONE).astype(np.int64)
    return np.asarray(np.maximum(1, relative))


def _keys(table: Table, lsb_per_g: float, cells_per_g: float, *, warm: bool) -> NDArray[np.int64]:
    """(n, 5): posture, cell, degree C."""
    keys = np.zeros((len(table), 5), np.int64)
    scale = Fraction(lsb_per_g).limit_denominator(1000) / Fraction(cells_per_g)
    if table.posture is not None:
        keys[:, 0] = table.posture
    keys[:, 1:4] = table.counts * scale.denominator // scale.numerator
    if warm and table.temperature_mc is not None:
        keys[:, 4] = table.temperature_mc // 1000
    return keys


def _cells(table: Table, shares: NDArray[np.int64], keys: NDArray[np.int64]) -> dict[Key, Sums]:
    unique, inverse, number = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    total = np.zeros((len(unique), 5), np.int64)
    milli = np.zeros(len(table), np.int64) if table.temperature_mc is None else table.temperature_mc
    columns = np.column_stack([np.ones_like(shares), table.counts, milli])
    np.add.at(total, inverse.reshape(-1), columns * shares[:, np.newaxis])
    return {
        tuple(key): Sums(count, samples, (x, y, z), heat)
        for key, count, (samples, x, y, z, heat) in zip(
            unique.tolist(), number.tolist(), total.tolist(), strict=True
        )
    }


def _own_weights(ordered: list[tuple[Key, Sums]]) -> list[int]:
    """As given; a point of mean weight counts as one."""
    total = sum(sums.samples for _, sums in ordered)
    return [max(1, rounded_quotient(s.samples * len(ordered) * WEIGHT_ONE, total)) for _, s in ordered]


def _group_weights(ordered: list[tuple[Key, Sums]]) -> list[int]:
    """Each 2 x 2 x 2 group of cells of one posture counts as one point, as in `cells`."""
    groups: dict[Key, int] = defaultdict(int)
    for key, sums in ordered:
        groups[_group(key)] += sums.windows
    return [max(1, rounded_quotient(s.windows * WEIGHT_ONE, groups[_group(key)])) for key, s in ordered]


def _group(key: Key) -> Key:
    return (key[0], *(part >> 1 for part in key[1:4]))


def _rows(table: Table, lsb_per_g: float, points: PointSet) -> PointSet:
    """One point a row, its temperature on the scale of the points that were fitted."""
    warm = points.temperature
    milli = [0] * len(table) if table.temperature_mc is None else table.temperature_mc.tolist()
    sums = [Sums(1, 1, (x, y, z), heat) for (x, y, z), heat in zip(table.counts.tolist(), milli, strict=True)]
    rows = to_points(sums, [WEIGHT_ONE] * len(sums), lsb_per_g, temperature=False)
    if warm is None:
        return rows
    span = 1000 * round(warm.span_c)
    tau = [rounded_quotient((heat - warm.reference_mc) * ONE, span) for heat in milli]
    return replace(rows, tau=np.array(tau, np.int64), temperature=warm)
