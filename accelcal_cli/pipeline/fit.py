"""Points from a table in, a judgement out."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from accelcal_cli.collect.table import Table, given_points, read_table, table_of
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.points import PointSet
from accelcal_cli.core.settings import EffectiveSettings, Settings
from accelcal_cli.core.statistics import mean
from accelcal_cli.judge.errors import deviations_mg
from accelcal_cli.judge.verdict import judge
from accelcal_cli.output.report_kinds import PointsInput, build_points
from accelcal_cli.pipeline.jobs import sha256
from accelcal_cli.pipeline.survey import fitting, optimizer_json

if TYPE_CHECKING:
    import pandas as pd

IN_MEMORY = Path("table")
"""Stands for the path of a table that is in no file."""

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
    return _report(read_table(path), settings, path, digest, path.stat().st_size)


def fit_frame(frame: pd.DataFrame, settings: Settings) -> dict[str, Any]:
    """The same of a data frame; the report has the hash of its numbers.

    Raises:
        UnreadableError: it is no table of points.
    """
    held = frame.dropna(axis=1, how="all")
    table = table_of(held.set_index(np.arange(1, len(held) + 1)), IN_MEMORY)
    columns = [getattr(table, name) for name in table.__dataclass_fields__]
    content = b"".join(part.tobytes() for part in columns if isinstance(part, np.ndarray))
    return _report(table, settings, IN_MEMORY, hashlib.sha256(content).hexdigest(), len(content))


def _report(table: Table, settings: Settings, path: Path, digest: str, size: int) -> dict[str, Any]:
    given = given_points(table, settings, path)
    fitter = fitting(settings)
    why_none = NOT_NEAR if given.implausible else NO_POINTS
    verdict = judge(given.points, fitter, why_none, given.label, given.saturated)
    parameters = None if verdict.fit is None else verdict.fit.parameters
    data = PointsInput(
        path=path,
        sha256=digest,
        bytes=size,
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
