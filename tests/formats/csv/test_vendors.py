"""The contract of vendors' files, on the SAMPLE that each one's own test file binds."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from accelcal_cli.core.errors import AccelcalError
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.core.recording import Problem
from accelcal_cli.formats import find_format
from accelcal_cli.formats.csv import FORMAT, vendors
from accelcal_cli.formats.csv.vendors import Vendor, all_vendors, export_description
from tests.formats.cuts import cuts, every_byte
from tests.formats.make_csv import read, written

HERE = Path(__file__).parent
FOLDER = Path(vendors.__file__).parent
LONG_HEADS = ("geneactiv", "axivity")
"""Vendors with long samples; cutting these everywhere takes a second and is left to the nightly run."""

each_vendor = pytest.mark.parametrize("vendor", all_vendors(), ids=lambda item: item.name)


def sample(vendor: Vendor) -> bytes:
    """Return a small whole file of this vendor."""
    return importlib.import_module(f"tests.formats.csv.test_{vendor.name}").SAMPLE


def test_the_folder_is_listed() -> None:
    assert {"actigraph", "axivity", "empatica", "geneactiv"} <= {item.name for item in all_vendors()}


@each_vendor
def test_each_is_named_as_its_file_and_imports_no_other(vendor: Vendor) -> None:
    assert (HERE / f"test_{vendor.name}.py").exists()
    tree = ast.parse((FOLDER / f"{vendor.name}.py").read_text("utf-8"))
    modules = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert not any(".vendors." in module for module in modules)


@each_vendor
def test_only_its_own_head_is_recognised(vendor: Vendor) -> None:
    for other in all_vendors():
        lines = tuple(sample(other).decode().splitlines())
        assert vendor.recognise(lines) == (other is vendor)


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


@each_vendor
def test_describing_never_raises(vendor: Vendor) -> None:
    lines = tuple(sample(vendor).decode().splitlines())
    texts = ("", ",", "Start Date 99/99/9999", "Start Time 99:99:99", "Range,-8 to 8", "0,0,0")
    for number in range(len(lines)):
        for changed in (
            lines[: number + 1],
            *((*lines[:number], text, *lines[number + 1 :]) for text in texts),
        ):
            if vendor.recognise(changed):
                vendor.describe(changed)
