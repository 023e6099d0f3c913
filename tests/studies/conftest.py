"""One cluster for all tests that need one: to start its processes takes longer than most of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.studies.clusters import cluster


@pytest.fixture(scope="session")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The scheduler file of a cluster whose two workers are there."""
    distributed = pytest.importorskip("distributed")
    with cluster(tmp_path_factory.mktemp("cluster")) as file:
        with distributed.Client(scheduler_file=str(file), set_as_default=False) as client:
            client.wait_for_workers(2)
        yield file
