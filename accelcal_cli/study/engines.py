"""Which engine does the tasks of a study, and what is left to tidy up after it."""

from __future__ import annotations

import contextlib
import functools
from pathlib import Path

from accelcal_cli import __version__
from accelcal_cli.core import limits
from accelcal_cli.output.atomic import sweep, sweep_of
from accelcal_cli.study.abroad import calibrated_from
from accelcal_cli.study.cluster import Cluster
from accelcal_cli.study.connect import Said
from accelcal_cli.study.engine import Engine, Moved, Work
from accelcal_cli.study.plan import Study
from accelcal_cli.study.remote import Terms, code
from accelcal_cli.study.work import Doing, calibrated
from accelcal_cli.study.workers import Crew

PRELOAD = "accelcal_cli.study.preload"
MANY = 1 << 20


def engine_of(study: Study, work: Work, recordings: int, moved: Moved, said: Said) -> Engine:
    """Processes of this machine for so many recordings, or the cluster that was named.

    A cluster finds the own results; what a device's recordings have in common is found here.
    """
    if study.dask is None or work is not calibrated:
        return Crew(work, workers_of(study, recordings), study.timeout_s, PRELOAD, moved)
    cwd = Path.cwd()
    abroad, terms = functools.partial(calibrated_from, cwd), _terms(study, cwd)
    return Cluster(study.dask, abroad, terms, study.jobs, study.timeout_s, moved, said, tidy)


def workers_of(study: Study, recordings: int) -> int:
    """Processes of this machine that work at a time on so many recordings."""
    wanted = study.jobs if study.dask is None else None
    return min(wanted or limits.workers(recordings), max(1, recordings))


def threads_of(study: Study, recordings: int = MANY) -> int:
    """Threads for one recording, so that all that work at a time fit the CPUs; a cluster counts its own."""
    return 1 if study.dask is not None else limits.threads(workers_of(study, recordings))


def _terms(study: Study, cwd: Path) -> Terms:
    """The lock is the mark: it is there while the study runs, and no other run's is like it."""
    mark = cwd / study.lock
    folders = tuple(cwd / folder for folder in study.where.folders)
    return Terms(__version__, code(), folders, mark, mark.read_text("utf-8"))


def tidy(task: Doing, lost: str | None = None) -> None:
    """Remove what killed processes of this machine left, and one of another that is known to be gone."""
    for path in (task.item.job.parquet, task.item.job.report, task.item.job.integers):
        with contextlib.suppress(OSError):
            sweep(path)
            if lost is not None:
                sweep_of(path, lost)
