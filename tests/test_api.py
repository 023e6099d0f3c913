"""The package from Python: the same bits as the commands, and nothing written."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import accelcal
from tests.cli.run import run
from tests.cli.studies import NAMES, study_folder
from tests.cli.test_change import jumping
from tests.conftest import ROOT
from tests.recordings import LSB_PER_G, directions, still_counts, write_raw

Capture = pytest.CaptureFixture[str]
SAMPLES = {
    "recording.bin": {},
    "evening.csv.gz": {"latitude": 52.5, "altitude": 40},
    "night.h5": {"model": "6"},
}


def without_provenance(report: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in report.items() if key != "provenance"}


def words(options: dict[str, Any]) -> list[object]:
    return [part for name, value in options.items() for part in (f"--{name.replace('_', '-')}", value)]


@pytest.mark.parametrize(
    "name", ["recording.bin", *(pytest.param(one, marks=pytest.mark.nightly) for one in list(SAMPLES)[1:])]
)
def test_results_are_those_of_the_command(name: str, tmp_path: Path, capsys: Capture) -> None:
    path, options = ROOT / "sample_data" / name, SAMPLES[name]
    beside = sorted(path.parent.iterdir())
    windows = tmp_path / "windows.parquet"
    written = run(capsys, "calibrate", path, "-d", tmp_path, "--json", "--windows", windows, *words(options))
    result = accelcal.calibrate(path, **options)
    assert without_provenance(result.report) == without_provenance(json.loads(written.out))
    (parquet,) = tmp_path.glob("*.calibrated.parquet")
    assert result.to_arrow().equals(pq.read_table(parquet))
    assert result.to_arrow().schema.equals(pq.read_schema(parquet), check_metadata=True)
    table = pd.read_parquet(windows)
    found = result.windows()
    pd.testing.assert_frame_equal(found, table)
    assert accelcal.fit(found, **options)["calibration"] == result.report["calibration"]
    (quality,) = tmp_path.glob("*.quality.json")
    assert result.quality() == json.loads(quality.read_text())
    assert sorted(path.parent.iterdir()) == beside, "nothing is written unless asked"


def test_a_result_says_why_in_codes_with_values_and_in_sentences(tmp_path: Path) -> None:
    write_raw(tmp_path / "few.raw", still_counts(directions(1)))
    result = accelcal.calibrate(tmp_path / "few.raw")
    assert (result.outcome, result.reason) == ("refused", "too_few_orientations")
    assert result.values["orientations"] == 1 < result.values["needed"]
    assert result.message.startswith(accelcal.sentence(accelcal.Reason(result.reason, result.values)))
    assert [{"code": one.code, "values": one.values} for one in result.advice] == result.report["advice"]
    assert all(accelcal.sentence(one).endswith(".") for one in result.advice) and result.advice
    changed = accelcal.calibrate(jumping(tmp_path / "jumps.raw"), report_only=True)
    (caution,) = [one for one in changed.cautions if one.code == "sensor_changed"]
    assert caution.values["kind"] == "step" and "its offsets jump at 2024" in accelcal.sentence(caution)


def test_samples_are_those_of_the_recording(tmp_path: Path) -> None:
    result = accelcal.calibrate(ROOT / "sample_data/recording.bin")
    values = result.to_pandas()
    with accelcal.read(ROOT / "sample_data/recording.bin", chunk_samples=10_000) as reading:
        parts = list(reading)
        assert len(parts) > 10 and len(list(reading)) == len(parts), "it can be read again"
        assert reading.recording.format == "flash"
    assert [part.first_sample for part in parts] == np.cumsum([0, *map(len, parts[:-1])]).tolist()
    assert (np.concatenate([part.time for part in parts]) == values.index.to_numpy()).all()
    raw = np.concatenate([part.xyz for part in parts])
    warmth = np.concatenate([part.temperature for part in parts if part.temperature is not None])
    calibrated = accelcal.apply(result, raw, warmth)
    assert calibrated.dtype == np.float32 and (calibrated == values[["x", "y", "z"]].to_numpy()).all()
    with pytest.raises(accelcal.AccelcalError, match="needs temperatures"):
        accelcal.apply(result.report, raw)
    with pytest.raises(ValueError, match=r"\(2,\)"):
        accelcal.apply(result, [0, 0])


def test_a_calibration_that_follows_a_change_is_applied_along_the_recording(tmp_path: Path) -> None:
    result = accelcal.calibrate(jumping(tmp_path / "jumps.raw"))
    assert result.report["calibration"]["course"] is not None
    values = result.to_pandas()[["x", "y", "z"]].to_numpy()
    parquet, report = result.write(tmp_path / "out")
    assert parquet is not None and pq.read_table(parquet).equals(result.to_arrow())
    for part in accelcal.read(tmp_path / "jumps.raw", chunk_samples=9_000):
        rows = slice(part.first_sample, part.first_sample + len(part))
        assert (accelcal.apply(report, part.xyz, first_sample=part.first_sample) == values[rows]).all()


@pytest.mark.parametrize("name", ["two", "two.zip", "two/*.csv"])
def test_several_recordings_are_one_only_if_the_caller_says_so(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As for the commands: files of two people are not joined in silence."""
    monkeypatch.chdir(tmp_path)
    Path("two").mkdir()
    xyz = still_counts(directions(30), seed=1) / LSB_PER_G
    for day, who in enumerate(("anna", "bert")):
        times = pd.date_range("2024-03-04", periods=len(xyz), freq="40ms") + pd.Timedelta(days=day)
        pd.DataFrame(xyz, times, list("xyz")).to_csv(f"two/{who}.csv", index_label="time")
    shutil.make_archive("two", "zip", "two")
    for call in (accelcal.calibrate, accelcal.inspect, accelcal.effect, accelcal.read):
        with pytest.raises(accelcal.AccelcalError, match=r"is a folder|anna\.csv and bert\.csv") as refused:
            call(name)
        assert "parts=True" in str(refused.value)
    assert len(accelcal.calibrate(name, parts=True).to_arrow()) == 2 * len(xyz)
    with accelcal.read(name, parts=True) as reading:
        assert len(reading.to_pandas()) == 2 * len(xyz)
    assert accelcal.inspect(name, parts=True)["recording"]["notes"] and accelcal.effect(name, parts=True)
    table = accelcal.study(".", "out", include=["*.zip"], jobs=1, report_only=True)
    assert "holds 2 recordings" in table["message"][0]


