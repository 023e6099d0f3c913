"""Points from a table in, a judgement out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from accelcal_cli.collect.table import given_points, read_table
from accelcal_cli.core.points import IDENTITY, PointSet
from accelcal_cli.core.settings import EffectiveSettings, Settings
from accelcal_cli.judge.errors import deviations_mg, mean
from accelcal_cli.judge.verdict import judge
from accelcal_cli.output.report_kinds import PointsInput, build_points
from accelcal_cli.pipeline.jobs import sha256
from accelcal_cli.pipeline.survey import fitting, optimizer_json

NOT_NEAR = "no point is anywhere near 1 g; x, y and z must be in g"
NO_POINTS = "the table holds no points"


def fit_points(path: Path, settings: Settings) -> dict[str, Any]:
    """Fit and judge the still-window means of a table as `calibrate` does a recording's.

    Returns:
        the report without `provenance`.

    Raises:
        UnreadableError: it is no table of points.
    """
    digest = sha256(path)
    table = read_table(path)
    given = given_points(table, settings)
    fitter = fitting(settings)
    why_none = NOT_NEAR if given.implausible else NO_POINTS
    verdict = judge(given.points, fitter, why_none, given.label, given.saturated)
    parameters = None if verdict.fit is None else verdict.fit.parameters
    data = PointsInput(
        path=path,
        sha256=digest,
        bytes=path.stat().st_size,
        rows=len(table),
        implausible=given.implausible,
        raw_error_mg=_error_mg(given.rows, IDENTITY),
        after_error_mg=None if parameters is None else _error_mg(given.rows, parameters),
        settings=EffectiveSettings(settings, True, {"format": "points"}),
        judgement=verdict,
        optimizer=optimizer_json(settings),
    )
    return build_points(data)


def _error_mg(rows: PointSet, parameters: tuple[int, ...]) -> float | None:
    return mean(deviations_mg(rows, parameters).tolist()) if len(rows) else None
