"""Every optimizer on the same points: sample recordings, and how far each is from the optimum."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.points import MODELS, PointSet
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.laboratory import methods
from accelcal_cli.laboratory.methods import MethodRow, collected
from accelcal_cli.optimize import all_optimizers
from accelcal_cli.output.numbers import percent
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.jobs import Request, no_progress, plan
from tests.cli.run import run
from tests.optimize.oracle import least_squares
from tests.optimize.test_contract import norms_mg
from tests.pages.html import parsed
from tests.pages.reading import check_page
from tests.recordings import directions, good_csv, still_counts, write_csv

SAMPLES = Path(__file__).resolve().parent.parent.parent / "sample_data"
RECORDINGS = ("recording.bin", "evening.csv.gz", "night.h5")
NINE = [item for item in all_optimizers() if "9" in item.models and item.name != "fixed16"]


@cache
def sample_points(name: str) -> PointSet:
    return collected(SAMPLES / name, ReadOptions(), DEFAULT, no_progress).result()


@pytest.mark.parametrize(
    "name", [RECORDINGS[0], *(pytest.param(name, marks=pytest.mark.nightly) for name in RECORDINGS[1:])]
)
@pytest.mark.parametrize("optimizer", NINE, ids=lambda item: item.name)
def test_nine_parameters_end_at_the_optimum_of_the_sample_recordings(optimizer, name: str) -> None:
    held, model = sample_points(name), MODELS["9"]
    best = least_squares(held, model.free)
    assert best.converged
    found = optimizer.fit(held, model, optimizer.settings["default"]).parameters
    exact = tuple(float(value) * (1 << 29) for value in best.p)
    assert np.abs(norms_mg(found, held) - norms_mg(exact, held)).max() < 0.02


def rows_of(path: Path, *names: str, settings=DEFAULT) -> list[MethodRow]:
    read = methods.collected_to_fit(path, ReadOptions(), settings, no_progress)
    return list(methods.rows_of(path, *read, names))


def test_the_default_s_row_is_what_calibrate_says(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    (row,) = rows_of(path, "fixed32")
    report = calibrate(
        plan([path], None, None)[0], Request(settings=replace(DEFAULT, prior="none"), report_only=True)
    ).report
    held, made = report["holdout"], report["calibration"]["optimizer"]
    assert (row.outcome, row.model) == (report["outcome"], report["calibration"]["model"])
    assert (row.points, row.postures) == (held["points"], held["postures"])
    assert row.before_mg == pytest.approx(held["before_mg"]["mean"], abs=1e-4)
    assert row.after_mg == pytest.approx(held["after_mg"]["mean"], abs=1e-4)
    assert row.improvement_percent == pytest.approx(held["improvement_percent"], abs=0.1)
    assert row.iterations == made["iterations"]
    assert {"additions": row.additions, "multiplications": row.multiplications} == made["operations"]
    assert row.seconds is not None and row.seconds > 0


def test_all_are_judged_by_the_same_hold_out(tmp_path: Path) -> None:
    rows = rows_of(good_csv(tmp_path), "ellipsoid", "gauss-newton", "closest-point")
    assert len({(row.points, row.postures, row.before_mg) for row in rows}) == 1
    assert [row.model for row in rows] == ["6", "9", "6"]
    assert rows[1].after_mg < min(rows[0].after_mg, rows[2].after_mg)
    assert all(row.additions is None for row in rows), "not counted is not zero"


def test_what_cannot_be_read_is_said(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError):
        rows_of(tmp_path / "none.csv", "fixed32")


Capture = pytest.CaptureFixture[str]
METHODS = ("evaluate", "methods")


def test_a_table_for_each_recording_and_the_published_one(tmp_path: Path, capsys: Capture) -> None:
    first, second = good_csv(tmp_path, "a.csv"), good_csv(tmp_path, "b.csv")
    ran = run(capsys, *METHODS, first, second, "--only", "fixed32,ellipsoid")
    assert ran.code == 0
    one, two, _, published = ran.out.split("\n\n")
    assert one.splitlines()[0] == str(first) and two.splitlines()[0] == str(second)
    assert [line.split()[0] for line in one.splitlines()[3:]] == ["fixed32", "ellipsoid"]
    assert "3.06" in published and "820" in published


def test_json_and_csv_hold_the_same_rows(tmp_path: Path, capsys: Capture) -> None:
    path = good_csv(tmp_path)
    said = json.loads(run(capsys, *METHODS, path, "--only", "float64", "--json").out)
    (row,) = said["rows"]
    (read,) = csv.DictReader(io.StringIO(run(capsys, *METHODS, path, "--only", "float64", "--csv").out))
    assert set(read) == set(row)
    assert {k: read[k] for k in ("recording", "optimizer", "model")} == {
        "recording": str(path), "optimizer": "float64", "model": "9",
    }  # fmt: skip
    assert float(read["after_mg"]) == row["after_mg"]
    assert len(said["published"]) == 4


def test_the_mean_over_recordings_is_a_ratio_of_means(tmp_path: Path, capsys: Capture) -> None:
    """As all R of the paper are; a recording that was refused is in neither mean."""
    paths = [good_csv(tmp_path, "a.csv"), write_csv(tmp_path / "b.csv", still_counts(directions(50), 7))]
    paths.append(write_csv(tmp_path / "few.csv", still_counts(directions(4))))
    said = json.loads(run(capsys, *METHODS, *paths, "--only", "gauss-newton", "--json").out)
    one, two, refused = said["rows"]
    assert refused["after_mg"] is None
    (mean,) = said["means"]
    assert mean["recordings"] == 2
    assert mean["before_mg"] == pytest.approx((one["before_mg"] + two["before_mg"]) / 2)
    ratio = (one["before_mg"] + two["before_mg"]) / (one["after_mg"] + two["after_mg"])
    assert mean["improvement_percent"] == pytest.approx(100 * ratio)
    assert mean["improvement_ci95"] is None, "two recordings say nothing"
    shown = run(capsys, *METHODS, *paths, "--only", "gauss-newton").out
    assert percent(100 * ratio) in shown.split("mean over recordings")[1]
    assert json.loads(run(capsys, *METHODS, paths[0], "--only", "float64", "--json").out)["means"] == []


def test_51_4_a_folder_is_all_its_recordings_and_r_has_an_interval(tmp_path: Path, capsys: Capture) -> None:
    """By Student's t of the logarithm of the ratio of the means, over the recordings, by hand."""
    for name, noise in (("a.csv", 2), ("b.csv", 4), ("c.csv", 6)):
        write_csv(tmp_path / name, still_counts(directions(40 + noise), noise))
    said = json.loads(run(capsys, *METHODS, tmp_path, "--only", "gauss-newton", "--json").out)
    assert [Path(row["recording"]).name for row in said["rows"]] == ["a.csv", "b.csv", "c.csv"]
    before, after = (np.array([row[key] for row in said["rows"]]) for key in ("before_mg", "after_mg"))
    spread = np.std(before / before.mean() - after / after.mean(), ddof=1) / np.sqrt(3)
    by = np.exp(4.303 * spread)
    (mean,) = said["means"]
    ratio = 100 * before.mean() / after.mean()
    assert mean["improvement_ci95"] == pytest.approx([ratio / by, ratio * by], rel=0.02)
    low, high = said["rows"][0]["improvement_ci95"]
    assert low < said["rows"][0]["improvement_percent"] < high


