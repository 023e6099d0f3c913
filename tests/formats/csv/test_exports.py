"""Exports that are folders: one recording, with its start and its gyroscope; the other sensors set aside."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Chunk, Recording, joined
from accelcal_cli.formats import belongs_to, is_export, open_recording
from tests.cli.run import run
from tests.cli.studies import rows, study

Capture = pytest.CaptureFixture[str]
START_NS = 1_709_548_900_123_000_000
ROWS, RATE_HZ = 400, 25
VALUES = np.random.RandomState(1).normal((0.0, 0.0, 9.8), 0.3, (ROWS, 3))
RATES = np.random.RandomState(2).normal(0, 1, (ROWS, 3)).round(4)


def logger(values: np.ndarray, delay_ns: int = 0, rate_hz: float = RATE_HZ) -> str:
    """A file of Sensor Logger, whose axes stand in reverse order."""
    lines = ["time,seconds_elapsed,z,y,x"]
    for row, (x, y, z) in enumerate(values.tolist()):
        since = round(row * 1e9 / rate_hz)
        lines.append(f"{START_NS + delay_ns + since},{since / 1e9:.4f},{z:.4f},{y:.4f},{x:.4f}")
    return "\n".join(lines) + "\n"


def sensor_logger(folder: Path, acc: str = "TotalAcceleration.csv", **more: str) -> Path:
    folder.mkdir(exist_ok=True)
    files = {
        acc: logger(VALUES),
        "Accelerometer.csv": logger(VALUES - [0, 0, 9.8]),
        "Gravity.csv": logger(np.tile([0.0, 0.0, 9.8], (ROWS, 1))),
        "Gyroscope.csv": logger(RATES),
        "Location.csv": "time,seconds_elapsed,speed,altitude,longitude,latitude\n"
        + f"{START_NS},0,1,2,3,4\n" * 30,
        "Metadata.csv": "version,device name,recording time,platform\n3,phone,2024-03-04_10-41-40,android\n",
    }
    for name, text in (files | more).items():
        (folder / name).write_text(text)
    return folder


def phyphox(folder: Path, times: str | None = None) -> Path:
    (folder / "meta").mkdir(parents=True, exist_ok=True)
    for name, title, unit, values in (
        ("Accelerometer", "Acceleration", "m/s^2", VALUES),
        ("Gyroscope", "Gyroscope", "rad/s", RATES),
        ("Linear Acceleration", "Linear Acceleration", "m/s^2", VALUES),
    ):
        lines = [
            ",".join(f'"{one}"' for one in ("Time (s)", *(f"{title} {axis} ({unit})" for axis in "xyz")))
        ]
        for row, cells in enumerate(values.tolist()):
            lines.append(",".join(f"{cell:.9E}" for cell in (row / RATE_HZ, *cells)))
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
    (folder / "meta/device.csv").write_text('property,value\n"version","1.1.11"\n')
    head = '"event","experiment time","system time","system time text"\n'
    start = '"START",0.000000000E0,1.709548900123E9,"2024-03-04 10:41:40.123 UTC+00:00"\n'
    (folder / "meta/time.csv").write_text(head + (start if times is None else times))
    return folder


def polar(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    for kind, unit, scale, delay_ms, values in (
        ("ACC", "mg", 1000 / 9.80665, 0, VALUES),
        ("GYRO", "dps", 180 / np.pi, 15, RATES),
        ("ECG", "uV", 1, 0, RATES),
    ):
        lines = [f"Phone timestamp;sensor timestamp [ns];X [{unit}];Y [{unit}];Z [{unit}]"]
        for row, cells in enumerate(values.tolist()):
            moment = np.datetime64("2024-03-04T10:41:40.123") + np.timedelta64(row * 40 + delay_ms, "ms")
            lines.append(
                f"{moment};{7 * 10**17 + row * 40_000_000};" + ";".join(f"{c * scale:.4f}" for c in cells)
            )
        second = "104140" if kind != "ECG" else "104142"
        (folder / f"Polar_Sense_A1B2C3D4_20240304_{second}_{kind}.txt").write_text("\n".join(lines) + "\n")
    return folder


def empatica(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    counts = np.rint(VALUES / 9.80665 * 64).astype(int)
    head = "1709548900.00,1709548900.00,1709548900.00\n32.000000,32.000000,32.000000\n"
    (folder / "ACC.csv").write_text(head + "".join(f"{x},{y},{z}\n" for x, y, z in counts.tolist()))
    (folder / "TEMP.csv").write_text("1709548900.00\n4.000000\n" + "31.5\n" * 40)
    (folder / "IBI.csv").write_text("1709548900.00, IBI\n1.5,0.8\n")
    (folder / "tags.csv").write_text("")
    return folder


def zipped(folder: Path) -> Path:
    path = folder.with_suffix(".zip")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as made:
        for one in sorted(folder.rglob("*")):
            if one.is_file():
                made.write(one, one.relative_to(folder).as_posix())
    return path


def read(path: Path, options: ReadOptions | None = None) -> tuple[Recording, Chunk]:
    with open_recording(path, options or ReadOptions(), joined=False) as reader:
        return reader.recording, joined(list(reader.chunks(97)))


MAKERS = {
    sensor_logger: "TotalAcceleration.csv",
    phyphox: "Accelerometer.csv",
    polar: "Polar_Sense_A1B2C3D4_20240304_104140_ACC.txt",
    empatica: "ACC.csv",
}


@pytest.mark.parametrize("make", MAKERS)
def test_t5_folder_zip_and_file_are_one_recording_with_its_start(tmp_path: Path, make: object) -> None:
    folder = make(tmp_path / "S01")  # type: ignore[operator]
    main = folder / MAKERS[make]  # type: ignore[index]
    recording, alone = read(main)
    assert is_export(folder)
    start_us = START_NS // 1000 if make is not empatica else 1_709_548_900_000_000
    assert recording.start_us == start_us
    for path in (folder, zipped(folder)):
        found, chunk = read(path)
        assert (found.start_us, found.timezone) == (start_us, recording.timezone)
        assert np.array_equal(chunk.counts, alone.counts)
        assert np.array_equal(chunk.time_us, alone.time_us)
        assert not chunk.problems
        assert (found.path, found.companion) == (path, None), "verify looks for no other file"
    expected = VALUES / 9.80665 if make is not empatica else np.rint(VALUES / 9.80665 * 64) / 64
    np.testing.assert_allclose(alone.counts / recording.lsb_per_g, expected, atol=1e-5)


@pytest.mark.parametrize("make", [sensor_logger, phyphox, polar])
def test_t5_the_gyroscope_of_a_sibling_is_used(tmp_path: Path, make: object) -> None:
    folder = make(tmp_path / "S01")  # type: ignore[operator]
    recording, chunk = read(zipped(folder))
    assert recording.gyro_dps_per_lsb is not None
    assert chunk.gyro_counts is not None
    dps = chunk.gyro_counts * np.array(recording.gyro_dps_per_lsb)
    np.testing.assert_allclose(dps, np.degrees(RATES), atol=0.01)
    assert any(note.startswith("gyroscope: ") for note in recording.notes)
    assert read(folder, ReadOptions(gyro_unit="none"))[0].gyro_dps_per_lsb is None


def test_t5_rates_of_another_clock_are_the_nearest_and_gaps_in_them_are_breaks(tmp_path: Path) -> None:
    rates = np.repeat(RATES, 4, axis=0)
    lines = logger(rates, delay_ns=7_000_000, rate_hz=4 * RATE_HZ).splitlines(keepends=True)
    text = "".join(lines[:600] + lines[1000:])
    folder = sensor_logger(tmp_path / "S01", **{"Gyroscope.csv": text})
    recording, chunk = read(folder)
    assert recording.gyro_dps_per_lsb is not None
    assert chunk.gyro_counts is not None
    dps = chunk.gyro_counts * np.array(recording.gyro_dps_per_lsb)
    times = START_NS // 1000 + np.arange(ROWS) * 40_000
    known = np.array([int(line.split(",")[0]) // 1000 for line in text.splitlines()[1:]])
    values = np.array([line.split(",")[:1:-1] for line in text.splitlines()[1:]], float)
    nearest = np.abs(times[:, None] - known).argmin(axis=1)
    far = np.abs(known[nearest] - times) > 2.5 * 40_000
    np.testing.assert_allclose(dps, np.where(far[:, None], 0, np.degrees(values[nearest])), atol=0.01)
    assert far.sum() > 90
    changes = np.flatnonzero(np.diff(far)) + 1
    assert set(changes) <= set(chunk.breaks.tolist())


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (logger(RATES, delay_ns=60 * 10**9), "it did not begin together with TotalAcceleration.csv"),
        ("time,seconds_elapsed,z,y,x\n", "Gyroscope.csv was not used: "),
    ],
)
def test_a_gyroscope_that_cannot_be_joined_is_named(tmp_path: Path, text: str, words: str) -> None:
    recording, _ = read(sensor_logger(tmp_path / "S01", **{"Gyroscope.csv": text}))
    assert recording.gyro_dps_per_lsb is None
    assert any(words in note for note in recording.notes)


def test_t14_one_accelerometer_of_an_export_is_read_not_two(tmp_path: Path) -> None:
    folder = sensor_logger(tmp_path / "S01", **{"AccelerometerUncalibrated.csv": logger(VALUES * 1.01)})
    main = folder / "TotalAcceleration.csv"
    others = [one for one in folder.iterdir() if one != main]
    assert {belongs_to(one) for one in others} == {main}
    assert belongs_to(main) is None
    main.unlink()
    uncalibrated = folder / "AccelerometerUncalibrated.csv"
    assert {belongs_to(one) for one in folder.iterdir()} == {uncalibrated, None}
    (folder / "P07.csv").write_text("time,x,y,z\n1,2,3,4\n")
    assert belongs_to(folder / "P07.csv") is None, "another recording that lies there"


@pytest.mark.parametrize("make", MAKERS)
def test_t14_a_study_has_one_row_for_an_export(tmp_path: Path, capsys: Capture, make: object) -> None:
    make(tmp_path / "in")  # type: ignore[operator]
    ran = study(capsys, tmp_path / "in", "--report-only")
    (row,) = rows(tmp_path / "out")
    assert row["path"] == MAKERS[make]  # type: ignore[index]
    assert row["outcome"] == "refused", ran.err
    assert "copy it again" not in ran.err


def test_t5_an_empty_tags_file_never_fails_a_study(real_data: Path, tmp_path: Path, capsys: Capture) -> None:
    for name, code in (("18_e4_session", 0), ("e4_session_no_tags", 4)):
        folder = tmp_path / name / "in"
        shutil.copytree(real_data / "cases" / name, folder)
        out = tmp_path / name / "out"
        assert run(capsys, "study", folder, "-d", out, "--report-only").code == code
        assert [row["path"] for row in rows(out)] == ["ACC.csv"]


@pytest.mark.parametrize(
    ("name", "samples", "start_us", "within_us"),
    [
        ("16_sensor_logger_export.zip", 6500, 1_709_548_900_123_000, 0),
        ("17_phyphox_export.zip", 9000, 1_709_548_900_123_000, 100_000),
        ("13_one_gt3x.gt3x.zip", 18_000, None, 0),
        ("15_folder_inside.gt3x", 18_000, None, 0),
    ],
)
def test_t4_t5_cases(real_data: Path, name: str, samples: int, start_us: int | None, within_us: int) -> None:
    recording, chunk = read(real_data / "cases" / name)
    assert len(chunk) == samples
    if start_us is None:
        assert (recording.device.serial, recording.lsb_per_g) == ("TAS1D48140206", 256.0)
    else:
        assert abs((recording.start_us or 0) - start_us) <= within_us
        assert recording.lsb_per_g == FLOAT_LSB_PER_G
    assert not [one for one in chunk.problems if one.lost_bytes]


@pytest.mark.parametrize(
    ("times", "start_us", "pauses"),
    [
        ('"START";0,5E0;1,7095489006E9;""\n', 1_709_548_900_100_000, 0),
        (
            '"START",0,1709548900.1,""\n"PAUSE",5,1709548905.1,""\n"START",5,1709549905.1,""\n',
            1_709_548_900_100_000,
            1,
        ),
        ('"PAUSE",0,1709548900.1,""\n', None, 0),
        ('"START",nan,1e400,""\n', None, 0),
        ("", None, 0),
    ],
)
def test_t5_the_start_of_an_experiment(tmp_path: Path, times: str, start_us: int | None, pauses: int) -> None:
    folder = phyphox(tmp_path / "S01", times)
    if ";" in times:
        file = folder / "meta/time.csv"
        file.write_text('"event";"experiment time";"system time";"text"\n' + times)
    recording, _ = read(folder / "Accelerometer.csv")
    assert recording.start_us == start_us
    assert any("pause" in note for note in recording.notes) == bool(pauses)


def test_a_folder_of_other_tables_is_no_export(tmp_path: Path) -> None:
    (tmp_path / "tags.csv").write_text("")
    (tmp_path / "ACC.csv").write_text("x,y,z\n1,2,3\n")
    (tmp_path / "TotalAcceleration.csv").write_text("t,x,y,z\n1,2,3,4\n")
    (tmp_path / "Gyroscope.csv").write_text("t,x,y,z\n1,2,3,4\n")
    assert not is_export(tmp_path)
