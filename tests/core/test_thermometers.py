"""T9: columns of temperatures by `core/vocabulary.py`, in the unit that their head or their values show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.vocabulary import CELSIUS, FAHRENHEIT, KELVIN, MILLI, find_thermometer, unit_by_values
from accelcal_cli.formats import open_recording
from tests.formats.make_csv import read, written

ROWS = 500
HEAT = 28 + np.linspace(0, 4, ROWS)


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("T", None), ("temp", None), ("Temperature_degC", CELSIUS), ("device_temp", None), ("die_temp", None),
        ("Temperatur", None), ("tmp", None), ("TempC", CELSIUS), ("temp [K]", KELVIN),
        ("Temp (F)", FAHRENHEIT),
        ("sensor temperature_f", FAHRENHEIT),
        ("temperature_mc", MILLI), ("chipTemp_C", CELSIUS),
        ("T_degC", CELSIUS),
    ],
)  # fmt: skip
def test_t9_names_of_a_thermometer(name: str, unit: object) -> None:
    found, others = find_thermometer([("x", None), (name, None)])
    assert found is not None and (found.number, found.unit, others) == (1, unit, ())


@pytest.mark.parametrize("name", ["skin_temp", "Temp ambient", "temp_raw", "thermistor", "temp [V]"])
def test_t9_what_looks_like_one_is_told(name: str) -> None:
    assert find_thermometer([("x", None), (name, None)]) == (None, (1,))


@pytest.mark.parametrize("name", ["t", "time", "attempt", "temple", "tempo", "template", "x", ""])
def test_t9_other_names_are_none(name: str) -> None:
    assert find_thermometer([(name, None)]) == (None, ())


def test_t9_values_tell_the_unit_where_only_one_is_possible() -> None:
    for unit, values in ((CELSIUS, HEAT), (KELVIN, HEAT + 273.15), (FAHRENHEIT, HEAT * 1.8 + 32)):
        assert unit_by_values(values) == unit
        assert np.allclose(unit.celsius(values), HEAT)
    assert unit_by_values(np.arange(250, 350)) is None, "raw counts"
    assert unit_by_values(np.full(5, np.nan)) is None and unit_by_values(HEAT + 5000) is None


@pytest.mark.parametrize(
    ("name", "values"),
    [("T", HEAT), ("device_temp", HEAT + 273.15), ("Temp_F", HEAT * 1.8 + 32), ("Temperature_degC", HEAT)],
)
@pytest.mark.parametrize("epoch", [False, True])
def test_t9_a_csv_has_its_temperature(tmp_path: Path, name: str, values: np.ndarray, epoch: bool) -> None:
    start = np.datetime64("2024-03-04T10:00:00.000")
    times = [
        f"{1_709_546_400 + row / 25:.3f}" if epoch else str(start + np.timedelta64(40 * row, "ms"))
        for row in range(ROWS)
    ]
    rows = (f"{time},0.01,0.02,0.99,{heat:.3f}" for time, heat in zip(times, values, strict=True))
    found = read(written(tmp_path, "\n".join([f"time,x,y,z,{name}", *rows, ""])))
    assert found.temperature is not None
    assert np.abs(found.temperature / 1000 - HEAT).max() < 0.002


@pytest.mark.parametrize(
    ("name", "values"), [("T", HEAT), ("die_temp", HEAT + 273.15), ("temp_f", HEAT * 1.8 + 32), ("t_x", None)]
)
def test_t9_a_table_has_its_temperature(tmp_path: Path, name: str, values: np.ndarray | None) -> None:
    xyz = np.tile([0.01, 0.02, 0.99], (ROWS, 1))
    columns = {name: HEAT if values is None else values, "time": 1_709_546_400 + np.arange(ROWS) / 25}
    np.savez(tmp_path / "a.npz", acc=xyz, **columns)
    with open_recording(tmp_path / "a.npz", ReadOptions()) as reader:
        (chunk,) = reader.chunks(10_000)
        assert (chunk.temperature_mc is None) == (values is None)
        if chunk.temperature_mc is not None:
            assert np.abs(chunk.temperature_mc / 1000 - HEAT).max() < 0.002


def test_t9_a_column_that_is_not_read_is_said(tmp_path: Path) -> None:
    rows = "".join(f"{1_709_546_400 + row / 25:.2f},0.01,0.02,0.99,30.5\n" for row in range(ROWS))
    found = read(written(tmp_path, "time,x,y,z,skin_temp\n" + rows))
    assert found.temperature is None
    assert "not read, though it looks like a temperature: column 4 ('skin_temp')" in found.recording.notes
