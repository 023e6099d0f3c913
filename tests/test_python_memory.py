"""Recordings that are in no file: the same bits as from a file of the same values."""

from __future__ import annotations

import gc
import io
import os
import pickle
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest

import accelcal
from tests.conftest import ROOT
from tests.recordings import LSB_PER_G, RATE_HZ, directions, still_counts

COUNTS = still_counts(directions(60), seed=1)
XYZ = COUNTS / LSB_PER_G
NUMBER = len(XYZ)
CELSIUS = np.round(24 + 4 * np.sin(np.arange(NUMBER) / 5000), 3)
START = "2024-03-04T00:00:00"
TIMES = np.datetime64(START, "us") + (np.arange(NUMBER) * round(1e6 / RATE_HZ)).astype("timedelta64[us]")
FRAME = pd.DataFrame({"time": TIMES, **dict(zip("xyz", XYZ.T, strict=True)), "temperature": CELSIUS})


def same(found: accelcal.Result, file: accelcal.Result) -> None:
    """All of a report that is not about the file itself, and the calibrated values to the bit."""
    assert found.usable
    left_out = {"recording", "provenance", "settings"}
    for key in found.report.keys() - left_out:
        assert found.report[key] == file.report[key], key
    for key in found.report["recording"].keys() - {"path", "sha256", "bytes", "format", "notes"}:
        assert found.report["recording"][key] == file.report["recording"][key], key
    assert found.to_arrow().equals(file.to_arrow())


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int16])
def test_p4_an_array_is_calibrated_as_a_file_of_it(dtype: Any, tmp_path: Path) -> None:
    xyz = COUNTS if dtype is np.int16 else XYZ.astype(dtype)
    options: dict[str, Any] = (
        {"unit": "counts", "lsb_per_g": LSB_PER_G} if dtype is np.int16 else {"unit": "g"}
    )
    np.savez(tmp_path / "file.npz", xyz=xyz, temperature=CELSIUS)
    file = accelcal.calibrate(tmp_path / "file.npz", rate=RATE_HZ, start=START, **options)
    found = accelcal.calibrate(xyz, rate=RATE_HZ, start=START, temperature=CELSIUS, **options)
    same(found, file)
    assert found.report["recording"]["sha256"] == file.report["recording"]["sha256"]
    assert found.report["recording"]["path"] == "array"
    same(accelcal.calibrate(np.asfortranarray(xyz)[::1], time=TIMES, temperature=CELSIUS, **options), file)


def test_p4_a_gyroscope_comes_along(tmp_path: Path) -> None:
    turning = np.random.default_rng(1).normal(0, 0.1, (NUMBER, 3))
    np.savez(tmp_path / "file.npz", xyz=XYZ, gyroscope=turning)
    file = accelcal.calibrate(tmp_path / "file.npz", rate=RATE_HZ, gyro_unit="deg/s")
    found = accelcal.calibrate(XYZ.tolist(), rate=RATE_HZ, gyroscope=turning)
    same(found, file)
    assert {"gx", "gy", "gz"} <= set(found.to_arrow().column_names)


TABLES = {
    "pandas": lambda: FRAME,
    "pandas by time": lambda: FRAME.set_index("time"),
    "polars": lambda: pl.from_pandas(FRAME),
    "lazy": lambda: pl.from_pandas(FRAME).lazy(),
    "arrow": lambda: pa.Table.from_pandas(FRAME),
    "batch": lambda: pa.Table.from_pandas(FRAME).combine_chunks().to_batches()[0],
    "columns": lambda: {name: FRAME[name].to_numpy() for name in FRAME},
    "xarray": lambda: pytest.importorskip("xarray").Dataset.from_dataframe(FRAME.set_index("time")),
}


@pytest.mark.parametrize("kind", TABLES)
def test_p4_a_table_is_calibrated_as_a_file_of_it(kind: str, tmp_path: Path) -> None:
    FRAME.to_parquet(tmp_path / "file.parquet")
    same(accelcal.calibrate(TABLES[kind]()), accelcal.calibrate(tmp_path / "file.parquet"))


def test_p4_columns_and_records_of_arrays() -> None:
    """As scikit-digital-health has them, and numpy's records."""
    file = accelcal.calibrate(XYZ, time=TIMES, temperature=CELSIUS)
    seconds = TIMES.astype("int64") / 1e6
    found = accelcal.calibrate({"time": seconds, "accel": XYZ, "temperature": CELSIUS})
    assert found["calibration"] == file["calibration"] and found["recording"]["time_zone"] == "UTC"
    records = np.rec.fromarrays([TIMES, *XYZ.T, CELSIUS], names="time,x,y,z,temperature")
    same(accelcal.calibrate(records), file)


