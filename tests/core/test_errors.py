"""The one line that people see, and the exit code behind it."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from accelcal_cli.core import errors


@pytest.mark.parametrize(
    ("place", "text"),
    [
        ({}, "it broke"),
        ({"path": "a.bin"}, "a.bin: it broke"),
        ({"path": Path("a.bin"), "byte_offset": 0}, "a.bin, byte 0: it broke"),
        ({"path": "a.csv", "line": 3}, "a.csv, line 3: it broke"),
        (
            {"path": "a.csv", "line": 3, "byte_offset": 9, "hint": "mend it"},
            "a.csv, line 3, byte 9: it broke; mend it",
        ),
        ({"hint": "mend it"}, "it broke; mend it"),
    ],
)
def test_an_error_names_its_place_and_remedy(place: dict[str, object], text: str) -> None:
    assert str(errors.AccelcalError("it broke", **place)) == text


@pytest.mark.parametrize(
    ("cause", "again"),
    [
        (OSError(errno.EIO, "the disk"), True), (OSError(errno.EMFILE, "files"), True),
        (PermissionError(errno.EACCES, "rights"), True), (OSError("Not a gzipped file"), False),
        (OSError(errno.EINVAL, "a seek that a file asks for"), False), (ValueError("a number"), False),
    ],
)  # fmt: skip
def test_what_came_of_the_machine_is_told_from_what_is_in_a_file(cause: Exception, again: bool) -> None:
    try:
        try:
            raise cause
        except Exception as error:
            raise errors.UnreadableError("cannot be read") from error
    except errors.UnreadableError as error:
        assert errors.is_environment_error(error) is again


def test_an_error_is_one_line() -> None:
    assert "\n" not in str(errors.AccelcalError("it\nbroke", hint="mend\n it"))


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("AccelcalError", 70), ("UsageError", 2), ("UnreadableError", 3), ("OutputError", 5),
        ("DivergedError", 4), ("FixedPointOverflowError", 4),
    ],
)  # fmt: skip
def test_every_kind_has_its_exit_code(name: str, code: int) -> None:
    assert getattr(errors, name).exit_code == code
    assert issubclass(getattr(errors, name), errors.AccelcalError)


@pytest.mark.parametrize(
    ("text", "cell"),
    [
        ("=1+1", "'=1+1"), ("@SUM(A1)", "'@SUM(A1)"), ("-2+3+cmd|' /C calc'!A0", "'-2+3+cmd|' /C calc'!A0"),
        ("+x", "'+x"), ("\t=1", "'\t=1"), ("-rest.csv", "'-rest.csv"), ("a=1", "a=1"), ("-", "-"),
        ("007", "'007"), ("0", "0"), ("12E5", "'12E5"), ("1234567890123456", "'1234567890123456"),
        ("0.5", "0.5"),
        ("-0.5", "-0.5"), ("-1.5e-05", "-1.5e-05"), ("", ""), (-3.0, -3.0), (None, None),
    ],
)  # fmt: skip
def test_cells_that_a_spreadsheet_would_calculate(text: object, cell: object) -> None:
    assert errors.spreadsheet_cell(text) == cell


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("\ud800", "\ufffd"), ("a\udcffb", "a\ufffdb"), ("\udcc3\udca9", "\u00e9"), ("\x1b[0m", r"\x1b[0m"),
        ("\0", r"\x00"),
    ],
)  # fmt: skip
def test_any_name_can_be_printed(name: str, shown: str) -> None:
    assert errors.printable(name) == shown
