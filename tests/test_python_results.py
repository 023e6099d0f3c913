"""A result is known as such wherever it is given: itself, its frames, its Parquet file, its windows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pyarrow import feather

import accelcal
from tests.conftest import ROOT
from tests.test_python_memory import FRAME, XYZ

RESULT = accelcal.calibrate(FRAME)
FUNCTIONS = [accelcal.calibrate, accelcal.inspect, accelcal.read]


@pytest.mark.parametrize("function", FUNCTIONS)
@pytest.mark.parametrize(
    ("own", "said"),
    [
        (RESULT, r"a Result of accelcal .*\.to_pandas\(\).*to begin again give the raw values$"),
        (accelcal.fit(RESULT), r"a Report of accelcal .* its coefficients are \.calibration"),
        (RESULT.report, r"a report of accelcal .*accelcal\.apply\(report, xyz\)"),
        (RESULT.calibration, r"a Calibration of accelcal .*calibration\(xyz, temperature\)"),
        (accelcal.read(FRAME), r"a Reading of accelcal .*give what was opened, 'frame'"),
    ],
    ids=["result", "fitted", "report", "calibration", "reading"],
)
def test_an_object_of_ours_is_no_recording(function: Any, own: Any, said: str) -> None:
    with pytest.raises(TypeError, match=said):
        function(own)
    if function is accelcal.calibrate and own is not RESULT:
        with pytest.raises(TypeError, match=said):
            accelcal.effect(own)
        with pytest.raises(TypeError, match=said):
            accelcal.fit(own)


def test_a_result_of_a_file_names_it(tmp_path: Path) -> None:
    FRAME.to_parquet(tmp_path / "night.parquet")
    with pytest.raises(TypeError, match=r"to begin again give '.*night\.parquet'"):
        accelcal.calibrate(accelcal.calibrate(tmp_path / "night.parquet"))


@pytest.mark.parametrize("epoch", [5, 60])
def test_the_effect_of_a_result_is_that_of_its_recording(epoch: int) -> None:
    model = accelcal.calibrate(XYZ, rate=25, model="6")
    found = accelcal.effect(model, epoch=epoch)
    assert found == accelcal.effect(XYZ, rate=25, model="6", epoch=epoch)
    assert found["effect"]["versions"]["raw"] != found["effect"]["versions"]["calibrated"]
    for options in ({"model": "6"}, {"parts": True}, {"coefficients": "a.json"}):
        with pytest.raises(accelcal.AccelcalError, match="a result has its own options"):
            accelcal.effect(model, **options)  # type: ignore[arg-type]


def test_a_result_is_fitted_by_its_windows() -> None:
    assert accelcal.fit(RESULT)["calibration"] == RESULT["calibration"]
    for table in (RESULT.windows(), RESULT.windows()[["time", *"xyz"]]):
        with pytest.raises(accelcal.AccelcalError, match="is a table that accelcal wrote, not a recording"):
            accelcal.calibrate(table)


def rewritten(folder: Path) -> Path:
    feather.write_feather(RESULT.to_pandas().reset_index(), str(folder / "values.feather"))
    return folder / "values.feather"


def parquet(folder: Path) -> Path:
    path, _ = RESULT.write(folder)
    assert path is not None
    return path


VALUES = {
    "pandas": lambda _: RESULT.to_pandas(),
    "pandas, time as a column": lambda _: RESULT.to_pandas().reset_index(),
    "pandas, in part": lambda _: RESULT.to_pandas()[[*"xyz"]],
    "arrow": lambda _: RESULT.to_arrow(),
    "xarray": lambda _: pytest.importorskip("xarray") and RESULT.to_xarray(),
    "parquet": parquet,
    "feather that pandas wrote": rewritten,
    "read again": lambda folder: accelcal.read(parquet(folder)).to_pandas(),
}


@pytest.mark.parametrize("kind", VALUES)
def test_calibrated_values_are_known_as_such(kind: str, tmp_path: Path) -> None:
    values = VALUES[kind](tmp_path)
    found = accelcal.calibrate(values)
    assert (found.outcome, found.reason) == ("already_good", "calibrated_before")
    assert "is calibrated already, from frame (calibrated, 0.2 mg held out)" in found.message
    assert accelcal.inspect(values)["prediction"]["reason"] == "calibrated_before"
    with pytest.raises(accelcal.AccelcalError, match=r"calibrated already.*; give the raw recording, frame"):
        accelcal.effect(values)


def test_calibrated_values_are_not_calibrated_again() -> None:
    with pytest.raises(accelcal.AccelcalError, match="calibrated already; give the raw ones"):
        accelcal.apply(RESULT, RESULT.to_pandas()[[*"xyz"]])


def test_a_table_that_has_lost_what_says_so_is_asked_for(tmp_path: Path) -> None:
    plain = pd.read_parquet(parquet(tmp_path)).reset_index()
    assert not plain.attrs
    for values in (RESULT.to_polars(), plain, RESULT.to_arrow().replace_schema_metadata(None)):
        with pytest.raises(accelcal.AccelcalError, match=r"^(frame|table): .*omit the column validity"):
            accelcal.calibrate(values)
    assert accelcal.calibrate(plain.drop(columns="validity")).outcome == "already_good"


def test_raw_values_of_a_reading_or_of_a_refused_recording_are_raw(tmp_path: Path) -> None:
    raw = accelcal.read(FRAME).to_pandas()
    assert accelcal.calibrate(raw)["calibration"] == RESULT["calibration"]
    refused = raw.reset_index().astype(dict.fromkeys("xyz", np.float32))
    refused["validity"] |= 4  # as `--keep-refused` marks rows that are not calibrated
    assert accelcal.calibrate(refused).outcome == "calibrated"


@pytest.mark.parametrize(
    ("name", "seconds"), [("recording.bin", 5), ("evening.csv.gz", 60), ("night.h5", 30)]
)
def test_epochs_are_those_of_the_effect(name: str, seconds: int) -> None:
    """Their means are the figures of the effect, their intervals hold them, and chunks make no difference."""
    result = accelcal.calibrate(ROOT / "sample_data" / name, report_only=True)
    epochs, effect = result.epochs(seconds), accelcal.effect(result, epoch=seconds)["effect"]
    assert len(epochs) == effect["epochs"]
    for figure in ("enmo_mg", "mad_mg"):
        assert epochs[figure].mean() == pytest.approx(effect["versions"]["calibrated"][figure], abs=1e-4)
    for stem, unit in (("enmo", "mg"), ("mad", "mg"), ("angle", "deg")):
        low, own, high = (epochs[f"{stem}{end}_{unit}"] for end in ("_low", "", "_high"))
        assert (low <= own).all() and (own <= high).all() and (low < high).any()
    values = result.to_pandas()
    start = epochs.index[7]
    rows = values[(values.index >= start) & (values.index < start + pd.Timedelta(seconds=seconds))]
    length, mean = np.linalg.norm(rows[[*"xyz"]].astype(float), axis=1), rows[[*"xyz"]].astype(float).mean()
    assert epochs["enmo_mg"].iloc[7] == pytest.approx(1000 * np.maximum(length - 1, 0).mean(), abs=1e-3)
    assert epochs["mad_mg"].iloc[7] == pytest.approx(1000 * np.abs(length - length.mean()).mean(), abs=1e-3)
    angle = np.degrees(np.arctan2(mean["z"], np.hypot(mean["x"], mean["y"])))
    assert epochs["angle_deg"].iloc[7] == pytest.approx(angle, abs=1e-3)
    assert (epochs["samples"].iloc[7], epochs["worn"].dtype) == (len(rows), "boolean")
    if "temperature" in rows:
        assert epochs["temperature_c"].iloc[7] == pytest.approx(rows["temperature"].mean(), abs=0.01)
    result._request = replace(result._request, chunk_samples=777)
    pd.testing.assert_frame_equal(result.epochs(seconds), epochs, check_exact=True)


def test_epochs_have_the_hours_of_wear_and_times_of_the_zone() -> None:
    still = np.random.default_rng(1).normal(0, 1e-3, (540_000, 3)) + XYZ[-1]
    values = np.concatenate([XYZ, still])
    result = accelcal.calibrate(values, rate=25, start="2024-03-04T00:00:00", unit="g", timezone="+01:00")
    epochs = result.epochs(60)
    hours = pd.Series((result.quality() or {})["rows"]["worn"])
    assert epochs["worn"].sum() == 60 * hours.sum() and epochs["worn"].iloc[-1] == hours.iloc[-1]
    assert str(epochs.index[0]) == "2024-03-03 23:00:00+00:00"
    assert str(result.epochs(60, local=True).index[0]) == "2024-03-04 00:00:00+01:00"
    assert accelcal.calibrate(FRAME).epochs().index.tz is None


@pytest.mark.parametrize(
    ("seconds", "kind", "said"),
    [
        (0, accelcal.AccelcalError, "seconds cannot be 0; possible: 1 to 3600"),
        (2.5, TypeError, "seconds cannot be 2.5"),
        (True, TypeError, "seconds cannot be True"),
        (3600, accelcal.AccelcalError, "four fifths of each epoch of 3600 s was measured; give a smaller"),
    ],
)
def test_epochs_have_whole_seconds(seconds: Any, kind: type[Exception], said: str) -> None:
    with pytest.raises(kind, match=said):
        RESULT.epochs(seconds)
    with pytest.raises(accelcal.AccelcalError, match="there are no calibrated values: refused"):
        accelcal.calibrate(XYZ[:500], rate=25).epochs()
