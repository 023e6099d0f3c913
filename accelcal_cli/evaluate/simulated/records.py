"""The evaluation by simulation as plain records."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

from accelcal_cli import __version__
from accelcal_cli.core.microcontrollers import predicted_seconds
from accelcal_cli.core.points import PARAMETER_NAMES
from accelcal_cli.evaluate.simulated.tally import Scores
from accelcal_cli.evaluate.simulation import Protocol, Table
from accelcal_cli.output.sections import significant

NINE = PARAMETER_NAMES[:9]
COLUMNS = (
    "points",
    "noise_mg",
    "source",
    "model",
    "parameter",
    "mean_abs_error",
    "sd_abs_error",
    "cases",
    "failed",
)


def as_json(protocol: Protocol, tables: tuple[Table, ...]) -> dict[str, Any]:
    """Everything; errors are plain numbers, of offsets in g. `seconds_per_fit` alone varies by run."""
    return {
        "accelcal_version": __version__,
        "protocol": asdict(protocol),
        "tables": [_table(table) for table in tables],
    }


def _table(table: Table) -> dict[str, Any]:
    published = table.published
    return {
        "points": table.points,
        "noise_mg": table.noise_mg,
        "published": None if published is None else _pair(published.mean, published.sd),
        "bound": _named(table.bound),
        "methods": [_method(table, scores) for scores in table.scores],
    }


def _method(table: Table, scores: Scores) -> dict[str, Any]:
    method, seconds = scores.method, scores.seconds
    counted = asdict(scores.operations) if scores.operations.additions else None
    predicted = predicted_seconds(scores.operations, method.optimizer.arithmetic)
    return {
        "method": method.label,
        "optimizer": method.optimizer.name,
        "profile": method.profile,
        "model": method.model.name,
        **_pair(scores.mean, scores.sd),
        "bias": _named(scores.bias),
        "ratio_to_bound": _short(scores.ratio_to_bound),
        "largest_ratio_to_published": _short(table.worst_against_paper(scores)),
        "cases": scores.fitted,
        "failed": sum(scores.failures.values()),
        "failures": scores.failures,
        "iterations": scores.iterations,
        "operations": counted,
        "predicted_seconds": predicted and {name: significant(value) for name, value in predicted.items()},
        "seconds_per_fit": _short(seconds),
    }


def _pair(mean: Sequence[float | None], sd: Sequence[float | None]) -> dict[str, Any]:
    return {"mean_abs_error": _named(mean), "sd_abs_error": _named(sd)}


def _named(values: Sequence[float | None]) -> dict[str, float | None]:
    return dict(zip(NINE, map(_short, values), strict=True))


def _short(value: float | None) -> float | None:
    return None if value is None else significant(value)


def rows(tables: tuple[Table, ...]) -> list[tuple[object, ...]]:
    """Of COLUMNS: one for each table, source (the paper, the bound, a method) and parameter."""
    return [
        (table.points, f"{table.noise_mg:g}", *row)
        for table in tables
        for source in _sources(table)
        for row in source
    ]


def _sources(table: Table) -> Iterator[Iterator[tuple[object, ...]]]:
    none: tuple[None, ...] = (None,) * 9
    if table.published is not None:
        yield _rows("paper", "9", (table.published.mean, table.published.sd), (None, None))
    yield _rows("bound", "9", (table.bound, none), (None, None))
    for scores in table.scores:
        counts = (scores.fitted, sum(scores.failures.values()))
        yield _rows(scores.method.label, scores.method.model.name, (scores.mean, scores.sd), counts)


def _rows(
    source: str,
    model: str,
    errors: tuple[Sequence[float | None], Sequence[float | None]],
    counts: tuple[int | None, int | None],
) -> Iterator[tuple[object, ...]]:
    for name, mean, sd in zip(NINE, *errors, strict=True):
        yield (source, model, name, _short(mean), _short(sd), *counts)
