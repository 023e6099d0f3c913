"""`--effect` of `calibrate`, `apply` and `study`, and `accelcal.effect`, which takes other epochs."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import pytest

import accelcal
from tests.cli.run import assert_one_line, exit_code, nightly, run, verify
from tests.recordings import RATE_HZ, directions, good_raw, still_counts, write_csv

SAMPLES = Path(__file__).parents[2] / "sample_data"
UNCERTAIN = ("enmo_mg", "mad_mg", "mvpa_min", "pim_mg_s", "zcm", "angle_deg")
MEASURED = ("enmo_mg", "mad_mg", "mvpa_min", "pim_mg_s", "zcm", "inactive_min")


def effect_of(*words: object, command: str = "calibrate") -> dict[str, Any]:
    """What the command puts into the report, which is written elsewhere."""
    with TemporaryDirectory() as folder:
        ran = run(command, *words, "--effect", "--report-only", "--json", "-q", "-d", folder)
    assert ran.code == 0, ran.err
    found: dict[str, Any] = json.loads(ran.out)["effect"]
    return found


@pytest.fixture(scope="module")
def day(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a simulated day whose true parameters are beside it."""
    path = tmp_path_factory.mktemp("effect") / "day.bin"
    words = ("--rate", "25", "--seed", "11", "--temp-slope", "0.9", "-0.6", "1.2")
    assert exit_code("simulate", path, "--days", "0.5", *words, "-q") == 0
    return path


def test_calibrated_data_show_what_the_true_parameters_would(day: Path) -> None:
    made = accelcal.effect(day)["effect"]["versions"]
    for name in MEASURED:
        assert made["calibrated"][name] == pytest.approx(made["true"][name], rel=1e-3), name
    off = abs(made["raw"]["enmo_mg"] / made["true"]["enmo_mg"] - 1)
    simpler = abs(made["without_misalignment"]["enmo_mg"] / made["true"]["enmo_mg"] - 1)
    assert off > 0.3 and 1e-3 < simpler < off / 5
    assert made["raw"]["enmo_differs_mg"] > 10
    assert made["calibrated"]["enmo_differs_mg"] < 0.05


def test_they_are_the_measures_of_the_parquet_file(day: Path, tmp_path: Path) -> None:
    """ENMO and MAD as the cookbook has them, of the file that `calibrate` writes."""
    assert exit_code("calibrate", day, "-d", tmp_path, "-q") == 0
    table = pd.read_parquet(tmp_path / "day.calibrated.parquet")
    measured = table[table["validity"] == 0]
    length = np.sqrt((measured[["x", "y", "z"]].astype("float64") ** 2).sum(axis=1))
    by = length.groupby(measured["time"].dt.floor("60s").array)
    enmo = 1000 * (length - 1).clip(lower=0).groupby(measured["time"].dt.floor("60s").array).mean()
    mad = 1000 * (length - by.transform("mean")).abs().groupby(measured["time"].dt.floor("60s").array).mean()
    kept = by.size() >= 0.8 * 60 * 25
    found = accelcal.effect(day, epoch=60)["effect"]
    made = found["versions"]["calibrated"]
    assert found["epochs"] == kept.sum()
    assert made["enmo_mg"] == pytest.approx(enmo[kept].mean(), abs=1e-4)
    assert made["mad_mg"] == pytest.approx(mad[kept].mean(), abs=1e-4)
    assert made["mvpa_min"] == (enmo[kept] >= 100).sum()


@pytest.mark.parametrize("name", ["good.raw", *(nightly(name) for name in ("night.h5", "evening.csv.gz"))])
def test_the_length_of_the_chunks_makes_no_difference(name: str, tmp_path: Path) -> None:
    path = good_raw(tmp_path) if name == "good.raw" else SAMPLES / name
    assert effect_of(path, "--chunk-samples", 1009) == effect_of(path)


def test_samples_that_are_no_measurements_are_left_out(tmp_path: Path) -> None:
    """Rows at the sensor's range are counted, and their epoch is short of them."""
    path = good_raw(tmp_path)
    counts = np.fromfile(path, "<i2").reshape(-1, 3)
    counts[250:300, 0] = 2047
    counts.tofile(path)
    found = effect_of(path)
    assert found["left_out"] == {"filled": 0, "clipped": 50, "recovered": 0}
    assert found["short_epochs"] == 1
    assert found["epochs"] == len(counts) / (5 * RATE_HZ) - 1


