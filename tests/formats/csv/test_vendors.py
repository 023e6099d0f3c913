"""The contract of vendors' files, on the SAMPLE that each one's own test file binds."""

from __future__ import annotations

import ast
import csv
import importlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from accelcal_cli.core.errors import AccelcalError
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.core.recording import Problem
from accelcal_cli.formats import find_format
from accelcal_cli.formats.tables import CSV as FORMAT
from accelcal_cli.formats.tables import vendors
from accelcal_cli.formats.tables.text.dialect import Dialect, find_dialect
from accelcal_cli.formats.tables.vendors import (
    Head,
    Lines,
    Stated,
    Vendor,
    all_vendors,
    export_description,
    names_description,
)
from tests.formats.cuts import cuts, every_byte
from tests.formats.make_csv import read, written

HERE = Path(__file__).parent
FOLDER = Path(vendors.__file__).parent
LONG_HEADS = ("geneactiv", "axivity")
"""Vendors with long samples; cutting these everywhere takes a second and is left to the nightly run."""

each_vendor = pytest.mark.parametrize("vendor", all_vendors(), ids=lambda item: item.name)
each_by_names = pytest.mark.parametrize(
    "vendor", [item for item in all_vendors() if item.by_names], ids=lambda item: item.name
)


def sample(vendor: Vendor) -> bytes:
    """Return a small whole file of this vendor."""
    return importlib.import_module(f"tests.formats.csv.test_{vendor.name}").SAMPLE


def layout(data: bytes) -> tuple[Dialect, Lines]:
    """Return the layout of a file, and the lines above its names or its first row."""
    stated = export_description(data)
    dialect = find_dialect(data, 0 if stated is None else stated.preamble)
    assert dialect is not None
    above = data[: dialect.offset].decode().splitlines()
    return dialect, tuple(above if dialect.names is None else above[:-1])


def head_for(vendor: Vendor, data: bytes) -> Head | Lines:
    """Return the beginning of a file as a vendor is asked about it."""
    if not vendor.by_names:
        return tuple(data.decode().splitlines())
    dialect, above = layout(data)
    return Head(dialect.names or ("",) * dialect.columns, dialect.cells, above)


def test_the_folder_is_listed() -> None:
    files = Path(vendors.__file__).parent.glob("[a-z]*.py")
    assert [item.name for item in all_vendors()] == sorted(path.stem for path in files)


@each_vendor
def test_each_is_named_as_its_file_and_imports_no_other(vendor: Vendor) -> None:
    assert (HERE / f"test_{vendor.name}.py").exists()
    tree = ast.parse((FOLDER / f"{vendor.name}.py").read_text("utf-8"))
    modules = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert not any(".vendors." in module for module in modules)


@each_vendor
def test_only_its_own_head_is_recognised(vendor: Vendor) -> None:
    for other in all_vendors():
        assert vendor.recognise(head_for(vendor, sample(other))) == (other is vendor)


@each_by_names
@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("step", [1, -1])
def test_names_are_known_in_any_order_and_with_any_delimiter(
    vendor: Vendor, tmp_path: Path, delimiter: str, step: int
) -> None:
    data = sample(vendor)
    dialect, above = layout(data)
    text = data.decode().splitlines()[len(above) :]
    cells = [row[::step] for row in csv.reader(text, delimiter=dialect.normaliser.delimiter)]
    lines = [line for line in above if not line.startswith("sep=")]
    changed = "\n".join([*lines, *(delimiter.join(row) for row in cells)]) + "\n"
    found, whole = read(written(tmp_path, changed, "changed.csv")), read(written(tmp_path, data))
    assert found.same_as(whole)
    assert found.recording.notes[0] == whole.recording.notes[0] == f"an export of {described(vendor).title}"
    assert found.recording.device == whole.recording.device


@each_by_names
def test_names_are_known_where_no_lines_are_above(vendor: Vendor) -> None:
    """As in a table that is no text."""
    head = head_for(vendor, sample(vendor))
    assert isinstance(head, Head)
    assert names_description(Head(head.names[::-1], lambda column: head.cells(len(head.names) - 1 - column)))


