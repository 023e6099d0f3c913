"""The time to understand a cell or a column's name grows as its length."""

from __future__ import annotations

import subprocess
import sys
import warnings

import numpy as np
import pytest

from accelcal_cli.formats._gravity import usual_length
from accelcal_cli.formats.csv.cells import AccelScale, name_and_hint

CPU_SECONDS = 20
"""Many times the CPU time of a long cell; time that grows as the square of its length would be hours."""


def in_bounded_time(code: str) -> str:
    """Return what code prints; the kernel ends it after CPU_SECONDS of work, however busy the machine is."""
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_CPU, ({CPU_SECONDS}, {CPU_SECONDS}))\n"
    ran = subprocess.run([sys.executable, "-c", limit + code], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, (ran.returncode, ran.stderr)
    return ran.stdout.strip()


@pytest.mark.parametrize(
    "text",
    [
        "'1' * 10**6 + 'x'",
        pytest.param("'1' * 10**6 + '.1' + '1' * 10**6 + 'x'", marks=pytest.mark.nightly),
        pytest.param("'9' * 10**6 + 'e'", marks=pytest.mark.nightly),
    ],
)
def test_a_long_cell_that_is_no_number_is_seen_at_once(text: str) -> None:
    code = "from accelcal_cli.formats.csv.cells import cell_kind\n"
    assert in_bounded_time(f"{code}print(cell_kind({text}, True).value)") == "text"


def test_a_long_name_with_an_open_bracket_is_seen_at_once() -> None:
    code = "from accelcal_cli.formats.csv.cells import name_and_hint\n"
    assert in_bounded_time(f"{code}print(name_and_hint('z (' + ' ' * 10**6 + '!')[1])") == "None"


@pytest.mark.parametrize(
    ("name", "plain", "hint"),
    [
        ("x [g]", "x", "g"),
        (" x ( m/s2 ) ", "x", "m/s2"),
        ("x", "x", None),
        ("x (g) y", "x (g) y", None),
        ("a (b) c (d)", "a", "b) c (d"),
        ("x [g)", "x", "g"),
        ("()", "", ""),
        ("(", "(", None),
        (")", ")", None),
        ("", "", None),
    ],
)
def test_a_name_is_parted_from_the_unit_in_its_brackets(name: str, plain: str, hint: str | None) -> None:
    assert name_and_hint(name) == (plain, hint)


@pytest.mark.parametrize(
    ("pattern", "text"),
    [
        ("geneactiv.FIRST", "'Device Type' + chr(9) * 10**5 + 'x'"),
        pytest.param("actigraph.FIRST", "'Data' + ' ' * 10**5 + 'x'", marks=pytest.mark.nightly),
        ("actigraph.DATES", "'date format ' + ' ' * 10**5 + 'x'"),
    ],
)
def test_a_long_head_of_a_vendors_export_is_seen_at_once(pattern: str, text: str) -> None:
    code = "from accelcal_cli.formats.csv.vendors import actigraph, geneactiv\n"
    assert in_bounded_time(f"{code}print({pattern}.match({text}), end='')") == "None"


def test_values_beyond_all_numbers_raise_no_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not np.isfinite(AccelScale("g", 2.0**24).counts(np.array([1e308])))[0]
        assert usual_length(np.array([[1e308, 0.0, 0.0], [0.0, 0.6, 0.8]])) == 1.0
