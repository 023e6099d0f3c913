"""`accelcal report` and `--html`: pages beside reports, from the files alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from accelcal_cli.output.files import is_page
from tests.cli.run import assert_one_line, nightly, run
from tests.device_recordings import donor, edit, week
from tests.pages.html import check
from tests.recordings import directions, good_csv, still_counts, write_raw


def test_the_page_of_calibrate_is_that_of_report(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    ran = run("calibrate", path, "--html", "--report-only")
    assert (ran.code, ran.err) == (0, "") and len(ran.lines) == 1
    page = tmp_path / "good.html"
    text = page.read_bytes()
    assert is_page(page) and check(text.decode()).one("h1").whole() == "good.csv"
    page.unlink()
    ran = run("report", tmp_path / "good.calibration.json")
    assert (ran.code, ran.lines, ran.err) == (0, [str(page)], "")
    assert page.read_bytes() == text
    other = tmp_path / "pages" / "here"
    assert run("report", tmp_path / "good.calibration.json", "-d", other, "-q").out == ""
    assert (other / "good.html").read_bytes() == text
    page.unlink()
    assert "up to date" in run("calibrate", path, "--html", "--report-only").err
    assert page.read_bytes() == text


def test_a_refused_recording_has_a_page(tmp_path: Path) -> None:
    path = write_raw(tmp_path / "few.raw", still_counts(directions(3)))
    assert run("calibrate", path, "--html", "--strict").code == 4
    root = check((tmp_path / "few.html").read_text("utf-8"))
    assert root.one("p", kind="headline").text.startswith("Refused")


def test_a_page_whose_report_no_longer_holds_goes(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    run("calibrate", path, "--html", "--report-only")
    run("calibrate", path, "--report-only")
    assert (tmp_path / "good.html").exists()
    run("calibrate", path, "--report-only", "--prior", "none")
    assert not (tmp_path / "good.html").exists()


@pytest.mark.parametrize("words", [("report", "good.calibration.json"), ("calibrate", "good.csv", "--html")])
def test_a_foreign_page_is_not_overwritten(tmp_path: Path, words: tuple[str, ...]) -> None:
    path, foreign = good_csv(tmp_path), tmp_path / "good.html"
    run("calibrate", path, "--report-only")
    foreign.write_text("<p>mine")
    name, file, *more = words
    ran = run(name, tmp_path / file, *more)
    assert ran.code == 5 and foreign.read_text() == "<p>mine"
    assert_one_line(ran, "good.html", "was not written by accelcal")
    run("calibrate", path, "--report-only", "--force")
    assert foreign.read_text() == "<p>mine"
    assert run(name, tmp_path / file, *more, "--force").code == 0
    assert is_page(foreign)


def test_reports_of_other_commands_have_pages(tmp_path: Path) -> None:
    """Known coefficients, a session on six faces, and a table of points, which has no time."""
    samples = Path(__file__).parents[2] / "sample_data"
    table = tmp_path / "points.csv"
    rows = [
        f"{x:.5f},{y:.5f},{z:.5f}" for x, y, z in directions(60) * [1.02, 0.99, 1.01] + [0.02, -0.01, 0.03]
    ]
    table.write_text("\n".join(["x,y,z", *rows]) + "\n")
    assert run("fit", table, "-o", tmp_path / "points.json").code == 0
    assert run("six-pose", samples / "six_faces.csv.gz", "-d", tmp_path).code == 0
    (tmp_path / "a").mkdir()
    coefficients = donor(tmp_path / "a")
    words = ("--coefficients", coefficients, "-d", tmp_path)
    assert run("apply", week(tmp_path / "other.raw", seed=3), *words).code == 0
    reports = [
        tmp_path / name for name in ("points.json", "six_faces.calibration.json", "other.calibration.json")
    ]
    ran = run("report", *reports)
    assert (ran.code, ran.err) == (0, "")
    assert ran.lines == [str(tmp_path / f"{name}.html") for name in ("points", "six_faces", "other")]
    pages = [check(Path(one).read_text("utf-8")) for one in ran.lines]
    said = [page.one("p", kind="headline").text for page in pages]
    assert said[0] == "Good: calibrated."
    assert "Calibration error over all orientations " in pages[0].whole()
    assert "direction included" in pages[1].whole()
    assert said[2] == "Use with care: calibrated with another recording's coefficients."


def test_what_is_no_report_is_told(tmp_path: Path) -> None:
    good, other = donor(tmp_path), tmp_path / "other.json"
    other.write_text('{"mine": 1}')
    ran = run("report", other, good)
    assert (ran.code, ran.lines) == (1, [str(tmp_path / "donor.html")])
    assert_one_line(ran, "other.json", "is not a report of accelcal")
    assert_one_line(run("report", tmp_path, good), "is a folder", code=2)
    assert_one_line(run("report", good, good), "would both write", code=2)
    edit(good, lambda held: held["recording"].update(samples="many"))
    assert_one_line(run("report", good), "is a damaged report", "recording.samples", code=3)


@pytest.mark.parametrize(
    "name", ["<script>alert(1)<.csv", "a\u202evsc.csv", nightly("=1+1.csv"), nightly("a'b\"&.csv")]
)
def test_a_hostile_name_of_a_recording(tmp_path: Path, name: str) -> None:
    path = good_csv(tmp_path, name)
    ran = run("calibrate", path, "--html", "--report-only", "--model", 6)
    assert ran.code == 0 and "\u202e" not in ran.out + ran.err
    (page,) = tmp_path.glob("*.html")
    root = check(page.read_text("utf-8"))
    assert root.one("h1").whole() == name.replace("\u202e", "\\u202e")
    assert "\u202e" not in run("report", *tmp_path.glob("*.calibration.json")).out
