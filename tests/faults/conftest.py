"""One process for all tests forks commands, in which calls of the system fail, or are written down."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.faults.shim import Runner, compiled, running


@pytest.fixture(scope="session")
def forks(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runner]:
    """Its calls do not fail where there is no compiler."""
    folder = tmp_path_factory.mktemp("shim")
    made = Runner(compiled(folder), folder / "runner")
    yield made
    made.close()


@pytest.fixture
def runner(forks: Runner) -> Runner:
    if forks.shim is None:
        pytest.skip("needs Linux and a C compiler (cc)")
    return forks


@pytest.fixture(scope="session")
def quick_runner(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runner]:
    """One whose commands fork their workers themselves."""
    with running(tmp_path_factory.mktemp("shim"), forked=True) as made:
        if made is None:
            pytest.skip("needs Linux and a C compiler (cc)")
        yield made