def test_points_may_be_in_any_table(tmp_path: Path) -> None:
    windows = accelcal.calibrate(ROOT / "sample_data/evening.csv.gz").windows()
    means = windows[["x", "y", "z"]]
    means.to_csv(tmp_path / "points.csv", index=False)
    expected = accelcal.fit(tmp_path / "points.csv")
    assert expected.outcome == "calibrated"
    for table in (means, pa.Table.from_pandas(means), means.to_dict("list"), means.to_numpy()):
        found = accelcal.fit(table)
        assert found["calibration"]["fixed_point"] == expected["calibration"]["fixed_point"]
        assert found["holdout"] == expected["holdout"]
    with pytest.raises(accelcal.AccelcalError, match="has no column z"):
        accelcal.fit(means[["x", "y"]])


@pytest.mark.parametrize("given", [False, True], ids=["its own", "of a report"])
def test_the_effect_is_that_of_the_commands(given: bool, tmp_path: Path, capsys: Capture) -> None:
    path, command = tmp_path / "in" / "recording.bin", ["calibrate"]
    path.parent.mkdir()
    shutil.copy(ROOT / "sample_data/recording.bin", path)  # without the truth
    if given:
        _, report = accelcal.calibrate(path, report_only=True).write(tmp_path)
        command = ["apply", "--coefficients", str(report)]
        found = accelcal.effect(path, coefficients=report)
        with pytest.raises(accelcal.AccelcalError, match="min_distance_g is for the recording's own"):
            accelcal.effect(path, coefficients=report, min_distance_g=0.1)
    else:
        command += ["--model", "6", "--stillness", "range", "--stillness-axis", "y"]
        found = accelcal.effect(path, model="6", stillness="range", stillness_axis="y")
    assert found["effect"]["versions"]["raw"]["enmo_mg"] > 0
    made = {"recording.calibration.json", "recording.quality.json"}
    assert {one.name for one in tmp_path.iterdir()} == {"in", *(made if given else ())}
    assert list(path.parent.iterdir()) == [path], "nothing is written"
    out = tmp_path / "out"
    told = json.loads(run(capsys, *command, path, "--effect", "--report-only", "--json", "-d", out).out)
    assert (found["effect"], found["outcome"]) == (told["effect"], told["outcome"])
    assert accelcal.effect(path, epoch=60)["effect"]["epoch_s"] == 60


