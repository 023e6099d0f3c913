"""Which executor is taken, and what is tidied up after a process of another machine."""

from __future__ import annotations

import os
import platform
from dataclasses import replace
from pathlib import Path

import pytest

from accelcal_cli.pipeline.jobs import Request
from accelcal_cli.studies.cluster import Cluster
from accelcal_cli.studies.discovery import Where, files
from accelcal_cli.studies.process_pool import ProcessPool
from accelcal_cli.studies.run import executor_for, tidy
from accelcal_cli.studies.study import Shard, Study
from accelcal_cli.studies.task import CalibrationTask, Common, calibrated
from tests.cli.studies import study_folder


def executor(study: Study) -> ProcessPool | Cluster:
    found = executor_for(study, calibrated, 3, lambda _task, _part: None, lambda _text: None)
    assert isinstance(found, ProcessPool | Cluster)
    return found


def test_a_cluster_is_given_absolute_names_and_the_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("out").mkdir()
    Path("out/study.2-of-3.lock").write_text("held")
    study = Study(Where((Path("in"), Path("/other")), Path("out")), Request(), jobs=2, shard=Shard(2, 3))
    assert isinstance(executor(study), ProcessPool)
    found = executor(replace(study, dask="tcp://host:8786"))
    assert isinstance(found, Cluster)
    assert (found.limit, found.address) == (2, "tcp://host:8786")
    assert found.requirements.folders == (tmp_path / "in", Path("/other"))
    assert (found.requirements.mark, found.requirements.content) == (
        tmp_path / "out/study.2-of-3.lock",
        "held",
    )


def test_what_a_lost_process_left_is_removed_and_no_more(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in", ("a.raw",)), tmp_path / "out"
    out.mkdir()
    item = next(item for item in files(Where((folder,), out), []) if item.name == "a.raw")
    host = platform.node() or "host"
    lost = [f".a.calibrat{end}.there.12.ff.tmp" for end in ("ed.parquet", "ion.json")]
    kept = [
        ".a.calibrated.parquet.there.123.ff.tmp",
        ".b.calibrated.parquet.there.12.ff.tmp",
        f".a.calibrated.parquet.{host}.{os.getpid()}.ff.tmp",
    ]
    for name in (*lost, *kept):
        (out / name).touch()
    tidy(CalibrationTask(item, Common(out, Request(), "")))
    assert {path.name for path in out.iterdir()} == {*lost, *kept}
    tidy(CalibrationTask(item, Common(out, Request(), "")), "there.12")
    assert {path.name for path in out.iterdir()} == set(kept)
