"""Files of rows: what fails leaves the rows before it, and no part of a row."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from accelcal_cli.core.errors import OutputError
from accelcal_cli.watching.row_stream import RowFile
from tests.cli.run import little_room


def test_a_piece_that_has_no_room_is_not_there_and_a_later_one_is(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    with RowFile(path) as file:
        file.put(b"one\n")
        with little_room(6), pytest.raises(OutputError) as caught:
            file.put(b"another\n")
        assert path.read_bytes() == b"one\n"
        file.put(b"two\n")
    assert path.read_bytes() == b"one\ntwo\n"
    assert str(caught.value).startswith(f"{path}: cannot be written (")


def test_a_file_without_a_row_does_not_stay(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    with RowFile(path) as file, little_room(6), pytest.raises(OutputError):
        file.put(b"another\n")
    assert not path.exists()


def test_a_pipe_is_written_and_never_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        with RowFile(path) as file:
            file.put(b"one\n")
            assert os.read(reader, 9) == b"one\n"
            os.close(reader)
            reader = -1
            with pytest.raises(BrokenPipeError):
                file.put(b"two\n")
    finally:
        if reader >= 0:
            os.close(reader)
    assert path.exists()


def test_a_place_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"rows\.csv: cannot be written"):
        RowFile(tmp_path / "absent" / "rows.csv")
