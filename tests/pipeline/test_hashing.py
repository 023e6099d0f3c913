"""The SHA-256 of a long recording, which a thread finds out while the recording is judged."""

from __future__ import annotations

import hashlib
import json
import threading
from pathlib import Path

import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.pipeline import calibrate, jobs
from accelcal_cli.pipeline.jobs import Job, Request
from tests.recordings import good_raw


def job_of(recording: Path) -> Job:
    (job,) = jobs.plan([recording], None, None)
    return job


@pytest.mark.parametrize(("least", "by"), [(0, "background"), (1 << 40, "MainThread")])
def test_a_long_recording_is_hashed_by_a_thread_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, least: int, by: str
) -> None:
    recording, names, hashing = good_raw(tmp_path), [], jobs.sha256

    def sha256(path: Path) -> str:
        if path == recording:
            names.append(threading.current_thread().name)
        return hashing(path)

    monkeypatch.setattr(calibrate, "HASHED_IN_BACKGROUND", least)
    monkeypatch.setattr(jobs, "sha256", sha256)
    calibrate.calibrate(job_of(recording), Request())
    report = json.loads((tmp_path / "good.calibration.json").read_text())
    assert report["recording"]["sha256"] == hashlib.sha256(recording.read_bytes()).hexdigest()
    assert [name.split("_")[0] for name in names] == [by]


def test_without_a_hash_there_is_no_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording, hashing = good_raw(tmp_path), jobs.sha256
    monkeypatch.setattr(calibrate, "HASHED_IN_BACKGROUND", 0)
    monkeypatch.setattr(jobs, "sha256", lambda path: hashing(path.with_name("gone")))
    with pytest.raises(UnreadableError, match="gone: file not found"):
        calibrate.calibrate(job_of(recording), Request())
    assert not (tmp_path / "good.calibration.json").exists()
