"""Temporary folders go with all that is in them, and what cannot be removed costs nothing."""

from __future__ import annotations

import os

import pytest

from accelcal_cli.core.system import temporary_folder


def test_all_of_it_goes() -> None:
    with temporary_folder() as folder:
        (folder / "a").mkdir()
        (folder / "a" / "b").write_bytes(b"x")
    assert not folder.exists()


def test_a_folder_that_cannot_be_closed_is_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python's own removal closes it again then, and fails with EBADF."""
    close = os.close

    def failing(file: int) -> None:
        close(file)
        raise OSError(5, "Input/output error")

    with temporary_folder() as folder:
        (folder / "b").write_bytes(b"x")
        monkeypatch.setattr(os, "close", failing)
    monkeypatch.undo()
    assert not (folder / "b").exists()


def test_it_goes_after_a_failure_too() -> None:
    with pytest.raises(ZeroDivisionError), temporary_folder() as folder:
        raise ZeroDivisionError
    assert not folder.exists()
