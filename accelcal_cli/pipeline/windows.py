"""`--windows`: all still windows of a recording, kept along its first pass, and what became of each."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.core.points import PointSet
from accelcal_cli.core.settings import Settings
from accelcal_cli.judge.model_ladder import folds, postures
from accelcal_cli.output import report as reports
from accelcal_cli.output.report import ReportInput
from accelcal_cli.pipeline.jobs import PARQUET, Job, refuse_dash, refuse_overwriting
from accelcal_cli.pipeline.survey import Method, Procedure, StillWindows

if TYPE_CHECKING:
    from accelcal_cli.output.windows import WindowTable

CSV = ".csv"


def refuse_impossible(path: Path, jobs: list[Job]) -> None:
    """Raise UsageError for a table of windows that cannot be written beside the jobs' outputs."""
    refuse_dash(path)
    if path.suffix.lower() not in (PARQUET, CSV):
        raise UsageError(f"--windows {printable(path)} is neither .parquet nor .csv", hint="name it so")
    if len(jobs) > 1:
        raise UsageError("--windows names one file, but there are several recordings", hint="give one")
    for job in jobs:
        refuse_overwriting((path,), (job.source, *job.outputs))


class WindowLog(StillWindows):
    """Keeps a recording's still windows with their times."""

    procedure: Procedure

    def watch(self, method: Method, rate_hz: float) -> Method:
        """The method whose windows are kept."""
        self.procedure = method.procedure
        return method.timed(rate_hz)

    def write(self, path: Path, data: ReportInput, points: PointSet) -> None:
        """Write the table.

        Args:
            points: those that were made of the windows.

        Raises:
            OutputError: the file cannot be written.
        """
        # few runs write it
        from accelcal_cli.output.windows import write_windows

        write_windows(self.table(data, points), path, reports.parquet_metadata(data))

    def table(self, data: ReportInput, points: PointSet) -> WindowTable:
        """What became of each window."""
        from accelcal_cli.output.windows import WindowTable

        windows, settings = self.result(), data.settings.method
        assert isinstance(settings, Settings)
        fates = self.procedure.fates(windows)
        label = postures(points, settings.posture_degrees)
        known = fates.point >= 0
        posture, fold = (np.full(len(windows), -1) for _ in range(2))
        posture[known] = label[fates.point[known]]
        if data.judgement.holdout is not None:
            fold[known] = folds(posture[known], settings.folds)
        return WindowTable(
            windows,
            data.recording.lsb_per_g,
            fates,
            posture,
            fold,
            data.judgement.calibration,
            data.facts.utc_offset_s,
        )
