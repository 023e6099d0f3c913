"""The second sensor (IMU) of the GT9X, by the vendor's documents."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from tests.formats.gt3x.reading import opened, random_counts, whole
from tests.formats.make_gt3x import (
    ASLEEP,
    AWAKE,
    SENSOR_DATA,
    SENSOR_SCHEMA,
    START_S,
    START_US,
    encoded,
    event,
    info,
    parameters,
    record,
    seconds,
    written,
)

COLUMNS = [f"Accelerometer {axis}" for axis in "XYZ"] + ["Temperature"]
COLUMNS += [f"{name} {axis}" for name in ("Gyroscope", "Magnetometer") for axis in "XYZ"]
SCALES = [2048.0] * 3 + [333.87] + [16.384] * 3 + [6.827] * 3
BIG_ENDIAN, SIGNED = 1, 2
VALUES = np.random.default_rng(1).integers(-32768, 32768, (1000, 10)).astype(np.int16)
MAIN = seconds(random_counts(300), 30)


def schema(columns: int = 10, samples: int = 0, number: int = 1) -> bytes:
    """16-bit columns one after the other, and a last byte that nothing names."""
    parts = [struct.pack("<HHH", number, columns + 1, samples)]
    for k, (label, scale) in enumerate(zip(COLUMNS[:columns], SCALES[:columns], strict=True)):
        flags = SIGNED | (0 if label.startswith("Magnet") else BIG_ENDIAN)
        parts.append(struct.pack("<BBBI16s", flags, 16 * k, 16, encoded(scale), label.ljust(16).encode()))
    parts.append(struct.pack("<BBBI16s", 0, 16 * columns, 8, 0, b" " * 16))
    return record(SENSOR_SCHEMA, START_S, b"".join(parts))


def data(second: int, values: np.ndarray, number: int = 1) -> bytes:
    rows = b"".join(
        row[:7].astype(">i2").tobytes() + row[7:].astype("<i2").tobytes() + b"\7" for row in values
    )
    return record(SENSOR_DATA, second, struct.pack("<H", number) + rows)


def log(lengths: list[int]) -> list[bytes]:
    """Seconds of the IMU, of so many samples each, among those of the main accelerometer at 30 Hz."""
    edges = np.cumsum([0, *lengths])
    found = [parameters({(1, 44): 15, (0, 58): encoded(21.0)}), schema()]
    for k, (main, begin, end) in enumerate(zip(MAIN, edges[:-1], edges[1:], strict=False)):
        found += [main, data(START_S + k, VALUES[begin:end])]
    return found


def test_acceleration_rotation_and_temperature(tmp_path: Path) -> None:
    path = written(tmp_path / "a.gt3x", log([100] * 10), info(30))
    recording = opened(path, sensor="imu").recording
    assert (recording.rate_hz, recording.lsb_per_g, recording.range_g) == (100, 2048, 16)
    assert recording.gyro_dps_per_lsb == pytest.approx([1 / 16.384] * 3, rel=1e-6)
    assert recording.has_temperature
    found = whole(path, sensor="imu")
    assert (found.counts == VALUES[:, :3]).all()
    assert (np.concatenate([chunk.gyro_counts for chunk in found.chunks]) == VALUES[:, 4:7]).all()
    warm = np.concatenate([chunk.temperature_mc for chunk in found.chunks])
    np.testing.assert_allclose(warm, 1000 * (VALUES[:, 3] / 333.87 + 21), atol=0.6)
    assert found.times.tolist() == [START_US + 10_000 * k for k in range(1000)]
    assert (found.breaks, found.found) == ([], [])


def test_seconds_of_the_imus_own_clock_hold_more_or_fewer_samples(tmp_path: Path) -> None:
    lengths = [100, 101, 100, 99, 101]
    path = written(tmp_path / "a.gt3x", log(lengths), info(30))
    found = whole(path, 130, sensor="imu")
    assert (found.counts == VALUES[: sum(lengths), :3]).all()
    assert (found.breaks, found.found) == ([], [])
    spread = [START_US + round(1e6 * (k + i / n)) for k, n in enumerate(lengths) for i in range(n)]
    assert np.abs(found.times - spread).max() <= 1
    assert found.same_as(whole(path, 10**6, sensor="imu"))


def test_half_a_second_is_reported(tmp_path: Path) -> None:
    path = written(tmp_path / "a.gt3x", log([100, 50, 100]), info(30))
    found = whole(path, sensor="imu")
    assert found.breaks == [150]
    assert [code for code, *_ in found.found] == ["record_length"]
    assert (found.times[100:150] == START_US + 1_000_000 + 10_000 * np.arange(50)).all()


def test_sleep_of_the_device_is_a_gap_of_the_imu(tmp_path: Path) -> None:
    """Only the main accelerometer is said to repeat its last sample."""
    records = [schema(), data(START_S, VALUES[:100]), event(START_S + 1, ASLEEP), event(START_S + 9, AWAKE)]
    path = written(tmp_path / "a.gt3x", [*records, data(START_S + 9, VALUES[100:200])], info(30))
    found = whole(path, sensor="imu")
    assert (found.counts == VALUES[:200, :3]).all()
    assert (found.breaks, found.found) == ([100], [])


def test_the_main_accelerometer_is_read_unless_the_imu_is_asked_for(tmp_path: Path) -> None:
    path = written(tmp_path / "a.gt3x", log([100] * 10), info(30))
    main = opened(path).recording
    assert (main.rate_hz, main.gyro_dps_per_lsb, main.has_temperature) == (30, None, False)
    assert "--sensor imu" in main.notes[0]
    assert (whole(path).counts == random_counts(300)).all()
    assert opened(path, sensor="accelerometer").recording == main


def test_a_recording_of_the_imu_alone_says_how_to_read_it(tmp_path: Path) -> None:
    path = written(tmp_path / "a.gt3x", [schema(), data(START_S, VALUES[:100])], info(30))
    with pytest.raises(UnreadableError, match="--sensor imu"):
        opened(path)
    assert len(whole(path, sensor="imu").counts) == 100


def test_without_an_imu_there_is_no_such_sensor(tmp_path: Path) -> None:
    path = written(tmp_path / "a.gt3x", MAIN, info(30))
    with pytest.raises(UsageError, match="no second sensor"):
        opened(path, sensor="imu")
    with pytest.raises(UsageError, match="accelerometer, imu"):
        opened(path, sensor="wrist")


@pytest.mark.parametrize("zero_c", [21.0, -12.5, 0.25])
def test_the_parameters_tell_the_temperature_at_zero(tmp_path: Path, zero_c: float) -> None:
    records = [parameters({(0, 58): encoded(zero_c)}), schema(), data(START_S, VALUES[:100])]
    found = whole(written(tmp_path / "a.gt3x", records, info(30)), sensor="imu")
    warm = np.concatenate([chunk.temperature_mc for chunk in found.chunks])
    np.testing.assert_allclose(warm, 1000 * (VALUES[:100, 3] / 333.87 + zero_c), atol=0.6)


def test_only_what_the_schema_names(tmp_path: Path) -> None:
    plain = [schema(3, 50), record(SENSOR_DATA, START_S, struct.pack("<H", 1) + b"\0\1\0\2\0\3\7" * 50)]
    other = data(START_S + 1, VALUES[:100], number=2)
    path = written(tmp_path / "a.gt3x", [*plain, other], info(30))
    recording = opened(path, sensor="imu").recording
    assert (recording.rate_hz, recording.gyro_dps_per_lsb, recording.has_temperature) == (50, None, False)
    assert (whole(path, sensor="imu").counts == [1, 2, 3]).all()
    for damaged in (schema(2), schema(3)[:-1] + b"\0", record(SENSOR_SCHEMA, START_S, b"\1\0\377\377")):
        with pytest.raises(UsageError, match="no second sensor"):
            opened(written(tmp_path / "b.gt3x", [damaged, *plain[1:]], info(30)), sensor="imu")
