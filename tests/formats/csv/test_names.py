"""The grammar of names of columns, on names as people and devices write them."""

from __future__ import annotations

import pytest

from accelcal_cli.core.vocabulary import GYROSCOPE, Quantity
from accelcal_cli.formats.tables.names import is_other_group, name_of
from accelcal_cli.formats.tables.roles import ACCELEROMETERS

ACC, GYRO, OTHER, NONE = "accelerometer", "gyroscope", "another sensor", "no sensor"

NAMES = [
    # name, words, axis, unit, sensor
    ("x", "x", "x", None, NONE),
    (" Z ", "z", "z", None, NONE),
    ("x-axis (g)", "x axis", "x", "g", NONE),
    ("x [mg]", "x", "x", "mg", NONE),
    ("x [raw]", "x", "x", "counts", NONE),
    ("x_raw", "x raw", "x", None, NONE),
    ("ax", "a x", "x", None, ACC),
    ("ax_m/s^2", "a x", "x", "m/s2", ACC),
    ("accX", "acc x", "x", None, ACC),
    ("xacc", "acc x", "x", None, ACC),
    ("acc_x_mg", "acc x", "x", "mg", ACC),
    ("ACC_X_g", "acc x", "x", "g", ACC),
    ("acc_x_m_s2", "acc x", "x", "m/s2", ACC),
    ("acc_x_gal", "acc x", "x", "cm/s2", ACC),
    ("acc_x [cm/s2]", "acc x", "x", "cm/s2", ACC),
    ("Acc_X [ft/s2]", "acc x", "x", "ft/s2", ACC),
    ("acc_x [Gal]", "acc x", "x", "cm/s2", ACC),
    ("acc_x [mm/s2]", "acc x", "x", "mm/s2", ACC),
    ("x [ft/s^2]", "x", "x", "ft/s2", NONE),
    ("accel_y_ms2", "accel y", "y", "m/s2", ACC),
    ("imu_accX [mg]", "imu acc x", "x", "mg", ACC),
    ("left_acc_y", "left acc y", "y", None, ACC),
    ("Accel_WR_Z_CAL", "accel wr z cal", "z", None, ACC),
    ("Accelerometer X (g)", "accelerometer x", "x", "g", ACC),
    ("accelerationZ(G)", "acceleration z", "z", "g", ACC),
    ("Acceleration x (m/s^2)", "acceleration x", "x", "m/s2", ACC),
    ("gFx", "acc x", "x", "g", ACC),
    ("accel", "accel", None, None, ACC),
    ("Linear Acceleration x (m/s^2)", "linear acceleration x", "x", "m/s2", OTHER),
    ("userAcceleration.x", "user acceleration x", "x", None, OTHER),
    ("gravity_x", "gravity x", "x", None, OTHER),
    ("gx", "g x", "x", None, GYRO),
    ("wx (rad/s)", "w x", "x", "deg/s", GYRO),
    ("gyro_x_dps", "gyro x", "x", "deg/s", GYRO),
    ("gyr_z_rad_s", "gyr z", "z", "deg/s", GYRO),
    ("gyroRotationX(rad/s)", "gyro rotation x", "x", "deg/s", GYRO),
    ("Angular Velocity X(°/s)", "angular velocity x", "x", "deg/s", GYRO),
    ("gyro_bias_x", "gyro bias x", "x", None, OTHER),
    ("x (dps)", "x", "x", "deg/s", OTHER),
    ("x [deg/s]", "x", "x", "deg/s", OTHER),
    ("mag_x [G]", "mag x", "x", "g", OTHER),
    ("X [G]", "x", "x", "g", OTHER),
    ("x [uT]", "x", "x", "ut", OTHER),
    ("x [mGauss]", "x", "x", "mgauss", OTHER),
    ("x [mV]", "x", "x", "mv", OTHER),
    ("x_deg", "x", "x", "deg", OTHER),
    ("x y", "x y", None, None, NONE),
    ("x [left wrist]", "x", "x", None, NONE),
    ("light", "light", None, None, NONE),
    ("", "", None, None, NONE),
]


@pytest.mark.parametrize(("text", "words", "axis", "unit", "sensor"), NAMES, ids=[one[0] for one in NAMES])
def test_words_axis_unit_and_sensor(
    text: str, words: str, axis: str | None, unit: str | None, sensor: str
) -> None:
    name = name_of(text)
    assert (name.text, " ".join(name.words), name.axis) == (text, words, axis)
    assert (None if name.unit is None else name.unit.name) == unit
    if sensor == OTHER:
        assert name.is_other and not name.is_gyroscope
    elif sensor == GYRO:
        assert name.is_gyroscope and not name.is_accelerometer
    else:
        assert (name.is_accelerometer, name.is_gyroscope, name.is_other) == (sensor == ACC, False, False)


