"""Where the optional real recordings are, and what is shared by all tests."""

from __future__ import annotations

import gc
import os
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from accelcal_cli.core.system import hold_to_one_thread

settings.register_profile("steady", derandomize=True, deadline=None, max_examples=12)
settings.register_profile("searching", deadline=None, max_examples=200)
settings.load_profile(os.environ.get("ACCELCAL_HYPOTHESIS", "steady"))

hold_to_one_thread()

ROOT = Path(__file__).resolve().parent.parent


LONGEST = {
    "test_generator.py": 0,
    "test_killed.py": 1,
    "test_interrupted.py": 1,
    "test_cluster.py": 2,
    "test_real_recordings.py": 3,
}
"""What begins first, so that no worker is left with it at the end, nor with a cluster for long."""


def pytest_configure() -> None:
    """Let processes of tests end by SIGINT, which a shell ignores for what it starts in the background."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[object]:
    """Look for no garbage among all modules and tests, then or later: they stay."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: LONGEST.get(item.path.name, len(LONGEST)))


def shared_folder() -> Path | None:
    """The folder of real recordings and tools, or None where it is absent."""
    named = os.environ.get("ACCELCAL_REAL_DATA")
    data = Path(named) if named else ROOT.parent / "shared" / "data"
    return data if data.is_dir() else None


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of real recordings; the test is skipped where it is absent."""
    folder = shared_folder()
    if folder is None:
        pytest.skip("real recordings are absent (set ACCELCAL_REAL_DATA)")
    return folder


@pytest.fixture(scope="session", autouse=True)
def _no_disk() -> Iterator[None]:
    """What this process writes need not reach the disk: the processes that are killed are others."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _file: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def _temporaries(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Temporary files of the package, such as traces of the bugs that tests make, lie among the tests'."""
    with pytest.MonkeyPatch.context() as patch:
        folder = str(tmp_path_factory.mktemp("temporary"))
        patch.setenv("TMPDIR", folder)
        patch.setattr(tempfile, "tempdir", folder)
        yield