@pytest.mark.parametrize("kind", ["file", "memory"])
def test_a_result_can_go_to_another_process(kind: str) -> None:
    source = ROOT / "sample_data/evening.csv.gz" if kind == "file" else FRAME
    result = accelcal.calibrate(source)
    packed, values = pickle.dumps(result), result.to_arrow()
    del result
    again = pickle.loads(packed)
    assert again.to_arrow().equals(values) and len(again.windows()) and repr(again)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_leaves_the_temporary_file_to_its_parent() -> None:
    program = """
import gc, os, numpy, accelcal
result = accelcal.calibrate(numpy.tile([[0.0, 0.0, 1.0]], (1000, 1)), rate=50)
if (child := os.fork()) == 0:
    del result
    gc.collect()
    raise SystemExit
assert os.waitpid(child, 0)[1] == 0
path = result._given.path
assert path.exists()
del result
gc.collect()
assert not path.exists()
"""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-W", "ignore", "-c", program], check=True, env=environment)


def test_p4_an_array_of_xarray_brings_its_times() -> None:
    xarray = pytest.importorskip("xarray")
    found = accelcal.calibrate(xarray.DataArray(XYZ, dims=("time", "axis"), coords={"time": TIMES}))
    same(found, accelcal.calibrate(XYZ, time=TIMES))


def test_p4_bytes_and_open_files_are_read_as_the_file(tmp_path: Path) -> None:
    path = ROOT / "sample_data/evening.csv.gz"
    file, data = accelcal.calibrate(path), path.read_bytes()
    with path.open("rb") as opened:
        for source in (data, bytearray(data), memoryview(data), io.BytesIO(data), opened):
            found = accelcal.calibrate(source, report_only=True)
            assert found.report["calibration"] == file.report["calibration"]
            assert found.report["recording"]["sha256"] == file.report["recording"]["sha256"]
    assert found.report["recording"]["path"] == "evening.csv.gz"
    text = FRAME.to_csv(index=False)
    (tmp_path / "a.csv").write_text(text)
    same(accelcal.calibrate(io.StringIO(text)), accelcal.calibrate(tmp_path / "a.csv"))
    same(accelcal.calibrate(FRAME), accelcal.calibrate(accelcal.read(FRAME).to_pandas()))


def test_p4_temporary_files_go_with_the_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    result = accelcal.calibrate(XYZ, rate=RATE_HZ)
    with accelcal.read(FRAME) as reading:
        assert len(next(iter(reading))) and len([*tmp_path.iterdir()]) == 2
    assert len([*tmp_path.iterdir()]) == 1
    with pytest.raises(accelcal.AccelcalError, match="the recording is in no folder"):
        result.write()
    parquet, report = result.write(tmp_path / "out")
    assert parquet is not None and (parquet.name, report.name) == (
        "array.calibrated.parquet", "array.calibration.json",
    )  # fmt: skip
    del result
    assert [one.name for one in tmp_path.iterdir()] == ["out"]
    with pytest.raises(ValueError, match="not"):
        accelcal.calibrate(XYZ[:, :2], rate=RATE_HZ)
    assert [one.name for one in tmp_path.iterdir()] == ["out"]


LAZY: dict[str, tuple[Any, str]] = {
    "batches": (lambda: next(accelcal.calibrate(XYZ[:500], rate=RATE_HZ).batches()), "array: there are no "),
    "to_pandas": (lambda: accelcal.calibrate(FRAME[:500]).to_pandas(), "frame: there are no calibrated val"),
    "to_arrow": (lambda: accelcal.calibrate(pa.table(FRAME[:500])).to_arrow(), "table: there are no calibr"),
    "columns": (lambda: accelcal.calibrate({"a": [1.0], "b": [1.0]}), "columns: no column of numbers can be"),
    "changed": (lambda: changed(accelcal.calibrate(XYZ, rate=RATE_HZ)).to_arrow(), "array: changed while it"),
    "gone": (lambda: gone(accelcal.read(FRAME)).to_pandas(), "frame: file not found"),
    "export": (lambda: accelcal.export(accelcal.calibrate(XYZ[:500], rate=25), to="ggir"), "array.calibrat"),
    "zip": (lambda: accelcal.calibrate(zip_of("S01/left/night.csv")), "bytes/S01/left/night.csv"),
}  # fmt: skip
"""Calls that fail late, or deep within what was given, and how their messages begin."""


def changed(result: accelcal.Result) -> accelcal.Result:
    os.utime(result._given.path, (1, 1))
    return result


def gone(reading: accelcal.Reading) -> accelcal.Reading:
    reading._given.path.unlink()
    return reading


def zip_of(name: str) -> bytes:
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w") as archive:
        archive.writestr(name, "time,x,y,z\n1,2\n")
    return whole.getvalue()


