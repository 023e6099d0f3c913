"""The time to understand a cell or a column's name grows as its length."""

from __future__ import annotations

import subprocess
import sys
import warnings

import numpy as np
import pytest

from accelcal_cli.formats._gravity import usual_length
from accelcal_cli.formats.tables.names import name_and_hint
from accelcal_cli.formats.tables.units import Fault, Scale

CPU_SECONDS = 20
"""Many times the CPU time of all long texts; time that grows as the square of their length would be hours."""

LONG = {
    "cell_kind('1' * 10**6 + 'x').value": "text",
    "cell_kind('1' * 10**6 + '.1' + '1' * 10**6 + 'x').value": "text",
    "cell_kind('9' * 10**6 + 'e').value": "text",
    "name_and_hint('z (' + ' ' * 10**6 + '!')[1]": "None",
    "geneactiv.FIRST.match('Device Type' + chr(9) * 10**5 + 'x')": "None",
    "actigraph.FIRST.match('Data' + ' ' * 10**5 + 'x')": "None",
    "actigraph.DATES.match('date format ' + ' ' * 10**5 + 'x')": "None",
}
"""Texts that are no number, name or head of an export, and the answers to them."""


def test_long_texts_are_understood_at_once() -> None:
    """The kernel ends the process after CPU_SECONDS of work, however busy the machine is."""
    code = f"""
import resource
resource.setrlimit(resource.RLIMIT_CPU, ({CPU_SECONDS}, {CPU_SECONDS}))
from accelcal_cli.formats.tables.cells import cell_kind
from accelcal_cli.formats.tables.names import name_and_hint
from accelcal_cli.formats.tables.vendors import actigraph, geneactiv
for text in {[*LONG]!r}:
    print(eval(text))
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stdout.split()) == (0, [*LONG.values()]), ran.stderr


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


def test_values_beyond_all_numbers_raise_no_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        counts, fault = Scale("g", 2.0**24, 1.0).counts(np.array([[0.0, 1e308, -1e308], [0.0, 0.5, 0.0]]))
        assert (counts.tolist(), fault.tolist()) == ([[0, 0, 0], [0, 1 << 23, 0]], [Fault.OUT_OF_RANGE, 0])
        assert usual_length(np.array([[1e308, 0.0, 0.0], [0.0, 0.6, 0.8]])) == 1.0
