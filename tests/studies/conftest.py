"""One cluster for all tests of this folder: its processes take long to start, and time to wait."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.studies.clusters import cluster


@pytest.fixture(scope="package")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The scheduler file of a cluster whose two workers are there."""
    distributed = pytest.importorskip("distributed")
    with cluster(tmp_path_factory.mktemp("cluster")) as file:
        with distributed.Client(scheduler_file=str(file), set_as_default=False) as client:
            client.wait_for_workers(2)
        yield file
