"""What tests of this folder share: a folder of six recordings, what a study makes of it, and a cluster."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.studies import results, run_in, study_folder
from tests.studies.clusters import cluster

SIX = tuple(f"{site}/p{number}.raw" for site in ("a", "b") for number in range(3))


@pytest.fixture
def here(base: Path, tmp_path: Path) -> Path:
    """A copy of the study that a file of tests calls `base`."""
    return shutil.copytree(base, tmp_path / "study")


@pytest.fixture
def temporaries(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Where runs make temporary files; its path is short enough for the name of a socket."""
    with tempfile.TemporaryDirectory(prefix="study", dir="/tmp") as folder:
        monkeypatch.setenv("TMPDIR", folder)
        yield Path(folder)


@pytest.fixture(scope="package")
def six(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return study_folder(tmp_path_factory.mktemp("six") / "in", SIX)


@pytest.fixture(scope="package")
def undisturbed(six: Path) -> dict[str, object]:
    """The outputs of a study of the six."""
    assert run_in(six, "study", six, "-d", six.parent / "undisturbed", "-j", 2).code == 0
    return results(six.parent / "undisturbed")


@pytest.fixture(scope="package")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The scheduler file of a cluster whose two workers are there."""
    distributed = pytest.importorskip("distributed")
    with cluster(tmp_path_factory.mktemp("cluster")) as file:
        with distributed.Client(scheduler_file=str(file), set_as_default=False) as client:
            client.wait_for_workers(2)
        yield file
