"""Text files that people write for us: bounded, and with plain line ends."""

from __future__ import annotations

from pathlib import Path

import pytest

from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.input_files import read_text


def test_line_ends_of_every_system_become_one(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(b"\xef\xbb\xbfa\r\nb\rc\n\xc3\xa9")
    assert read_text(path, "it", 100, "utf-8-sig") == "a\nb\nc\né"


def test_the_longest_file_is_read_and_one_byte_more_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(b"x" * 1000)
    assert read_text(path, "it", 1000) == "x" * 1000
    with pytest.raises(UsageError, match="it is too large, more than 999 bytes"):
        read_text(path, "it", 999)


def test_a_device_that_never_ends_is_refused() -> None:
    with pytest.raises(UsageError, match="/dev/zero: it is too large"):
        read_text(Path("/dev/zero"), "it", 1 << 20)


def test_what_is_no_text_is_named_with_its_byte(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(b"ab\xff")
    with pytest.raises(UsageError, match="byte 2: it is not UTF-8 text"):
        read_text(path, "it", 100)
    with pytest.raises(UsageError, match="it cannot be read"):
        read_text(tmp_path, "it", 100)