def described(vendor: Vendor) -> Stated:
    """Return what its sample says."""
    return vendor.describe(head_for(vendor, sample(vendor)))


@each_vendor
def test_it_needs_no_option_and_no_suffix(vendor: Vendor, tmp_path: Path) -> None:
    path = written(tmp_path, b"\xef\xbb\xbf" + sample(vendor), "recording.dat")
    assert find_format(path, ReadOptions()) is FORMAT
    assert FORMAT.sniff(probe_file(path, ReadOptions())) == 90
    assert read(path).same_as(read(written(tmp_path, sample(vendor))))


@each_vendor
def test_chunks_do_not_depend_on_their_size(vendor: Vendor, tmp_path: Path) -> None:
    path = written(tmp_path, sample(vendor))
    whole = read(path)
    assert len(whole.counts) == 12
    for chunk_samples in (1, 2, 5, 11, 12):
        assert read(path, chunk_samples).same_as(whole)


@every_byte
@pytest.mark.parametrize(
    "vendor",
    [
        pytest.param(item, id=item.name, marks=[pytest.mark.nightly] * (item.name in LONG_HEADS))
        for item in all_vendors()
    ],
)
def test_truncation_at_every_byte_gives_a_prefix_or_one_clear_error(
    vendor: Vendor, tmp_path: Path, step: int
) -> None:
    data = sample(vendor)
    whole = read(written(tmp_path, data))
    for size in cuts(data, step):
        path = written(tmp_path, data[:size], "cut.csv")
        try:
            found = read(path)
        except AccelcalError as error:
            assert str(path) in str(error) and error.hint
            assert data[:size].count(b"\n") < data.count(b"\n") - 6
            continue
        rows = len(found.counts)
        whole_lines = 12 - (data.count(b"\n") - data[:size].count(b"\n"))
        assert rows in (whole_lines, whole_lines + 1)
        rows = whole_lines  # a cut may leave a last row whose last cell looks whole
        assert np.array_equal(found.counts[:rows], whole.counts[:rows])
        assert np.array_equal(found.times[:rows], whole.times[:rows])
        assert found.recording.device in (whole.recording.device, type(whole.recording.device)())


@each_vendor
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_head_gives_rows_or_an_error_of_ours(
    vendor: Vendor, tmp_path: Path, data: st.DataObject
) -> None:
    whole = sample(vendor)
    mutant = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 3))):
        at, end = (data.draw(st.integers(0, len(whole))) for _ in range(2))
        mutant[at:end] = data.draw(
            st.binary(max_size=8) | st.sampled_from([b"\n", b",", b"9999", b"-", b"/"])
        )
    path = written(tmp_path, bytes(mutant), "mutant.csv")
    export_description(bytes(mutant))
    try:
        found = read(path)
    except AccelcalError as error:
        assert str(path) in str(error)
        return
    assert all(isinstance(problem, Problem) for problem in found.problems)
    assert len(found.counts) == len(found.times)


TEXTS = ("", ",", "Start Date 99/99/9999", "StartTime: 99:99:99", "Range,-8 to 8", "0,0,0", "1e999", "x")


def changed_heads(head: Head) -> Iterator[Head]:
    """Yield the head with other cells, without some lines and names, and with others."""
    for text in TEXTS:
        yield replace(head, cells=lambda _, text=text: [text] * 12)
        yield replace(head, names=(*head.names, text))
    yield replace(head, cells=lambda _: [])
    for names in changed(head.names):
        yield replace(head, names=names)
    for lines in changed(head.lines):
        yield replace(head, lines=lines)


def changed(texts: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Yield the texts up to each of them, and with another in its place."""
    for number in range(len(texts)):
        yield texts[: number + 1]
        yield from ((*texts[:number], text, *texts[number + 1 :]) for text in TEXTS)


@each_vendor
def test_describing_never_raises(vendor: Vendor) -> None:
    head = head_for(vendor, sample(vendor))
    for one in changed_heads(head) if isinstance(head, Head) else changed(head):
        if vendor.recognise(one):
            vendor.describe(one)
    for text in TEXTS:
        vendor.from_name(text, Stated())
