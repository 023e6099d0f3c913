"""A process in which calls of the system fail, or are written down."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.faults.shim import Runner, running


@pytest.fixture(scope="module")
def runner(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runner]:
    with running(tmp_path_factory.mktemp("shim")) as made:
        if made is None:
            pytest.skip("needs Linux and a C compiler (cc)")
        yield made
