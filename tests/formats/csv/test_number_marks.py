"""Numbers as locales and programs write them: groups of digits, commas in quotes, a typographic minus."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError, printable
from tests.formats.make_csv import GRID, read, stamp, written

MG = np.column_stack([np.arange(60) * 50 - 1500, np.arange(60) * 7 + 800, np.full(60, -12)])
"""Whole numbers of mg on either side of 1000."""

G = np.column_stack([np.arange(60) / 64 - 0.5, np.full(60, 0.125), np.full(60, -1.0)])

Cell = Callable[[float], str]


def table(names: str, values: np.ndarray, cell: Cell, delimiter: str = ",") -> str:
    lines = [names.replace(",", delimiter)]
    for number, row in enumerate(values.tolist()):
        lines.append(delimiter.join([stamp(number * 40_000), *map(cell, row)]))
    return "\n".join(lines) + "\n"


def grouped(mark: str, quote: str = "") -> Cell:
    return lambda value: quote + f"{value:,.0f}".replace(",", mark) + quote


@pytest.mark.parametrize("mark", [" ", "\u00a0", "\u202f", "\u2009", "'", "\u2019"])
@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_groups_of_digits(tmp_path: Path, mark: str, delimiter: str) -> None:
    text = table("time,x [mg],y [mg],z [mg]", MG, grouped(mark), delimiter)
    for chunk, encoding in ((1000, "utf-8"), (7, "latin-1" if mark == "\u00a0" else "utf-8")):
        found = read(written(tmp_path, text.encode(encoding)), chunk_samples=chunk)
        assert np.array_equal(found.counts, MG) and found.problems == []


@pytest.mark.parametrize("other", ["1 001", "1\u00a0001", "1'001", "1_001", "0 001", "1\u2212001", "1/001"])
@pytest.mark.parametrize("delimiter", [",", ";"])
def test_texts_are_no_numbers(tmp_path: Path, other: str, delimiter: str) -> None:
    """Two people stay two, whatever their numbers look like without marks."""
    plain = re.sub(r"[^01-]", "", other.replace("\u2212", "-"))
    lines = table("time,x [g],y [g],z [g],participant", G, repr, delimiter).splitlines()
    rows = [f"{line}{delimiter}{who}".replace("-03-", "/03/") for line in lines[1:] for who in (other, plain)]
    with pytest.raises(UnreadableError, match=re.escape(f"has {printable(other)}, {plain} and")):
        read(written(tmp_path, "\n".join([lines[0], *rows]) + "\n"))


@pytest.mark.parametrize("number", ["1_033", "0 033", "01,033", "1,03", "1,125", "1.033.500"])
def test_what_is_no_number_far_below(tmp_path: Path, number: str) -> None:
    """Where decimals have points, a comma may stand before decimals of another file: 1,125 is never 1125."""
    rows = np.tile(G, (50, 1))
    text = table("time,x [g],y [g],z [g]", rows, repr, ";") + f"{stamp(3000 * 40_000)};{number};0.5;0.5\n"
    found = read(written(tmp_path, text), 100_000)
    assert len(found.g) == 3000 and [one.code for one in found.problems] == ["bad_line"]


def test_groups_that_first_stand_far_below(tmp_path: Path) -> None:
    """Behind what shows the layout of the file."""
    values = np.concatenate([np.tile(MG[20:21], (60_000, 1)), MG])
    found = read(written(tmp_path, table("time,x [mg],y [mg],z [mg]", values, grouped(" "))), 100_000)
    assert np.array_equal(found.counts, values) and found.problems == []


def test_whole_numbers_with_commas_in_quotes(tmp_path: Path) -> None:
    text = table("time,x [mg],y [mg],z [mg]", MG, lambda value: re.sub("(.*,.*)", r'"\1"', f"{value:,.0f}"))
    assert np.array_equal(read(written(tmp_path, text)).counts, MG)


@pytest.mark.parametrize(("delimiter", "quote"), [(",", '"'), (";", ""), (";", '"'), ("\t", "")])
@pytest.mark.parametrize("marks", [",.", ".,"])
def test_points_and_commas(tmp_path: Path, delimiter: str, quote: str, marks: str) -> None:
    def cell(value: float) -> str:
        return quote + f"{value:,.1f}".translate(str.maketrans(",.", marks)) + quote

    text = table("time,x [mg],y [mg],z [mg]", MG + 0.5, cell, delimiter)
    assert np.array_equal(read(written(tmp_path, text)).counts, np.rint((MG + 0.5) / 1000 * GRID))


@pytest.mark.parametrize("bare", [True, False])
def test_decimal_commas_in_quotes(tmp_path: Path, bare: bool) -> None:
    def cell(value: float) -> str:
        text = repr(value).replace(".", ",")
        return text[:-2] if bare and text.endswith(",0") else f'"{text}"'

    found = read(written(tmp_path, table("time,x [g],y [g],z [g]", G, cell)))
    assert np.array_equal(found.g, G) and found.problems == []


def test_three_decimals_behind_commas_in_quotes(tmp_path: Path) -> None:
    values = np.array([[-0.125, 0.375, 1.125], [2.125, -0.625, 0.25], [0.125, 1.625, 0.875]] * 20)
    text = table("time,x [g],y [g],z [g]", values, lambda value: f'"{value:.3f}"'.replace(".", ","))
    assert np.array_equal(read(written(tmp_path, text)).g, values)


@pytest.mark.parametrize("delimiter", [",", ";", " ", "\t"])
def test_a_typographic_minus(tmp_path: Path, delimiter: str) -> None:
    lines = table("time,x [g],y [g],z [g]", G, lambda value: repr(value).replace("-", "\u2212"), "|")
    path = written(tmp_path, lines.replace(" [g]", "").replace(" ", "T").replace("|", delimiter))
    assert np.array_equal(read(path, unit="g").g, G)


@pytest.mark.parametrize("first", [0, 60_000])
@pytest.mark.parametrize(("mark", "delimiter"), [(".", ","), (".", ";"), (",", ";")])
def test_points_between_groups_alone_are_asked_about(
    tmp_path: Path, mark: str, delimiter: str, first: int
) -> None:
    """1.033 among whole numbers of mg; its first may stand far below. 1.500 may be a fraction."""
    values = np.concatenate([np.tile(MG[20:21], (first, 1)), MG])
    path = written(tmp_path, table("time,x [mg],y [mg],z [mg]", values, grouped(mark), delimiter))
    with pytest.raises(
        UnreadableError, match=r"holds 1[.,]003 among whole numbers: a fraction, or 1003 with"
    ) as refusal:
        read(path, 100_000)
    assert refusal.value.line == first + 31
    assert "write 1003 without the mark" in (refusal.value.hint or "")


@pytest.mark.parametrize("unit", ["mg", "m/s2"])
def test_fractions_are_not_asked_about(tmp_path: Path, unit: str) -> None:
    """Some numbers that are whole, and fractions of any length, are what they are."""
    values = np.array([[980.5, 12.0, -8.25], [990.0, 3.125, 100.0], [1001.0, -999.0, 0.5]] * 20)
    values = values if unit == "mg" else values / 100
    text = table(f"time,x [{unit}],y [{unit}],z [{unit}]", values, lambda value: f"{value:g}")
    assert len(read(written(tmp_path, text)).g) == 60
