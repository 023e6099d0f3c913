"""A rolling mean of what is written, against that of pandas, and where it must not reach."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.errors import UsageError
from accelcal_cli.exports.data import ExportOptions, export_data
from accelcal_cli.exports.rows import SampleRows, rolling_means, smoothed, width_for
from tests.cli.run import run
from tests.device_recordings import donor
from tests.exports.test_data import changed, read, source

Capture = pytest.CaptureFixture[str]
RATE_HZ = 100.0
RANDOM = np.random.default_rng(7)
XYZ = RANDOM.normal((0.1, -0.3, 0.9), 0.2, (400, 3)).astype(np.float32)


def by_pandas(xyz: np.ndarray, width: int) -> np.ndarray:
    """Centred, and at the ends the mean of what is there."""
    frame = pd.DataFrame(xyz.astype(np.float64))
    return frame.rolling(width, center=True, min_periods=1).mean().to_numpy()


def rows(
    xyz: np.ndarray, validity: np.ndarray | None = None, later_us: dict[int, int] | None = None
) -> SampleRows:
    """At 100 Hz; from some rows on, later by so much."""
    times = np.arange(len(xyz), dtype=np.int64) * 10_000
    for row, us in (later_us or {}).items():
        times[row:] += us
    marks = np.zeros(len(xyz), np.uint8) if validity is None else validity
    return SampleRows(times, xyz, np.arange(len(xyz), dtype=np.float32), {"validity": marks})


def means(held: SampleRows, width: int, portion: int = 1 << 17) -> np.ndarray:
    """Of all rows, which stay what they are beside."""
    parts = [held.part(start, min(start + portion, len(held))) for start in range(0, len(held), portion)]
    found = list(smoothed(parts, RATE_HZ, width))
    assert (np.concatenate([one.time_us for one in found]) == held.time_us).all()
    assert (np.concatenate([one.celsius for one in found if one.celsius is not None]) == held.celsius).all()
    assert (np.concatenate([one.validity for one in found]) == held.validity).all()
    return np.concatenate([one.xyz for one in found])


@pytest.mark.parametrize("width", [2, 3, 5, 10, 20, 399, 400, 1000])
def test_one_stretch_is_that_of_pandas(width: int) -> None:
    found = means(rows(XYZ), width)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, by_pandas(XYZ, width), rtol=1e-7, atol=2e-10)


@given(st.integers(1, 60), st.integers(2, 25), st.integers(1, 70))
def test_the_bits_do_not_depend_on_the_portions(number: int, width: int, portion: int) -> None:
    held = rows(XYZ[:number])
    assert (means(held, width, portion) == means(held, width)).all()


@pytest.mark.parametrize("portion", [1, 3, 50, 1000])
def test_it_does_not_reach_across_a_gap(portion: int) -> None:
    """A lost sample, a step back, and half a period more, which is none."""
    held = rows(XYZ, later_us={100: 10_000, 200: -500_000, 300: 5_000})
    expected = [by_pandas(part, 10) for part in (XYZ[:100], XYZ[100:200], XYZ[200:])]
    np.testing.assert_allclose(means(held, 10, portion), np.concatenate(expected), rtol=1e-7, atol=2e-10)


@pytest.mark.parametrize("portion", [1, 7, 1000])
def test_rows_that_were_not_measured_stay_and_are_averaged_with_none(portion: int) -> None:
    """Clipped rows were: they are as large as the sensor could say."""
    validity = np.zeros(400, np.uint8)
    validity[50:60], validity[200], validity[300] = 1, 3, 2
    expected = XYZ.astype(np.float64)
    for part in (slice(0, 50), slice(60, 200), slice(201, 400)):
        expected[part] = by_pandas(XYZ[part], 5)
    np.testing.assert_allclose(means(rows(XYZ, validity), 5, portion), expected, rtol=1e-7, atol=2e-10)


def test_a_value_that_rests_stays_to_the_bit() -> None:
    still = np.repeat(np.float32([[0.123456789, -1.5, 1e-4]]), 90, axis=0)
    still[:, 2] = np.rint(still[:, 2] * 2**32) / 2**32
    assert (means(rows(still), 20) == still).all()


def test_large_values_after_many_rows_are_right() -> None:
    """Sums of all rows pass 64 bits; those of a window do not."""
    large = np.full((70_000, 1), 1 << 20, np.float32)
    large[::2] = 3 << 19
    found = rolling_means(large, 4, 60_000, 60_010)
    assert (found == 5 << 18).all()


def export(form: str, path: Path, name: str, **wanted: object) -> Path:
    output = path.with_name(name)
    export_data(form, path, ExportOptions(output, **wanted))  # type: ignore[arg-type]
    return output


@pytest.mark.parametrize("batch_rows", [1 << 17, 333])
def test_parquet_keeps_all_columns_and_says_what_was_done(tmp_path: Path, batch_rows: int) -> None:
    path = source(tmp_path)
    before, about = read(path), pq.read_schema(path)
    output = export("parquet", path, "a.parquet", smooth=0, batch_rows=batch_rows)
    after, schema = read(output), pq.read_schema(output)
    assert schema.equals(about) and list(after.columns) == list(before.columns)
    assert [schema.field(name).metadata for name in schema.names] == [
        about.field(name).metadata for name in about.names
    ]
    width = width_for(25.0)
    assert width == 5
    expected = by_pandas(before[list("xyz")].to_numpy(), width)
    np.testing.assert_allclose(after[list("xyz")].to_numpy(), expected, rtol=1e-7, atol=2e-10)
    pd.testing.assert_frame_equal(after.drop(columns=list("xyz")), before.drop(columns=list("xyz")))
    said, was = (json.loads(one.metadata[b"accelcal"]) for one in (schema, about))
    assert said == {**was, "smoothed": {"samples": 5}}
    assert output.read_bytes() == export("parquet", path, "b.parquet", smooth=5).read_bytes()


def test_without_a_filter_the_values_are_the_same(tmp_path: Path) -> None:
    path = source(tmp_path)
    output = export("parquet", path, "a.parquet")
    pd.testing.assert_frame_equal(read(output), read(path))
    assert pq.read_schema(output).metadata == pq.read_schema(path).metadata


def test_what_is_resampled_is_smoothed_before(tmp_path: Path) -> None:
    path = source(tmp_path)
    first = export("parquet", path, "a.parquet", smooth=10)
    output = export("parquet", path, "b.parquet", smooth=10, resample_hz=20.0)
    again = export("parquet", first, "c.parquet", resample_hz=20.0)
    assert list(read(output).columns) == ["time", "x", "y", "z", "temperature"]
    pd.testing.assert_frame_equal(read(output), read(again))
    said = json.loads(pq.read_schema(output).metadata[b"accelcal"])
    assert (said["smoothed"], said["resampled_hz"]) == ({"samples": 10}, 20.0)


def test_no_second_mean_of_a_mean(tmp_path: Path) -> None:
    first = export("parquet", source(tmp_path), "a.parquet", smooth=3)
    with pytest.raises(UsageError, match="is a rolling mean of 3 samples already"):
        export("csv", first, "b.csv", smooth=3)
    assert export("csv", first, "b.csv").exists()


def test_the_command(tmp_path: Path, capsys: Capture) -> None:
    donor(tmp_path)
    path = tmp_path / "donor.calibrated.parquet"
    marks = read(path)["validity"].to_numpy().copy()
    marks[10:20] = 1
    changed(path, validity=marks)
    ran = run(capsys, "export", path, "--to", "csv", "-o", tmp_path / "a.csv", "--smooth", "auto")
    assert ran.code == 0 and "with 0 gaps, a rolling mean of 5 samples, times" in ran.err
    table, before = pd.read_csv(tmp_path / "a.csv"), read(path)
    assert (table["x"][10:20].to_numpy(np.float32) == before["x"][10:20]).all()
    expected = by_pandas(before[["x"]].to_numpy()[20:], 5)[:, 0]
    np.testing.assert_allclose(table["x"][20:], expected, atol=1e-7)
    for width in ("1", "1001", "2.5", "median"):
        ran = run(capsys, "export", path, "--to", "csv", "-o", tmp_path / "b.csv", "--smooth", width)
        assert ran.code == 2, ran
    ran = run(capsys, "export", tmp_path / "donor.calibration.json", "--to", "ggir", "--smooth", "auto")
    assert ran.code == 2 and "--smooth is for data" in ran.err
