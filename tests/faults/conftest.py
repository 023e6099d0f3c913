"""A process in which calls of the system fail, or are written down."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.faults.shim import Runner, running


@pytest.fixture(scope="module")
def runner(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runner]:
    yield from _running(tmp_path_factory, forked=False)


@pytest.fixture(scope="module")
def quick_runner(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runner]:
    """One whose commands fork their workers themselves."""
    yield from _running(tmp_path_factory, forked=True)


def _running(folders: pytest.TempPathFactory, *, forked: bool) -> Iterator[Runner]:
    with running(folders.mktemp("shim"), forked=forked) as made:
        if made is None:
            pytest.skip("needs Linux and a C compiler (cc)")
        yield made
