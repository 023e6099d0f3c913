"""Calibrated data in the forms of other tools, read back and compared with the Parquet file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.exports.data import ExportedData, ExportOptions, export_data, outputs_of
from accelcal_cli.exports.rows import open_calibrated
from accelcal_cli.formats import open_recording
from tests.device_recordings import donor

MOTION = "sub-01_task-freeliving_tracksys-wrist_motion.tsv"
START = "2024-03-04T00:00:00"
RATE_HZ = 25


def source(folder: Path, *, warm: bool = True) -> Path:
    """The calibrated file of the donor; its times are those of a clock of unknown zone."""
    donor(folder, warm=warm)
    return folder / "donor.calibrated.parquet"


def changed(path: Path, *, zone: str | None = None, start: str | None = None, **columns: object) -> Path:
    """The file with other columns, zone of its times or start of the recording."""
    table = pq.read_table(path)
    about = dict(table.schema.metadata)
    if zone is not None:
        about[b"time_zone"] = zone.encode()
        columns["time"] = table["time"].cast(pa.timestamp("us", zone))
    if start is not None:
        said = json.loads(about[b"accelcal"])
        said["recording"]["start_time"] = start
        about[b"accelcal"] = json.dumps(said).encode()
    for name, values in columns.items():
        place = table.schema.get_field_index(name)
        table = table.set_column(place, name, pa.array(values) if isinstance(values, np.ndarray) else values)
    pq.write_table(table.replace_schema_metadata(about), path)
    return path


def written(form: str, path: Path, name: str, **wanted: object) -> tuple[Path, ExportedData]:
    output = path.with_name(name)
    return output, export_data(form, path, ExportOptions(output, **wanted))


def read(path: Path) -> pd.DataFrame:
    return pq.read_table(path).to_pandas()


def test_csv_holds_every_value_exactly(tmp_path: Path) -> None:
    path = source(tmp_path)
    output, found = written("csv", path, "a.csv")
    table, expected = pd.read_csv(output, dtype=dict.fromkeys("xyz", np.float32)), read(path)
    assert list(table.columns) == ["time", "x", "y", "z", "temperature"]
    assert table["time"][:2].tolist() == [f"{START}.000000", f"{START}.040000"]
    assert (pd.to_datetime(table["time"]) == expected["time"]).all()
    for axis in "xyz":
        assert table[axis].to_numpy().tobytes() == expected[axis].to_numpy().tobytes()
    assert table["temperature"].to_numpy(np.float32) == pytest.approx(expected["temperature"], abs=1e-6)
    assert (found.rows, found.stretches, found.seconds) == (len(expected), 1, len(expected) / RATE_HZ)


def test_without_a_thermometer_there_is_no_column_of_temperature(tmp_path: Path) -> None:
    output, _ = written("csv", source(tmp_path, warm=False), "a.csv")
    assert output.read_text().splitlines()[0] == "time,x,y,z"


def test_a_missing_temperature_is_an_empty_cell_or_na(tmp_path: Path) -> None:
    path = source(tmp_path)
    heat = read(path)["temperature"].to_numpy().copy()
    heat[1] = np.nan
    changed(path, temperature=heat)
    assert written("csv", path, "a.csv")[0].read_text().splitlines()[2].endswith(",")
    assert written("bids", path, MOTION)[0].read_text().splitlines()[1].endswith("\tn/a")


def test_utc_is_said_so_and_mhealth_has_the_devices_clock(tmp_path: Path) -> None:
    path = changed(source(tmp_path), zone="UTC", start=f"{START}+02:00")
    assert written("csv", path, "a.csv")[0].read_text().splitlines()[1].startswith(f"{START}.000000Z,")
    lines = written("mhealth", path, "b.csv")[0].read_text().splitlines()
    assert lines[0] == "HEADER_TIME_STAMP,X,Y,Z" and lines[2].startswith("2024-03-04 02:00:00.040,")


def test_mhealth_has_times_to_the_nearest_ms_and_g(tmp_path: Path) -> None:
    path = source(tmp_path)
    times = read(path)["time"].to_numpy().astype("datetime64[us]") + np.timedelta64(600, "us")
    changed(path, time=times)
    table, expected = pd.read_csv(written("mhealth", path, "a.csv")[0]), read(path)
    assert table["HEADER_TIME_STAMP"][1] == "2024-03-04 00:00:00.041"
    for name in "XYZ":
        assert table[name].to_numpy(np.float32).tobytes() == expected[name.lower()].to_numpy().tobytes()


def test_npz_has_what_skdh_reads(tmp_path: Path) -> None:
    path = source(tmp_path)
    output, _ = written("npz", path, "a.npz")
    expected = read(path)
    with np.load(output) as held:
        assert set(held.files) == {"time", "accel", "fs", "temperature"}
        assert held["accel"].dtype == np.float32 and held["time"].dtype == np.float64
        assert held["accel"].tobytes() == expected[["x", "y", "z"]].to_numpy().tobytes()
        us = expected["time"].to_numpy().astype("datetime64[us]").astype(np.int64)
        assert np.array_equal(held["time"], us / 1e6)
        assert held["temperature"].tobytes() == expected["temperature"].to_numpy().tobytes()
        assert held["fs"][()] == RATE_HZ


@pytest.mark.nightly
def test_skdh_reads_it(tmp_path: Path) -> None:
    io = pytest.importorskip("skdh.io", reason="scikit-digital-health is not installed (oracles)")
    path = source(tmp_path)
    with pytest.warns(UserWarning, match="naive"):
        held = io.ReadNumpyFile().predict(file=str(written("npz", path, "a.npz")[0]))
    assert held["accel"].shape == (len(read(path)), 3) and held["fs"] == RATE_HZ


def test_motion_bids(tmp_path: Path) -> None:
    path = source(tmp_path)
    output, _ = written("bids", path, MOTION)
    channels = pd.read_csv(tmp_path / MOTION.replace("_motion.tsv", "_channels.tsv"), sep="\t")
    sidecar = json.loads((tmp_path / MOTION.replace(".tsv", ".json")).read_text())
    table, expected = pd.read_csv(output, sep="\t", header=None), read(path)
    assert channels["name"].tolist() == ["latency", "acc_x", "acc_y", "acc_z", "temperature"]
    assert channels["type"].tolist() == ["LATENCY", "ACCEL", "ACCEL", "ACCEL", "MISC"]
    assert channels["units"].tolist() == ["s", "m/s^2", "m/s^2", "m/s^2", "oC"]
    assert table[0].to_numpy() == pytest.approx(np.arange(len(expected)) / RATE_HZ, abs=1e-9)
    for place, axis in enumerate("xyz", 1):
        assert table[place].to_numpy() == pytest.approx(9.80665 * expected[axis], abs=1e-5)
    assert len(table.columns) == len(channels) == sidecar["MotionChannelCount"]
    with open_recording(output, ReadOptions()) as reader:
        chunks = list(reader.chunks(10_000))
        again = np.concatenate([chunk.counts for chunk in chunks]) / reader.recording.lsb_per_g
        assert reader.recording.rate_hz == RATE_HZ
    assert np.abs(again - expected[["x", "y", "z"]].to_numpy()).max() < 1e-6
    assert (sidecar["TaskName"], sidecar["TrackingSystemName"]) == ("freeliving", "wrist")
    assert (sidecar["SamplingFrequency"], sidecar["SamplingFrequencyEffective"]) == (RATE_HZ, RATE_HZ)


@pytest.mark.parametrize(
    "name", ["a.tsv", "sub-01_motion.tsv", "sub-01_task-a_motion.tsv", "task-a_motion.tsv"]
)
def test_a_name_that_bids_does_not_know_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match="is not a Motion-BIDS name; name it as in sub-01_task-freeliving"):
        outputs_of("bids", tmp_path / name)


def test_filled_rows_are_kept_or_left_out_and_clipped_ones_are_kept(tmp_path: Path) -> None:
    path = source(tmp_path)
    validity = np.zeros(len(read(path)), np.uint8)
    validity[100:200], validity[300:310], validity[400:402] = 1, 2, 3
    changed(path, validity=validity)
    assert written("csv", path, "a.csv")[1].rows == len(validity)
    output, found = written("csv", path, "b.csv", measured_only=True)
    kept = (validity == 0) | (validity == 2)
    assert (found.rows, found.stretches) == (kept.sum(), 3)
    assert (
        pd.to_datetime(pd.read_csv(output)["time"]).to_numpy() == read(path)["time"][kept].to_numpy()
    ).all()


def test_resampled_data_leave_gaps_as_they_are(tmp_path: Path) -> None:
    path = source(tmp_path)
    validity = np.zeros(len(read(path)), np.uint8)
    validity[1000:2000] = 1
    changed(path, validity=validity)
    output, found = written("csv", path, "a.csv", measured_only=True, resample_hz=10.0)
    times = pd.to_datetime(pd.read_csv(output)["time"]).to_numpy()
    steps = np.diff(times) / np.timedelta64(1, "us")
    assert sorted(set(steps.tolist())) == [100_000.0, 40_100_000.0]
    assert times[400] == np.datetime64(f"{START}") + np.timedelta64(80, "s")
    assert (found.about.rate_hz, found.stretches) == (10.0, 2)


@pytest.mark.parametrize("form", ["csv", "npz"])
def test_the_size_of_batches_makes_no_difference(tmp_path: Path, form: str) -> None:
    path = source(tmp_path)
    with open_calibrated(path) as rows:
        assert [len(part) for part in rows.portions(9999)] == [9999, 9999, 9999, 3]
    whole = written(form, path, f"a.{form}", resample_hz=30.0)[0].read_bytes()
    assert written(form, path, f"b.{form}", resample_hz=30.0, batch_rows=777)[0].read_bytes() == whole


def test_a_rate_that_is_out_of_reach_is_refused_and_nothing_is_left(tmp_path: Path) -> None:
    path = source(tmp_path)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(UsageError, match=r"has 25 Hz, too far from 0\.2"):
        written("csv", path, "a.csv", resample_hz=0.2)
    assert sorted(tmp_path.iterdir()) == before


def test_nothing_is_left_where_no_row_is_or_the_file_is_damaged(tmp_path: Path) -> None:
    path = source(tmp_path)
    changed(path, validity=np.ones(len(read(path)), np.uint8))
    before = sorted(tmp_path.iterdir())
    with pytest.raises(UsageError, match="no row would be left; omit --measured-only"):
        written("bids", path, MOTION, measured_only=True)
    data = bytearray(path.read_bytes())
    data[2000:3000] = bytes(1000)
    path.write_bytes(data)
    with pytest.raises(UnreadableError, match="cannot be read as Parquet"):
        written("npz", path, "a.npz")
    assert sorted(tmp_path.iterdir()) == before


def test_only_calibrated_files_of_ours_are_read(tmp_path: Path) -> None:
    foreign = tmp_path / "a.parquet"
    pq.write_table(pa.table({"time": [1], "x": [1.0]}), foreign)
    for path in (foreign, tmp_path / "missing.parquet", tmp_path):
        with pytest.raises(UnreadableError, match="name a Parquet file that accelcal wrote"):
            written("csv", path, "b.csv")
