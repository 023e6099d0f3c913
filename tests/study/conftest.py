"""One cluster for all tests that need one: to start its processes takes longer than most of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.study.clusters import cluster


@pytest.fixture(scope="session")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The scheduler file of a cluster of two workers."""
    with cluster(tmp_path_factory.mktemp("cluster")) as file:
        yield file
