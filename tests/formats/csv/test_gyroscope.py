"""A gyroscope's columns: which they are, in which unit, and what becomes of rows without."""

from __future__ import annotations

from math import pi
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats.tables import CSV as FORMAT
from tests.formats.make_csv import written

RANDOM = np.random.default_rng(3)
ACCEL = RANDOM.normal((0.1, -0.2, 0.97), 0.02, (60, 3))
RATES = RANDOM.normal(0, 40, (60, 3))
GRID = 1 << 16
"""Counts in 1 deg/s."""


def table(names: str, rates: np.ndarray = RATES, factor: float = 1.0) -> str:
    """Return rows of acceleration in g, and of rotation rates in a unit, `factor` of which are 1 deg/s."""
    rows = np.concatenate([ACCEL, rates * factor], axis=1).tolist()
    return "\n".join([names, *(",".join(map(repr, row)) for row in rows)]) + "\n"


def turns(path: Path, chunk_samples: int = 1000, **options: object) -> tuple[np.ndarray | None, str]:
    """Return all counts of the gyroscope, and the notes on it."""
    with FORMAT.open(path, ReadOptions(rate_hz=50.0, **options)) as reader:  # type: ignore[arg-type]
        chunks = [chunk for chunk in reader.chunks(chunk_samples) if len(chunk)]
        told = " ".join(note for note in reader.recording.notes if "gyroscope" in note)
        if reader.recording.gyro_dps_per_lsb is None:
            assert all(chunk.gyro_counts is None for chunk in chunks)
            return None, told
        assert reader.recording.gyro_dps_per_lsb == (1 / GRID,) * 3 or "lsb_per_dps" in options
        return np.concatenate([chunk.gyro_counts for chunk in chunks]), told


def on_grid(rates: np.ndarray) -> np.ndarray:
    return np.rint(rates * GRID)


@pytest.mark.parametrize(
    ("names", "factor"),
    [
        ("ax,ay,az,gx [deg/s],gy [deg/s],gz [deg/s]", 1.0),
        ("Accel X,Accel Y,Accel Z,Gyro X deg/sec,Gyro Y deg/sec,Gyro Z deg/sec", 1.0),
        ("accX,accY,accZ,gyroRotationX(rad/s),gyroRotationY(rad/s),gyroRotationZ(rad/s)", pi / 180),
        ("gFx,gFy,gFz,wx (rad/s),wy (rad/s),wz (rad/s)", pi / 180),
        ("x,y,z,Angular Velocity X(°/s),Angular Velocity Y(°/s),Angular Velocity Z(°/s)", 1.0),
        ("x,y,z,gyro_x [mdps],gyro_y [mdps],gyro_z [mdps]", 1000.0),
    ],
)
def test_names_and_units(tmp_path: Path, names: str, factor: float) -> None:
    found, told = turns(written(tmp_path, table(names, factor=factor)), unit="g")
    assert found is not None
    assert np.abs(found - on_grid(RATES)).max() <= (0 if factor == 1 else 1)
    assert told == "gyroscope: " + ", ".join(f"column {n} ({names.split(',')[n]!r})" for n in (3, 4, 5))


def test_a_line_of_units_below_the_names(tmp_path: Path) -> None:
    text = table("acc_x,acc_y,acc_z,gyr_z,gyr_y,gyr_x\ng,g,g,rad/s,rad/s,rad/s", factor=pi / 180)
    found, _ = turns(written(tmp_path, text))
    assert found is not None
    assert np.abs(found[:, ::-1] - on_grid(RATES)).max() <= 1


def test_actigraph(tmp_path: Path) -> None:
    """The table of the GT9X's second sensor, whose unit only its maker tells: deg/s."""
    first = (
        "--- Data File Created By ActiGraph Link ActiLife v6.13.3 Firmware v1.7.1 date format M/d/yyyy at 100"
    )
    head = (
        f"{first} Hz  Filter Normal ---\nSerial Number: TAS1D0001\nStart Time 10:54:00\nStart Date 6/7/2012"
    )
    sensors = [f"{sensor} {axis}" for sensor in ("Gyroscope", "Magnetometer") for axis in "XYZ"]
    rows = [
        "Timestamp,"
        + ",".join(f"Accelerometer {axis}" for axis in "XYZ")
        + ",Temperature,"
        + ",".join(sensors)
    ]
    for row, (accel, rates) in enumerate(zip(ACCEL.tolist(), RATES.tolist(), strict=True)):
        cells = (f"2012-06-27T10:54:00.{row:02d}00000", *accel, 25.5, *rates, 3.0, 4.0, 5.0)
        rows.append(",".join(map(str, cells)))
    path = written(tmp_path, head + "\n" + "-" * 50 + "\n" + "\n".join(rows) + "\n")
    with FORMAT.open(path, ReadOptions()) as reader:
        (chunk,) = reader.chunks(1000)
    assert (chunk.gyro_counts == on_grid(RATES)).all()
    assert chunk.temperature_mc is not None and set(chunk.temperature_mc) == {25_500}