@pytest.mark.parametrize(
    ("options", "kind", "text"),
    [
        ({"epoch": 0}, accelcal.AccelcalError, "epoch cannot be 0; possible: 1 to 3600"),
        ({"epoch": 2.5}, TypeError, "epoch cannot be 2.5"),
        ({"any_device": True}, accelcal.AccelcalError, "any_device is for coefficients only"),
        ({"stillness_axis": "w"}, accelcal.AccelcalError, "possible: x, y, z"),
        ({"stillness_axis": "y"}, accelcal.AccelcalError, "does not look at one axis"),
    ],
)
def test_an_effect_that_cannot_be_asked_for(
    options: dict[str, Any], kind: type[Exception], text: str
) -> None:
    with pytest.raises(kind) as raised:
        accelcal.effect(ROOT / "sample_data/recording.bin", **options)
    assert text in str(raised.value)


def test_a_study_is_that_of_the_command(tmp_path: Path, capsys: Capture) -> None:
    folder = study_folder(tmp_path / "in", NAMES[:2])
    table = accelcal.study(folder, tmp_path / "one", jobs=1, report_only=True)
    run(capsys, "study", folder, "-d", tmp_path / "two", "-j", 1, "--report-only", "-q")
    with (tmp_path / "two/study.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert table["path"].tolist() == [row["path"] for row in rows]
    assert table["outcome"].tolist() == [row["outcome"] for row in rows]
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("options", "kind", "text"),
    [
        ({"latitud": 5}, TypeError, "did you mean 'latitude'"),
        ({"latitude": "x"}, TypeError, "latitude cannot be 'x'"),
        ({"latitude": 91}, accelcal.AccelcalError, "latitude cannot be 91; possible: -90 to 90"),
        ({"profile": "best"}, accelcal.AccelcalError, "possible: default, paper"),
        ({"segment_seconds": 0}, accelcal.AccelcalError, "segment_seconds cannot be 0"),
        ({"altitude": 5}, accelcal.AccelcalError, "altitude needs latitude too"),
        ({"rate": 50}, accelcal.AccelcalError, "rate"),
    ],
)
def test_options_that_cannot_be_are_refused(
    options: dict[str, Any], kind: type[Exception], text: str
) -> None:
    with pytest.raises(kind) as raised:
        accelcal.calibrate(ROOT / "sample_data/recording.bin", **options)
    assert text in str(raised.value)


def test_a_refusal_has_a_report_and_no_values(tmp_path: Path) -> None:
    path = tmp_path / "short.csv"
    path.write_text("time,x,y,z\n" + "".join(f"2024-03-04T00:00:{n:02d},0,0,1\n" for n in range(60)))
    result = accelcal.calibrate(path)
    assert result.outcome == "refused" and result.message == result.report["message"]
    with pytest.raises(accelcal.AccelcalError, match="refused"):
        result.to_arrow()
    with pytest.raises(accelcal.AccelcalError, match="nothing to apply"):
        accelcal.apply(result, np.zeros((1, 3)))
    settings = accelcal.calibrate(path, profile="paper", stillness_axis="y", max_subset_points=1).report[
        "settings"
    ]
    assert (settings["stillness_axes"], settings["min_subset_points"]) == ([1], 1)


def test_a_plot_shows_both(tmp_path: Path) -> None:
    mpl.use("Agg")
    axes = accelcal.calibrate(ROOT / "sample_data/night.h5").plot()
    before, after = (np.abs(np.asarray(line.get_ydata()) - 1).mean() for line in axes.lines[:2])
    assert before > 5 * after
    axes.figure.savefig(tmp_path / "plot.png")


def test_the_package_is_imported_without_its_api() -> None:
    text = "import sys, accelcal as a; assert not {'numpy', 'click'} & {*sys.modules} and 'study' in dir(a)"
    subprocess.run([sys.executable, "-c", text], check=True, cwd=ROOT)


def test_no_module_has_the_name_of_a_function() -> None:
    """Importing such a module would put it in the place of the function."""
    modules = {one.stem for one in Path(accelcal.__file__).parent.iterdir()}
    assert modules & set(accelcal.__all__) == set()