@pytest.mark.parametrize("name", LAZY)
def test_errors_name_what_was_given_and_no_temporary_file(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    call, text = LAZY[name]
    with pytest.raises(accelcal.AccelcalError) as caught:
        call()
    assert str(caught.value).startswith(text) and str(tmp_path) not in str(caught.value)
    del caught, call
    gc.collect()
    assert not [*tmp_path.iterdir()]


def test_no_room_for_a_temporary_file_is_an_error_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(np, "savez", Mock(side_effect=OSError(28, "No space left on device")))
    with pytest.raises(accelcal.AccelcalError, match=r"No space left on device.*set TMPDIR"):
        accelcal.calibrate(XYZ, rate=RATE_HZ)


@pytest.mark.parametrize(
    ("call", "kind", "text"),
    [
        (lambda: accelcal.calibrate(XYZ.T, rate=25), ValueError, r"\(3, \d+\), not \(n, 3\).*give xyz\.T"),
        (lambda: accelcal.calibrate(XYZ[0], rate=25), ValueError, r"\(3,\), not \(n, 3\)"),
        (lambda: accelcal.calibrate(XYZ), accelcal.AccelcalError, "^array: .* rate with rate=HZ"),
        (lambda: accelcal.calibrate(XYZ, rate=25, temperature=CELSIUS[1:]), ValueError, "temperature has"),
        (lambda: accelcal.calibrate(XYZ, time=TIMES[:9].tolist()), ValueError, r"time has the shape \(9,"),
        (lambda: accelcal.calibrate({"xyz": XYZ.T, "temp": CELSIUS[1:]}), ValueError, r"'temp' .*\(44999,\)"),
        (lambda: accelcal.calibrate({"time": [*map(str, TIMES[1:])], "xyz": XYZ}), ValueError, "'time' has"),
        (lambda: accelcal.calibrate({}), ValueError, "there are no columns: give x, y, z and time"),
        (lambda: accelcal.calibrate(XYZ, rate=25, gyroscope=XYZ.T), ValueError, r"give gyroscope\.T"),
        (lambda: accelcal.calibrate(FRAME, temperature=CELSIUS), accelcal.AccelcalError, "make it a column"),
        (lambda: accelcal.calibrate("a.cwa", time=TIMES), accelcal.AccelcalError, "a file has its own"),
        (lambda: accelcal.calibrate(XYZ.astype(str), rate=25), TypeError, "'ndarray' is not a recording"),
        (lambda: accelcal.calibrate([[1, 2, 3], [1]], rate=25), TypeError, "'list' is not a recording"),
        (lambda: accelcal.calibrate(3), TypeError, "'int' is not a recording"),
        (lambda: accelcal.calibrate(["a.cwa", "b.cwa"]), TypeError, r"\(one\) for .*\.study\("),
        (lambda: accelcal.calibrate([FRAME, FRAME]), TypeError, r"several recordings: \[acc"),
        (lambda: accelcal.fit(XYZ), accelcal.AccelcalError, r"raw samples.*\.calibrate\(xyz, rate=HZ\)"),
    ],
)  # fmt: skip
def test_p4_p5_what_cannot_be_a_recording_is_answered(call: Any, kind: type[Exception], text: str) -> None:
    with pytest.raises(kind, match=text):
        call()


def test_p5_raw_samples_are_told_from_means(tmp_path: Path) -> None:
    """Counts, decimals with movement, and many rows; not windows, nor windows rounded to mg."""
    result = accelcal.calibrate(ROOT / "sample_data/evening.csv.gz", report_only=True)
    means = result.windows()[["x", "y", "z"]]
    assert len(means) > 2000
    assert accelcal.fit(means.round(3)).usable and accelcal.fit(means).usable
    moving = np.concatenate([XYZ[:5000], XYZ[:10] * 2]) + np.random.default_rng(1).normal(0, 1e-3, (5010, 3))
    many = np.tile(means.to_numpy(), (60, 1)) + np.random.default_rng(1).normal(0, 1e-4, (60 * len(means), 3))
    for rows in (XYZ, moving, many):
        with pytest.raises(accelcal.AccelcalError, match="raw samples"):
            accelcal.fit(rows)
    pd.DataFrame(XYZ, columns=[*"xyz"]).to_csv(tmp_path / "raw.csv")
    with pytest.raises(
        accelcal.AccelcalError, match=r"raw samples.*accelcal\.calibrate\('.*raw\.csv', rate=HZ"
    ):
        accelcal.fit(tmp_path / "raw.csv")
    weighed = pd.DataFrame(moving, columns=[*"xyz"]).assign(weight=1.0)
    assert accelcal.fit(weighed).outcome