def test_a_unit_that_nothing_states_is_asked_for(tmp_path: Path) -> None:
    path = written(tmp_path, table("ax,ay,az,gx,gy,gz"))
    found, told = turns(path, unit="g")
    assert found is None and told.endswith(
        "is not read: its unit is not known, give -R gyro_unit=deg/s or -R gyro_unit=rad/s"
    )
    for unit, factor in (("deg/s", 1.0), ("rad/s", 180 / pi)):
        found, _ = turns(path, unit="g", gyro_unit=unit)
        assert found is not None
        assert np.abs(found - on_grid(RATES * factor)).max() <= 1
    assert turns(path, unit="g", gyro_unit="none") == (None, "the gyroscope is not read (-R gyro_unit=none)")


def test_counts_stay_as_they_are(tmp_path: Path) -> None:
    whole = np.rint(RATES * 16.4).astype(int)
    text = "\n".join(["ax,ay,az,gx,gy,gz", *(f"10,-20,4096,{x},{y},{z}" for x, y, z in whole.tolist())])
    words = {"unit": "counts", "lsb_per_g": 4096.0, "lsb_per_dps": 16.4}
    found, _ = turns(written(tmp_path, text + "\n"), **words)
    assert found is not None and (found == whole).all()
    broken = written(tmp_path, text + "\n1,2,4096,7,8.5,9\n")
    with pytest.raises(UnreadableError, match=r"line 62: 8.5 is not a whole number .*-R gyro_unit=deg/s"):
        turns(broken, **words)


def test_columns_without_names_are_numbered(tmp_path: Path) -> None:
    text = "\n".join(table("").splitlines()[1:]) + "\n"
    words = {"columns": ("0", "1", "2"), "unit": "g"}
    assert turns(written(tmp_path, text), **words) == (None, "")
    found, _ = turns(written(tmp_path, text), **words, gyro_columns=("5", "4", "3"), gyro_unit="deg/s")
    assert found is not None and (found == on_grid(RATES)[:, ::-1]).all()


def test_of_several_sensors_the_one_at_the_place_of_the_acceleration(tmp_path: Path) -> None:
    names = [
        f"{side}_{kind}_{axis}" for side in ("left", "right") for kind in ("acc", "gyro") for axis in "xyz"
    ]
    names = [f"{name}_dps" if "gyro" in name else name for name in names]
    rows = np.concatenate([ACCEL, RATES, ACCEL[::-1], RATES[::-1]], axis=1).tolist()
    text = "\n".join([",".join(names), *(",".join(map(repr, row)) for row in rows)]) + "\n"
    path = written(tmp_path, text)
    for side, right in (("left", RATES), ("right", RATES[::-1])):
        columns = tuple(f"{side}_acc_{axis}" for axis in "xyz")
        found, _ = turns(path, unit="g", columns=columns)
        assert found is not None and (found == on_grid(right)).all()


def test_two_that_fit_are_not_chosen_from(tmp_path: Path) -> None:
    text = table("x,y,z,gyro_x_dps,gyro_y_dps,gyro_z_dps")
    lines = text.splitlines()
    doubled = [lines[0] + "," + lines[0].split(",", 3)[3].replace("gyro", "omega")]
    doubled += [f"{line},1.0,2.0,3.0" for line in lines[1:]]
    path = written(tmp_path, "\n".join(doubled) + "\n")
    found, told = turns(path, unit="g")
    assert found is None and "several groups of columns" in told
    found, _ = turns(path, unit="g", gyro_columns=tuple(f"gyro_{axis}_dps" for axis in "xyz"))
    assert found is not None and (found == on_grid(RATES)).all()


@pytest.mark.parametrize("chunk_samples", [1, 7, 1000])
def test_a_row_without_a_rate_is_left_out(tmp_path: Path, chunk_samples: int) -> None:
    """A turn cannot go on over a row without rates, as in an HDF5 file."""
    names = "x,y,z,gyro_x_dps,gyro_y_dps,gyro_z_dps"
    lines = table(names).splitlines()
    rows = lines[1:] * 4
    rows[100] = rows[100].rsplit(",", 1)[0] + ","
    rows[102] = rows[102].rsplit(",", 1)[0] + ",40000"
    path = written(tmp_path, "\n".join([lines[0], *rows]) + "\n")
    with FORMAT.open(path, ReadOptions(rate_hz=50.0, unit="g")) as reader:
        chunks = list(reader.chunks(chunk_samples))
    gyro = np.concatenate([chunk.gyro_counts for chunk in chunks if chunk.gyro_counts is not None])
    expected = np.delete(np.tile(on_grid(RATES), (4, 1)), [100, 102], axis=0)
    assert (gyro == expected).all()
    problems = [(one.code, one.sample) for chunk in chunks for one in chunk.problems]
    assert problems == [("no_start_time", 0), ("missing_value", 100), ("out_of_range", 101)]
    breaks = [chunk.first_sample + int(row) for chunk in chunks for row in chunk.breaks]
    assert breaks == [100, 101]


@pytest.mark.parametrize(
    "names",
    [
        "x,y,z,gyro_bias_x_dps,gyro_bias_y_dps,gyro_bias_z_dps",
        "x,y,z,mag_x,mag_y,mag_z",
        "x,y,z,gyro_x_dps,gyro_y_dps,gyro_w_dps",
        "x,y,z,gx (g),gy (g),gz (g)",
    ],
)
def test_what_is_none(tmp_path: Path, names: str) -> None:
    found, told = turns(written(tmp_path, table(names)), unit="g")
    assert found is None
    assert told == "" or "its unit is not known" in told
