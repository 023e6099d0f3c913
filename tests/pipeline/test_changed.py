"""A recording that changes while it is read: no result tells of a file that never was."""

from __future__ import annotations

from pathlib import Path

import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.jobs import Progress, ProgressMaker, Request, plan
from tests.recordings import good_csv

ROW = "2024-03-05T00:00:00,0.0,0.0,1.0\n"


def while_it_is(stage: str, path: Path) -> ProgressMaker:
    """Adds a row when a stage begins."""

    def begun(name: str, _total: int) -> Progress:
        if name == stage:
            with path.open("a") as file:
                file.write(ROW)
        return lambda _done: None

    return begun


@pytest.mark.parametrize("stage", ["reading", "writing"])
def test_a_recording_that_grows_is_refused_and_nothing_is_written(tmp_path: Path, stage: str) -> None:
    path = good_csv(tmp_path)
    (job,) = plan([path], tmp_path / "out", None)
    with pytest.raises(UnreadableError, match=r"good\.csv: changed while it was read; try again"):
        calibrate(job, Request(), while_it_is(stage, path))
    assert not list((tmp_path / "out").iterdir())
    assert calibrate(job, Request()).report["recording"]["bytes"] == path.stat().st_size


def test_a_recording_that_is_taken_away_is_refused(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    (job,) = plan([path], tmp_path / "out", None)

    def taken(_name: str, _total: int) -> Progress:
        path.unlink(missing_ok=True)
        return lambda _done: None

    with pytest.raises(UnreadableError):
        calibrate(job, Request(), taken)
    assert not list((tmp_path / "out").iterdir())