def test_a_refusal_is_a_row_with_its_reason(tmp_path: Path, capsys: Capture) -> None:
    path = write_csv(tmp_path / "few.csv", still_counts(directions(4)))
    ran = run(capsys, *METHODS, path, "--only", "fixed32")
    assert ran.code == 0
    assert "fixed32: refused: the device was still in only 4 orientations" in ran.out


def test_one_bad_recording_does_not_stop_the_rest(tmp_path: Path, capsys: Capture) -> None:
    path = good_csv(tmp_path)
    ran = run(capsys, *METHODS, tmp_path / "none.csv", path, "--only", "fixed32")
    assert ran.code == 1 and "none.csv" in ran.err and str(path) in ran.out
    assert run(capsys, *METHODS, tmp_path / "none.csv").code == 3


@pytest.mark.parametrize("names", ["nonesuch", "fixed32,nonesuch", " , "])
def test_an_optimizer_that_does_not_exist_is_wrong_usage(tmp_path: Path, capsys: Capture, names: str) -> None:
    assert run(capsys, *METHODS, good_csv(tmp_path), "--only", names).code == 2


def test_51_4_the_page_has_the_tables_and_the_figures_of_the_paper(tmp_path: Path, capsys: Capture) -> None:
    page, only = tmp_path / "methods.html", ("--profile", "paper", "--only", "fixed32")
    names = [SAMPLES / name for name in RECORDINGS if name != "evening.csv.gz"]
    ran = run(capsys, *METHODS, *names, *only, "--html", page, "-q")
    assert ran.code == 0
    root = parsed(page.read_text("utf-8"))
    check_page(root)
    tables = [[cell.whole() for cell in table.all("td", "th", "caption")] for table in root.all("table")]
    assert [one[0] for one in tables[:2]] == [
        "Mean over recordings",
        "Table 3 of Farago, Maczak, Gingl 2024 (own recordings)",
    ]
    assert "820" in tables[1] and all(cell in ran.out for cell in tables[0][1:])
    headings = [one.whole() for one in root.all("h3")]
    assert headings == 2 * [
        "Detected rest",
        "Rests and fitted points in space",
        "Distance from 1 g before and after",
        *(f"Convergence of the {name}" for name in ("scale", "misalignment", "offset")),
    ]
    assert "of the 18 points that were fitted" in root.whole()


def test_51_4_a_page_of_somebody_else_is_not_replaced(tmp_path: Path, capsys: Capture) -> None:
    page = tmp_path / "methods.html"
    page.write_text("mine")
    ran = run(capsys, *METHODS, good_csv(tmp_path), "--only", "fixed32", "--html", page, "-q")
    assert ran.code != 0 and page.read_text() == "mine"
    ran = run(capsys, *METHODS, good_csv(tmp_path), "--only", "fixed32", "--html", page, "-q", "--force")
    assert ran.code == 0 and "mine" not in page.read_text()


@pytest.mark.nightly
def test_51_4_table_3_of_the_docs_is_that_of_sample_data(capsys: Capture) -> None:
    names = "fixed32,gauss-newton,ellipsoid,closest-point"
    ran = run(capsys, *METHODS, SAMPLES, "--profile", "paper", "--only", names, "--json", "-q")
    text = (SAMPLES.parent / "docs" / "evaluation.md").read_text("utf-8")
    table = text.partition("### Table 3")[2].partition("\n| the seven")[0]
    for mean in json.loads(ran.out)["means"]:
        (line,) = (one for one in table.splitlines() if f"| `{mean['optimizer']}` |" in one)
        before, after, ratio = line.split("|")[4:7]
        assert float(before) == pytest.approx(mean["before_mg"], abs=0.06)
        assert float(after) == pytest.approx(mean["after_mg"], abs=0.006)
        assert float(ratio) == pytest.approx(mean["improvement_percent"], rel=0.005)