def test_coefficients_of_a_report_give_what_they_gave_there(tmp_path: Path) -> None:
    path = good_raw(tmp_path)
    assert exit_code("calibrate", path, "--report-only", "-q") == 0
    report = tmp_path / "good.calibration.json"
    given = effect_of(path, "--coefficients", report, command="apply")
    assert given == accelcal.effect(path, coefficients=report)["effect"]
    own = effect_of(path)
    for name in ("ci95", "raw_bias"):
        assert given.pop(name) is None and own.pop(name) is not None
    assert given == own
    other = good_raw(tmp_path, "other.raw")
    words = (other, "--coefficients", report)
    made = effect_of(*words, "--any-device", command="apply")
    assert list(made["versions"]) == ["raw", "without_misalignment", "calibrated"]
    assert run("apply", *words, "--any-device", "--effect", "-q").code == 0
    assert json.loads((tmp_path / "other.calibration.json").read_text())["effect"] == made
    assert verify(tmp_path / "other.calibration.json", other)[0].code == 0


def test_a_refused_recording_has_its_raw_values_only(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "short.csv", np.tile(np.int16([0, 0, 256]), (2000, 1)))
    found = accelcal.effect(path)
    assert found["outcome"] == "refused" and list(found["effect"]["versions"]) == ["raw"]
    assert found["effect"]["versions"]["raw"]["enmo_mg"] == 0.0
    ran = run("calibrate", path, "--effect", "--json")
    assert ran.code == 4 and json.loads(ran.out).get("effect") is None


def test_calibrate_puts_it_into_the_report(tmp_path: Path) -> None:
    path = good_raw(tmp_path)
    report = tmp_path / "good.calibration.json"
    for words in ((), ("--report-only",)):
        assert exit_code("calibrate", path, "--effect", "-q", *words) == 0
        made = json.loads(report.read_text())
        assert made["effect"] == effect_of(path) and made["settings"]["effect"] is True
        assert verify(report, path)[0].code == 0
        assert "up to date" in run("calibrate", path, "--effect", *words).err
    assert exit_code("calibrate", path, "-q") == 0
    assert "effect" not in json.loads(report.read_text())


