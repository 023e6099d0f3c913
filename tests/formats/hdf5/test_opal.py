"""APDM Opal files, held against h5py and plain arithmetic."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from accelcal_cli.core.errors import AccelcalError, UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.formats import find_format
from accelcal_cli.formats.tables import OPAL
from tests.formats.cuts import cuts, every_byte
from tests.formats.make_hdf5 import START_US, about, even_times, write
from tests.formats.make_hdf5 import read as read_any
from tests.formats.make_opal import GRAVITY, GRID, make, make_old
from tests.formats.reading import Read

ROWS = 300
RATE_HZ = 128.0


def counts() -> np.ndarray:
    return np.random.default_rng(6).integers(-2048, 2048, (ROWS, 3)).astype(np.int16)


def read(path: Path, chunk_samples: int = 1000, **options: Any) -> Read:
    return read_any(path, chunk_samples, OPAL, **options)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return make(tmp_path, counts(), RATE_HZ, 256.0).path


@pytest.mark.parametrize(("sensor", "sign"), [("XI-000002", 1), ("Left Wrist", 1), ("LUMBAR ", -1)])
def test_a_sensor_is_chosen_by_number_or_label(path: Path, sensor: str, sign: int) -> None:
    got = read(path, sensor=sensor)
    assert (got.g == sign * counts() / 256).all()
    assert (got.times == even_times(ROWS, RATE_HZ)).all()
    assert (got.breaks, got.problems) == ([], [])


def test_what_the_file_tells_about_the_recording(path: Path) -> None:
    recording = read(path, sensor="XI-000001").recording
    device = recording.device
    assert (device.model, device.serial, device.firmware) == ("Opal", "XI-000001", "V2-TEST")
    assert (recording.format, recording.rate_hz, recording.start_us) == ("opal", RATE_HZ, START_US)
    assert recording.timezone == "UTC"
    assert {"worn at: Lumbar", "recorded in the time zone America/New_York"} <= {*recording.notes}
    assert recording.range_g == pytest.approx(160 / GRAVITY)
    assert recording.duration_s == pytest.approx(ROWS / RATE_HZ, abs=1e-5)


def test_temperature_and_rates_of_turn_follow_their_rows(path: Path) -> None:
    got = read(path, 70, sensor="left wrist")
    assert got.temperature is not None
    assert (got.temperature == 30_000 + np.arange(ROWS)).all()
    assert got.gyro is not None
    assert got.recording.gyro_dps_per_lsb == (1 / 65_536,) * 3
    assert (got.gyro == counts().astype(int) * 256).all()


def test_several_sensors_and_none_chosen_is_refused_with_their_list(path: Path) -> None:
    with pytest.raises(UnreadableError, match=r"XI-000001 \(Lumbar\), XI-000002 \(Left Wrist\).*--sensor"):
        read(path)
    with pytest.raises(UnreadableError) as error:
        read(path, sensor="each")  # as a study does to list them
    assert error.value.sensors == ("XI-000001", "XI-000002")
    with pytest.raises(UsageError, match=r"no sensor named 'Head'.*Lumbar"):
        read(path, sensor="Head")


def test_a_single_sensor_needs_no_choice(path: Path) -> None:
    with h5py.File(path, "a") as file:
        del file["Sensors/XI-000001"]
    assert (read(path).g == counts() / 256).all()


@pytest.mark.parametrize("version", [2, 3, 4])
def test_older_versions_are_read(tmp_path: Path, version: int) -> None:
    path = make_old(tmp_path / "old.h5", version, counts() / 256, even_times(ROWS, RATE_HZ), RATE_HZ)
    assert find_format(path, ReadOptions()).name == "opal"
    got = read(path, sensor="Left wrist")
    assert (got.g == counts() / 256).all()
    assert (got.times == even_times(ROWS, RATE_HZ)).all()
    assert (got.recording.device.serial, got.recording.rate_hz) == ("SI-000738", RATE_HZ)
    assert got.gyro is not None
    assert got.temperature is None
    assert (read(path, sensor="SI-000739").g == -counts() / 256).all()


@pytest.mark.parametrize("version", [1, 6])
def test_other_versions_are_refused_by_number(path: Path, version: int) -> None:
    with h5py.File(path, "a") as file:
        file.attrs["FileFormatVersion"] = version
    with pytest.raises(UnreadableError, match=f"version {version}; versions 2 to 5 can be read"):
        read(path)


def test_it_is_preferred_to_plain_hdf5_and_does_not_claim_other_files(path: Path, tmp_path: Path) -> None:
    assert find_format(path, ReadOptions()).name == "opal"
    other = write(tmp_path / "b.h5", {"accel": counts()}, about())
    assert OPAL.sniff(probe_file(other, ReadOptions())) == 0
    with pytest.raises(UnreadableError, match="not an APDM Opal file"):
        read(other)


def test_lost_samples_are_breaks_with_their_times(path: Path) -> None:
    with h5py.File(path, "a") as file:
        sensor = file["Sensors/XI-000002"]
        sensor["Accelerometer"][50:60, 1] = np.nan
        sensor["Time"][200:] += 100_000
    got = read(path, 64, sensor="XI-000002")
    kept = np.r_[0:50, 60:ROWS]
    times = even_times(ROWS, RATE_HZ)
    times[200:] += 100_000
    assert (got.g == counts()[kept] / 256).all()
    assert (got.times == times[kept]).all()
    assert got.breaks == [50, 190]
    assert [(item.code, item.sample, item.count) for item in got.problems] == [
        ("missing_value", 50, 10),
        ("clock_gap", 190, 1),
    ]


@pytest.mark.parametrize("gone", ["Time", "Accelerometer"])
def test_a_sensor_without_times_or_acceleration_is_refused(path: Path, gone: str) -> None:
    with h5py.File(path, "a") as file:
        del file[f"Sensors/XI-000001/{gone}"], file[f"Sensors/XI-000002/{gone}"]
    with pytest.raises(UnreadableError, match=r"missing|no sensor"):
        read(path, sensor="XI-000001")


@pytest.mark.parametrize(("name", "width"), [("Accelerometer", 1), ("Time", 3)])
def test_a_dataset_with_too_few_or_too_many_columns_is_refused(path: Path, name: str, width: int) -> None:
    """Such a dataset was once taken, and reading failed midway."""
    with h5py.File(path, "a") as file:
        group = file["Sensors/XI-000002"]
        values = np.repeat(group["Time"][:].astype(np.int64)[:, None], width, axis=1)
        del group[name]
        group.create_dataset(name, data=values if width > 1 else values[:, 0] % 7)
    with pytest.raises(UnreadableError, match="one row of"):
        read(path, sensor="XI-000002")


@pytest.mark.parametrize("gone", ["Gyroscope", "Temperature", "Configuration"])
def test_what_is_not_needed_may_be_absent(path: Path, gone: str) -> None:
    with h5py.File(path, "a") as file:
        del file[f"Sensors/XI-000002/{gone}"]
    got = read(path, sensor="XI-000002")
    assert (got.g == counts() / 256).all()
    assert got.recording.rate_hz == RATE_HZ


@pytest.mark.nightly
@every_byte
def test_cut_anywhere_it_gives_true_rows_or_our_error(
    path: Path, capfd: pytest.CaptureFixture[str], step: int
) -> None:
    data = path.read_bytes()
    whole = dict(zip(even_times(ROWS, RATE_HZ).tolist(), (counts() / 256).tolist(), strict=True))
    for size in (*cuts(data[:2048], step, 1), *range(2048, len(data), 97 * step)):
        path.write_bytes(data[:size])
        try:
            got = read(path, sensor="XI-000002")
        except AccelcalError as error:
            assert str(path) in str(error)
            continue
        assert all(whole[time] == row for time, row in zip(got.times.tolist(), got.g.tolist(), strict=True))
        assert got.codes[-1] == "truncated"
    assert capfd.readouterr() == ("", "")


def test_a_real_file_gives_the_values_that_h5py_gives(real_data: Path) -> None:
    path = real_data / "vendor" / "apdm_opal.h5"
    if not path.exists():
        pytest.skip("no real Opal file")
    with h5py.File(path) as file:
        sensor = file["Sensors/XI-012367"]
        accel = np.rint(sensor["Accelerometer"][:] / GRAVITY * GRID)
        turns = np.rint(np.rad2deg(sensor["Gyroscope"][:]) * 65_536)
        warm, times = np.rint(sensor["Temperature"][:] * 1000), sensor["Time"][:]
    got = read(path, 5_000, sensor="left wrist")
    assert (got.counts == accel).all()
    assert (got.times == times).all()
    assert got.temperature is not None
    assert (got.temperature == warm).all()
    assert got.gyro is not None
    assert np.abs(got.gyro - turns).max() <= 1
    assert (got.recording.rate_hz, got.breaks, got.problems) == (128.0, [], [])
    assert got.same_as(read(path, 777, sensor="XI-012367"))
