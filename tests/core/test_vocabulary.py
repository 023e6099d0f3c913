"""Units and names of sensors: what each kind of file understands."""

from __future__ import annotations

from fractions import Fraction

import pytest

from accelcal_cli.core.vocabulary import (
    ACCELERATION_UNITS,
    AXES,
    CSV,
    EDF,
    GIVE_UNIT,
    PER_G,
    TABLES,
    UNISENS,
    UNIT_AT_END,
    UNIT_CHOICES,
    Vocabulary,
    normalized,
)


def test_units_of_acceleration() -> None:
    assert ACCELERATION_UNITS["m/s2"].per_g == Fraction("9.80665")
    assert PER_G == {"g": 1.0, "mg": 1000.0, "m/s2": 9.80665}
    assert UNIT_CHOICES == ("g", "mg", "m/s2", "counts")
    assert GIVE_UNIT == "give --unit g, mg or m/s2, or --unit counts with --lsb-per-g"


@pytest.mark.parametrize("files", [CSV, TABLES, EDF, UNISENS], ids=["csv", "tables", "edf", "unisens"])
@pytest.mark.parametrize(("name", "unit"), [("g", "g"), ("mg", "mg"), ("m/s^2", "m/s2"), ("m/s²", "m/s2")])
def test_all_files_understand_the_usual_names(name: str, unit: str, files: Vocabulary) -> None:
    assert files.accelerations[normalized(name) if files is TABLES else name] == unit


def test_files_differ_in_what_they_understand() -> None:
    assert CSV.accelerations["counts"] == "counts"
    assert "counts" not in EDF.accelerations
    assert EDF.accelerations["m/sec^2"] == "m/s2"
    assert "m/sec^2" not in CSV.accelerations
    assert UNISENS.accelerometer == {"acc"}
    assert AXES.accelerometer == {"", "a", "acc", "accel", "acceleration", "accelerometer"}


def test_names_in_tables_have_any_case_and_punctuation() -> None:
    assert normalized("Sample_Rate [Hz]") == "sampleratehz"
    assert TABLES.accelerations[normalized("Meters per Second squared")] == "m/s2"
    assert TABLES.rotations[normalized("mdeg/s")] == 1000.0


@pytest.mark.parametrize(
    ("name", "plain", "unit"), [("acc_x_mg", "acc_x", "mg"), ("ax_m/s^2", "ax", "m/s^2")]
)
def test_the_unit_at_the_end_of_a_name(name: str, plain: str, unit: str) -> None:
    found = UNIT_AT_END.fullmatch(name)
    assert found is not None and found.groups() == (plain, unit)
