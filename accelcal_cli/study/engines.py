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
from accelcal_cli.study.engine import Engine, Moved
from accelcal_cli.study.plan import Study
from accelcal_cli.study.remote import Terms, code
from accelcal_cli.study.work import Task, calibrated
from accelcal_cli.study.workers import Crew

PRELOAD = "accelcal_cli.study.preload"


def engine_of(study: Study, recordings: int, moved: Moved, said: Said) -> Engine:
    """Processes of this machine for so many recordings, or the cluster that was named."""
    if study.dask is None:
        number = workers_of(study, recordings)
        return Crew(calibrated, number, study.timeout_s, PRELOAD, moved)
    cwd = Path.cwd()
    work, terms = functools.partial(calibrated_from, cwd), _terms(study, cwd)
    return Cluster(study.dask, work, terms, study.jobs, study.timeout_s, moved, said, tidy)


def workers_of(study: Study, recordings: int) -> int:
    """Processes of this machine that work at a time on so many recordings."""
    return min(study.jobs or limits.workers(recordings), max(1, recordings))


def threads_of(study: Study, recordings: int) -> int:
    """Threads for one recording, so that all that work at a time fit the CPUs; a cluster counts its own."""
    return 1 if study.dask is not None else limits.threads(workers_of(study, recordings))


def _terms(study: Study, cwd: Path) -> Terms:
    """The lock is the mark: it is there while the study runs, and no other run's is like it."""
    mark = cwd / study.lock
    folders = tuple(cwd / folder for folder in study.where.folders)
    return Terms(__version__, code(), folders, mark, mark.read_text("utf-8"))


def tidy(task: Task, lost: str | None = None) -> None:
    """Remove what killed processes of this machine left, and one of another that is known to be gone."""
    for path in (task.item.job.parquet, task.item.job.report, task.item.job.integers):
        with contextlib.suppress(OSError):
            sweep(path)
            if lost is not None:
                sweep_of(path, lost)
