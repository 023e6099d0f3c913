"""Tables of still windows: written along a recording (`--windows`), and fitted (`accelcal fit`)."""

from __future__ import annotations

import hashlib
import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from accelcal_cli.core.arithmetic import mean
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import Reason, UnreadableError, UsageError, printable
from accelcal_cli.core.identity import WINDOWS
from accelcal_cli.core.points import PointSet
from accelcal_cli.core.settings import EffectiveSettings, Settings
from accelcal_cli.judge.errors import deviations_mg
from accelcal_cli.judge.model_ladder import folds, postures
from accelcal_cli.judge.verdict import judge
from accelcal_cli.output import report as reports
from accelcal_cli.output.report import PointsInput, ReportInput, build_points
from accelcal_cli.pipeline.jobs import PARQUET, Job, refuse_dash, refuse_overwriting, sha256
from accelcal_cli.pipeline.procedures import Method, Procedure, fitting, optimizer_json
from accelcal_cli.pipeline.survey import StillWindows

if TYPE_CHECKING:
    import pandas as pd

    from accelcal_cli.collect.table import PointTable
    from accelcal_cli.output.windows import WindowTable

CSV = ".csv"
IN_MEMORY = Path("table")
"""Stands for the path of a table that is in no file."""

NOT_NEAR, NO_POINTS = Reason("no_point_near_1_g"), Reason("no_points")


def check_table_path(path: Path, jobs: list[Job]) -> None:
    """Raise UsageError for a table of windows that cannot be written next to the jobs' outputs."""
    refuse_dash(path)
    if path.suffix.lower() not in (PARQUET, CSV):
        raise UsageError(f"--windows {printable(path)} is neither .parquet nor .csv", hint="name it so")
    if len(jobs) > 1:
        raise UsageError("--windows names one file, but there are several recordings", hint="give one")
    for job in jobs:
        refuse_overwriting((path,), (job.source, *job.outputs))


class WindowLog(StillWindows):
    """Keeps a recording's still windows with their times, and tells what became of each."""

    procedure: Procedure

    def watch(self, method: Method, rate_hz: float) -> Method:
        """Keep the windows of a method, and return it with windows that carry their times."""
        self.procedure = method.procedure
        return method.timed(rate_hz)

    def write(self, path: Path, data: ReportInput, points: PointSet) -> None:
        """Write the table.

        Args:
            points: the points that were made of the windows.

        Raises:
            OutputError: the file cannot be written.
        """
        from accelcal_cli.output.windows import write_windows  # few runs write it

        write_windows(self.table(data, points), path, reports.parquet_metadata(data) | {"kind": WINDOWS})

    def table(self, data: ReportInput, points: PointSet) -> WindowTable:
        """Return the windows, and what became of each."""
        from accelcal_cli.output.windows import WindowTable

        windows, settings = self.result(), data.settings.method
        assert isinstance(settings, Settings)
        window_uses = self.procedure.window_uses(windows)
        label = postures(points, settings.posture_degrees)
        known = window_uses.point >= 0
        posture, fold = (np.full(len(windows), -1) for _ in range(2))
        posture[known] = label[window_uses.point[known]]
        if data.judgement.holdout is not None:
            fold[known] = folds(posture[known], settings.folds)
        return WindowTable(
            windows,
            data.recording.lsb_per_g,
            window_uses,
            posture,
            fold,
            data.judgement.calibration,
            data.facts.utc_offset_s,
        )


def fit_points(path: Path, settings: Settings) -> dict[str, Any]:
    """Fit and judge the still-window means of a table as `calibrate` does a recording's.

    Returns:
        The report without `provenance`.

    Raises:
        UnreadableError: it is not a table of points.
    """
    from accelcal_cli.collect.table import read_table  # no recording needs it

    digest, table = sha256(path), read_table(path)
    _refuse_samples(table, path, f"accelcal calibrate {shlex.quote(printable(path))} --rate HZ")
    return _report(table, settings, path, digest, path.stat().st_size)


def fit_frame(frame: pd.DataFrame, settings: Settings) -> dict[str, Any]:
    """Fit and judge a data frame as `fit_points` does a table; the report has the hash of its numbers.

    Raises:
        UnreadableError: it is not a table of points.
    """
    from accelcal_cli.collect.table import table_of

    rows = frame.dropna(axis=1, how="all")
    table = table_of(rows.set_index(np.arange(1, len(rows) + 1)), IN_MEMORY)
    _refuse_samples(table, IN_MEMORY, "accelcal.calibrate(xyz, rate=HZ)")
    columns = [getattr(table, name) for name in table.__dataclass_fields__]
    content = b"".join(part.tobytes() for part in columns if isinstance(part, np.ndarray))
    return _report(table, settings, IN_MEMORY, hashlib.sha256(content).hexdigest(), len(content))


def _refuse_samples(table: PointTable, path: Path, instead: str) -> None:
    from accelcal_cli.collect.table import holds_samples

    if holds_samples(table):
        what = f"its {len(table)} rows are raw samples, not means of still windows"
        hint = f"{instead} (if they are means, give them a column weight)"
        raise UnreadableError(what, path=path, hint=hint)


def _report(table: PointTable, settings: Settings, path: Path, digest: str, size: int) -> dict[str, Any]:
    from accelcal_cli.collect.table import points_of_table

    found = points_of_table(table, settings, path)
    fitter = fitting(settings)
    why_none = NOT_NEAR if found.implausible else NO_POINTS
    verdict = judge(found.points, fitter, why_none, found.label, found.saturated)
    verdict = replace(verdict, notes=(*verdict.notes, Reason("change_not_looked_for")))
    fit = verdict.fit
    data = PointsInput(
        path=path,
        sha256=digest,
        bytes=size,
        rows=len(table),
        implausible=found.implausible,
        raw_error_mg=_error_mg(found.rows, IDENTITY),
        after_error_mg=None if fit is None else _error_mg(found.rows.straightened(fit.bend), fit.parameters),
        settings=EffectiveSettings(settings, True, {"format": "points"}),
        judgement=verdict,
        optimizer=optimizer_json(settings),
    )
    return build_points(data)


def _error_mg(rows: PointSet, parameters: tuple[int, ...]) -> float | None:
    return mean(deviations_mg(rows, parameters).tolist()) if len(rows) else None