def test_a_study_has_it_in_its_table(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    path = good_raw(tmp_path / "in")
    assert exit_code("study", tmp_path / "in", "-d", tmp_path / "out", "--effect", "-q", "--jobs", 1) == 0
    row = pd.read_parquet(tmp_path / "out" / "study.parquet").iloc[0]
    made = effect_of(path)["versions"]
    assert row["enmo_raw_mg"] == made["raw"]["enmo_mg"] and row["enmo_mg"] == made["calibrated"]["enmo_mg"]
    assert row["enmo_differs_mg"] == made["raw"]["enmo_differs_mg"]
    assert row["inactive_min"] == made["calibrated"]["inactive_min"]
    intervals = effect_of(path)["ci95"]
    assert [row["enmo_low_mg"], row["enmo_high_mg"]] == intervals["enmo_mg"]
    assert [row["mvpa_low_min"], row["mvpa_high_min"]] == intervals["mvpa_min"]


def by_rows(counts: np.ndarray) -> float:
    """ENMO [mg] of all rows that are not zero, by plain Python."""
    lengths = [sum((one / 256) ** 2 for one in row) ** 0.5 for row in counts.tolist() if any(row)]
    return 1000 * sum(max(0.0, length - 1) for length in lengths) / len(lengths)


@pytest.mark.parametrize("headerless", [False, True])
def test_verdicts_11_zeros_take_no_part_in_means(headerless: bool, tmp_path: Path) -> None:
    """Half of the time the device slept, and its export holds zeros; epochs hold either."""
    counts = still_counts(directions(60)).astype(np.int64)
    counts += (
        np.random.RandomState(2).randint(0, 30, counts.shape)
        * (np.arange(len(counts)) % 3750 > 2000)[:, None]
    )
    counts = np.repeat(counts.reshape(-1, 750, 3), 2, axis=0)
    counts[1::2] = 0
    counts = counts.reshape(-1, 3)
    path = write_csv(tmp_path / "a.csv", counts)
    if headerless:
        rows = [line.split(",", 1)[1] for line in path.read_text().splitlines()[1:]]
        path.write_text("\n".join(rows) + "\n")
    words = ("--rate", RATE_HZ) if headerless else ()
    found = effect_of(path, *words)
    assert found == effect_of(path, *words, "--chunk-samples", 7)
    assert found["left_out"] == {"filled": 45_000, "clipped": 0, "recovered": 0}
    assert found["left_out_percent"] == 50.0
    assert found["versions"]["raw"]["enmo_mg"] == pytest.approx(by_rows(counts), abs=1e-3)


def test_51_1_every_measure_has_an_interval_with_the_truth_in_it(day: Path) -> None:
    found = accelcal.effect(day)["effect"]
    made, intervals, bias = found["versions"], found["ci95"], found["raw_bias"]
    assert tuple(intervals) == tuple(bias) == UNCERTAIN
    for name in UNCERTAIN:
        low, high = intervals[name]
        assert low <= made["calibrated"][name] <= high
        assert low <= made["true"][name] <= high, name
        off = made["raw"][name] - made["calibrated"][name]
        assert bias[name]["value"] == pytest.approx(off, abs=1e-3)
        ends = [made["raw"][name] - high, made["raw"][name] - low]
        assert bias[name]["ci95"] == pytest.approx(ends, abs=1e-3)
    assert 0 < intervals["enmo_mg"][1] - intervals["enmo_mg"][0] < 1


def test_51_1_intervals_are_those_of_the_drawn_coefficients(tmp_path: Path) -> None:
    """By the rows of NAME.draws.json in double precision, without any code of the package."""
    path = good_raw(tmp_path)
    assert exit_code("calibrate", path, "--draws", 39, "--report-only", "-q") == 0
    drawn = json.loads((tmp_path / "good.draws.json").read_text())
    counts = np.fromfile(path, "<i2").reshape(-1, 3) / 256
    enmo, angle = [], []
    for xx, yy, zz, yx, zx, zy, ox, oy, oz, *_ in drawn["draws"]:
        x, y, z = (counts + np.array([ox, oy, oz])).T
        a = np.stack([xx * x, yx * x + yy * y, zx * x + zy * y + zz * z], axis=1)
        enmo.append(1000 * np.maximum(np.sqrt((a**2).sum(axis=1)) - 1, 0).mean())
        x, y, z = a.reshape(-1, round(5 * RATE_HZ), 3).mean(axis=1).T
        angle.append(np.degrees(np.arctan2(z, np.hypot(x, y))).mean())
    found = effect_of(path)
    own = found["versions"]["calibrated"]
    for name, values in (("enmo_mg", enmo), ("angle_deg", angle)):
        ends = [min(*values, own[name]), max(*values, own[name])]
        assert found["ci95"][name] == pytest.approx(ends, abs=2e-3), name


def test_51_1_draws_are_the_same_again_and_begin_alike(tmp_path: Path) -> None:
    path, other = good_raw(tmp_path), good_raw(tmp_path, "other.raw")
    other.write_bytes(path.read_bytes()[: -6 * round(RATE_HZ)])
    held = tmp_path / "good.draws.json"
    assert exit_code("calibrate", path, "--draws", 200, "-q") == 0
    many, first = json.loads(held.read_text()), held.read_bytes()
    assert "up to date" in run("calibrate", path, "--draws", 200).err
    assert exit_code("calibrate", path, "--draws", 200, "--force", "-q", "--chunk-samples", 999) == 0
    assert held.read_bytes() == first
    assert exit_code("calibrate", path, "--draws", 20, "-q") == 0
    few = json.loads(held.read_text())
    assert few["draws"] == many["draws"][:20] and len(many["draws"]) == 200
    report = json.loads((tmp_path / "good.calibration.json").read_text())
    errors, centre = report["calibration"]["standard_errors"], report["calibration"]["parameters"]
    for place, name in enumerate(many["parameters"][:9]):
        column = np.array(many["draws"])[:, place]
        assert abs(column.mean() - centre[name]) < errors[name] and column.std() < 5 * errors[name], name
    assert exit_code("calibrate", other, "--draws", 20, "-q") == 0
    assert json.loads((tmp_path / "other.draws.json").read_text())["draws"] != few["draws"]
    assert exit_code("calibrate", path, "-q", "--force") == 0
    assert not held.exists()
    assert_one_line(run("calibrate", path, "--draws", 20, "--prior", "none"), "--draws", "prior", code=2)


def test_51_1_the_page_has_measures_with_their_intervals(tmp_path: Path) -> None:
    path = good_raw(tmp_path)
    assert exit_code("calibrate", path, "--html", "-q") == 0
    page = tmp_path / "good.html"
    assert "Measures of activity" not in page.read_text()
    assert exit_code("calibrate", path, "--html", "--effect", "-q") == 0
    text = page.read_text()
    assert "Measures of activity" in text and "Mean angle of the arm" in text and " to " in text
