"""Recordings in memory have names and serial numbers, so that one does not take the place of another."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import accelcal
from tests.test_python_memory import FRAME, START, XYZ

OTHER = FRAME.assign(x=FRAME["x"] + 0.01)
SOURCES: dict[str, tuple[Any, dict[str, Any]]] = {
    "array": (XYZ, {"rate": 25, "start": START}),
    "frame": (FRAME, {}),
    "polars": (pl.from_pandas(FRAME), {}),
    "columns": ({name: FRAME[name].to_numpy() for name in FRAME}, {}),
    "zoned": (FRAME.assign(time=FRAME["time"].dt.tz_localize("Asia/Kolkata")).to_dict("series"), {}),
}


@pytest.mark.parametrize("kind", SOURCES)
def test_a_name_and_a_serial_number_are_in_the_results(kind: str, tmp_path: Path) -> None:
    source, options = SOURCES[kind]
    result = accelcal.calibrate(source, name="P001", serial="0042", **options)
    about = result["recording"]
    assert (about["path"], about["device"]["serial"]) == ("P001", "0042")
    parquet, report = result.write(tmp_path)
    assert parquet is not None and [one.name for one in (parquet, report)] == [
        "P001.calibrated.parquet", "P001.calibration.json",
    ]  # fmt: skip
    plain = accelcal.calibrate(source, **options)
    assert result["calibration"] == plain["calibration"] and plain["recording"]["device"]["serial"] is None
    for call in (accelcal.inspect, accelcal.effect):
        told = call(source, name="P001", **options)["recording"]
        assert told == "P001" or told["path"] == "P001"
    with accelcal.read(source, name="P001", serial="7", **options) as reading:
        assert (str(reading.recording.path), reading.recording.device.serial) == ("P001", "7")


def test_content_of_a_file_has_its_own_serial_number() -> None:
    content = FRAME.to_csv().encode()
    assert accelcal.calibrate(content, name="P001.csv")["recording"]["path"] == "P001.csv"
    for source in (content, "night.cwa"):
        with pytest.raises(accelcal.AccelcalError, match=r"serial can be given to .*: a file has its own"):
            accelcal.calibrate(source, serial="1")
    with pytest.raises(accelcal.AccelcalError, match="name can be given to what is in memory"):
        accelcal.calibrate("night.cwa", name="P001")


WRONG = {"name": ["", "a/b", "..", "-", "a\\b", "x" * 101, "a\nb", "*.csv", 3], "serial": [42, 4.2, ["A1"]]}


@pytest.mark.parametrize(("option", "value"), [(one, value) for one in WRONG for value in WRONG[one]])
def test_a_name_is_that_of_a_file_and_a_serial_number_is_text(option: str, value: Any) -> None:
    with pytest.raises(accelcal.AccelcalError, match=rf"{option} cannot be .*; give (a short|it as text)"):
        accelcal.calibrate(FRAME, **{option: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("other", [OTHER, OTHER[:-1], FRAME.assign(temperature=20.0)])
def test_a_second_recording_never_takes_the_place_of_the_first(other: Any, tmp_path: Path) -> None:
    first, second = accelcal.calibrate(FRAME), accelcal.calibrate(other)
    parquet, report = first.write(tmp_path)
    before = report.read_bytes()
    assert first.write(tmp_path) == (parquet, report) and report.read_bytes() == before
    with pytest.raises(accelcal.AccelcalError, match=r"another recording \(frame\); give each .*name='P001'"):
        second.write(tmp_path)
    assert report.read_bytes() == before
    accelcal.calibrate(FRAME, model="6").write(tmp_path)  # the same recording with other options
    assert accelcal.Calibration(report).model == "6"
    second.write(tmp_path, force=True)
    assert (accelcal.Calibration(report).gain == second.calibration.gain).all()
    named = accelcal.calibrate(other, name="P002")
    assert named.write(tmp_path)[1] == tmp_path / "P002.calibration.json"


@pytest.mark.filterwarnings("ignore:P[123].* temperature is left out")
def test_results_with_names_are_exported_together(tmp_path: Path) -> None:
    results = [accelcal.calibrate(FRAME, name="P1"), accelcal.calibrate(OTHER, name="P2")]
    results.append(accelcal.calibrate(XYZ, rate=25, name="P3"))
    rows = accelcal.export(results, to="ggir").splitlines()
    assert [row.partition(",")[0] for row in rows[1:]] == ["P1", "P2", "P3"]
    folder = Path(accelcal.export(results, to="csv", folder=tmp_path / "out"))
    assert sorted(one.name for one in folder.iterdir()) == ["P1.csv", "P2.csv", "P3.csv"]
    values = np.loadtxt(folder / "P2.csv", delimiter=",", skiprows=1, usecols=(1, 2, 3), max_rows=100)
    assert np.allclose(values, results[1].to_pandas()[[*"xyz"]][:100], atol=1e-6)
    same = [accelcal.calibrate(FRAME), accelcal.calibrate(OTHER)]
    for options in ({"to": "ggir"}, {"to": "csv", "folder": tmp_path / "same"}):
        with pytest.raises(accelcal.AccelcalError, match="2 recordings have the name 'frame'; give each"):
            accelcal.export(same, **options)  # type: ignore[arg-type]
