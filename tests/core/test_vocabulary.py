"""Units by their names, however these are punctuated, and the names of sensors."""

from __future__ import annotations

from fractions import Fraction
from math import pi

import pytest

from accelcal_cli.core.vocabulary import (
    ACCELERATION_UNITS,
    ACCELEROMETER,
    GIVE_UNIT,
    GYROSCOPE,
    NOT_RAW,
    PER_G,
    TIMES,
    UNIT_CHOICES,
    UNITS,
    Quantity,
    acceleration_unit,
    find_unit,
    normalized,
    unit_of,
)


def test_units_of_acceleration() -> None:
    assert ACCELERATION_UNITS["m/s2"].per_g == Fraction("9.80665")
    assert ACCELERATION_UNITS["cm/s2"].per_g == Fraction("980.665")
    assert PER_G == {
        "g": 1.0,
        "mg": 1000.0,
        "m/s2": 9.80665,
        "cm/s2": 980.665,
        "mm/s2": 9806.65,
        "ft/s2": 32.17404855643045,
    }


def test_people_are_asked_for_the_usual_units_alone() -> None:
    assert UNIT_CHOICES == ("g", "mg", "m/s2", "counts")
    assert GIVE_UNIT == "give --unit g, mg or m/s2, or --unit counts with --lsb-per-g"


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("g", "g"), ("[G]", "g"), (" gravities ", "g"), ("mg", "mg"), ("milli-g", "mg"), ("m/s^2", "m/s2"),
        ("m/s²", "m/s2"), ("(m/s/s)", "m/s2"), ("m s-2", "m/s2"), ("m/(s^2)", "m/s2"), ("m/sec^2", "m/s2"),
        ("Meters per Second squared", "m/s2"), ("cm/s^2", "cm/s2"), ("Gal", "cm/s2"), ("mm/s2", "mm/s2"),
        ("ft/s^2", "ft/s2"), ("counts", "counts"), ("LSB", "counts"), ("raw", "counts"), ("deg/s", None),
        ("mT", None), ("V", None), ("s", None), ("", None), ("x", None),
    ],
)  # fmt: skip
def test_names_of_units_of_acceleration(name: str, unit: str | None) -> None:
    assert acceleration_unit(name) == unit


@pytest.mark.parametrize(
    ("name", "quantity", "unit", "per"),
    [
        ("deg/s", Quantity.ROTATION, "deg/s", 1.0), ("°/s", Quantity.ROTATION, "deg/s", 1.0),
        ("dps", Quantity.ROTATION, "deg/s", 1.0), ("mdeg/s", Quantity.ROTATION, "deg/s", 1000.0),
        ("rad/s", Quantity.ROTATION, "deg/s", pi / 180), ("rad_s", Quantity.ROTATION, "deg/s", pi / 180),
        ("degC", Quantity.TEMPERATURE, "C", 1.0), ("°C", Quantity.TEMPERATURE, "C", 1.0),
        ("mdegC", Quantity.TEMPERATURE, "C", 1000.0), ("K", Quantity.TEMPERATURE, "k", 1.0),
        ("°F", Quantity.TEMPERATURE, "°f", 1.0), ("s", Quantity.TIME, "s", 1.0),
        ("msec", Quantity.TIME, "ms", 1e3), ("µs", Quantity.TIME, "us", 1e6),
        ("\u03bcs", Quantity.TIME, "us", 1e6), ("nanoseconds", Quantity.TIME, "ns", 1e9),
        ("uT", Quantity.OTHER, "ut", 1.0), ("Gauss", Quantity.OTHER, "gauss", 1.0),
        ("V", Quantity.OTHER, "v", 1.0), ("mV", Quantity.OTHER, "mv", 1.0),
        ("rad/s2", Quantity.OTHER, "rad/s2", 1.0), ("m/s", Quantity.OTHER, "m/s", 1.0),
        ("%", Quantity.OTHER, "%", 1.0), ("lux", Quantity.OTHER, "lux", 1.0),
    ],
)  # fmt: skip
def test_a_unit_has_a_quantity(name: str, quantity: Quantity, unit: str, per: float) -> None:
    found = unit_of(name, quantity)
    assert found is not None and (found.quantity, found.name, found.per) == (quantity, unit, per)
    assert all(unit_of(name, other) is None for other in Quantity if other is not quantity)


def test_what_is_no_unit() -> None:
    assert [find_unit(text) for text in ("", "[]", "x", "axis", "left wrist", "m/s2x", "!?")] == [None] * 7


def test_every_name_of_a_unit_is_found_in_any_case_and_in_brackets() -> None:
    for name, unit in UNITS.items():
        assert find_unit(name) == find_unit(f" [{name}]") == unit
        loud = find_unit(name.upper())  # the sign of micro becomes a Greek letter
        assert loud is not None and (loud.quantity, loud.per) == (unit.quantity, unit.per)


def test_names_have_any_case_and_punctuation() -> None:
    assert normalized("Sample_Rate [Hz]") == "sampleratehz"
    assert normalized("Accélération (X)") == "accélérationx"


def test_words_of_sensors_mean_one_thing_each() -> None:
    assert {"acc", "accel", "acceleration", "accelerometer"} <= ACCELEROMETER
    assert {"gyr", "gyro", "gyroscope", "omega"} <= GYROSCOPE
    assert {"time", "timestamp", "datetime", "epoch"} <= TIMES
    kinds = (ACCELEROMETER, GYROSCOPE, TIMES, NOT_RAW)
    assert sum(map(len, kinds)) == len(frozenset().union(*kinds))