@pytest.mark.parametrize(
    ("text", "unit_us", "zone"),
    [
        ("Timestamp", None, None),
        ("time_ms", 1e3, None),
        ("time (s)", 1e6, None),
        ("seconds", 1e6, None),
        ("elapsed (s)", 1e6, None),
        ("epoc (ms)", 1e3, None),
        ("unix_ns", 1e-3, None),
        ("t", None, None),
        *(("Timestamp UTC", None, "UTC"), ("timestampUTC", None, "UTC"), ("TimestampUTC", None, "UTC")),
        *(("time (UTC)", None, "UTC"), ("utc_time", None, "UTC"), ("time_gmt", None, "UTC")),
        *(("time (+0100)", None, "+01:00"), ("timestamp (+0530)", None, "+05:30")),
        *(("time [GMT+1]", None, "+01:00"), ("time (Europe/Berlin)", None, "Europe/Berlin")),
        ("local time", None, None),
        ("Date", None, None),
    ],
)
def test_names_of_times(text: str, unit_us: float | None, zone: str | None) -> None:
    name = name_of(text)
    assert name.is_time and name.axis is None and not name.is_accelerometer
    assert (name.time_unit_us, name.zone) == (unit_us, zone)


def test_ticks_have_no_unit() -> None:
    assert (name_of("ticks").ticks, name_of("SampleTimeFine").ticks) == (True, False)
    assert (name_of("SampleTimeFine").fine_ticks, name_of("sample_time_fine").fine_ticks) == (True, True)
    assert not name_of("sample time").fine_ticks


def test_a_unit_that_is_stated_takes_precedence_over_that_of_the_name() -> None:
    name = name_of("acc_x [g]", "m/s^2")
    assert name.unit is not None and (name.stated, name.unit.name) == ("m/s^2", "m/s2")
    name = name_of("acc_x_mg", "g")
    assert (name.words, name.stated) == (("acc", "x", "mg"), "g")


def test_the_words_besides_axis_and_sensor_are_a_place() -> None:
    names = ("left_acc_x", "left_gyro_x", "left_angular_velocity_x [rad/s]", "acc_left_x")
    assert {name_of(name).place for name in names} == {("left",)}
    assert name_of("left_acc_x").stem == ("left", "acc") == name_of("left_acc_raw_z").stem


@pytest.mark.parametrize(
    "text",
    ["Temperature", "light [lux]", "label", "gyro_x", "timestamp", "heart rate", "battery mV", "pitch"],
)
def test_names_of_what_cannot_be_an_axis(text: str) -> None:
    assert name_of(text).is_elsewhere


@pytest.mark.parametrize("text", ["ch1", "sensor_1", "imu_0", "a", "linear_x"])
def test_names_of_what_could_be_an_axis(text: str) -> None:
    assert not name_of(text).is_elsewhere


def test_groups_say_which_sensor_they_hold() -> None:
    for words, groups in (
        (ACCELEROMETERS, ("acc", "Accelerometer", "raw_acc", "Acceleration [g]", "xyz")),
        (GYROSCOPE, ("gyro", "Gyroscope", "angularVelocity")),
    ):
        assert all(name_of(text).is_all(words) for text in groups)
        assert not any(name_of(text).is_all(words) for text in ("left", "sensors", "data", "acc_left"))
    assert all(map(is_other_group, ("Gyroscope", "magnetometer", "angular_velocity", "Orientation", "quat")))
    assert not any(map(is_other_group, ("left", "sensors", "data", "acc_left")))


def test_columns_of_three_numbers_whose_group_tells_what_they_hold() -> None:
    assert all(name_of(text).says_nothing for text in ("data", "values", "xyz", "Raw Data"))
    assert not any(name_of(text).says_nothing for text in ("", "acc", "acc_data", "time"))


def test_other_quantities_have_units_of_their_own() -> None:
    quantities = {
        "x [deg/s]": Quantity.ROTATION,
        "time [ms]": Quantity.TIME,
        "temp_c": Quantity.TEMPERATURE,
        "x [counts]": Quantity.COUNTS,
        "pressure [hPa]": Quantity.OTHER,
    }
    for text, quantity in quantities.items():
        unit = name_of(text).unit
        assert unit is not None and unit.quantity is quantity
