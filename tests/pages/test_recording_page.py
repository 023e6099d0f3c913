"""The page of one recording: well formed, complete in itself, and with the numbers of its two files."""

from __future__ import annotations

import copy
import json
import re
from collections import Counter
from math import log10, pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.errors import Reason
from accelcal_cli.output.sentences import outcome_words, sentence
from accelcal_cli.pages.recording import page
from tests.cli.run import exit_code
from tests.cli.test_change import jumping
from tests.device_recordings import week
from tests.pages.html import Element, check
from tests.recordings import directions, still_counts, write_raw

NAMES = ("warm", "jumps", "few", "none")
Files = dict[str, tuple[dict[str, Any], dict[str, Any]]]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Reports and quality files: with temperatures, of a sensor that changed, and two that were refused."""
    folder = tmp_path_factory.mktemp("made")
    week(folder / "warm.raw", warm=True)
    jumping(folder / "jumps.raw")
    write_raw(folder / "few.raw", still_counts(directions(1)))
    write_raw(folder / "none.raw", np.random.RandomState(3).randint(-900, 900, (5000, 3)).astype(np.int16))
    exit_code("calibrate", *(folder / f"{name}.raw" for name in NAMES), "--report-only", "-q")
    found = {}
    for name in NAMES:
        report, quality = (
            json.loads((folder / f"{name}.{kind}.json").read_text()) for kind in ("calibration", "quality")
        )
        found[name] = (report, quality)
    return found


def figure(root: Element, name: str) -> Element:
    (found,) = [one for one in root.all("svg") if one.attributes["aria-labelledby"].startswith(f"{name}-")]
    return found


def way(drawn: Element, kind: str, place: int = 0) -> list[tuple[str, list[float]]]:
    """The commands of a path, with their numbers."""
    paths = [one for one in drawn.all("path") if one.attributes["class"] == kind]
    found = re.findall(r"([A-Za-z])([^A-Za-z]*)", paths[place].attributes["d"])
    return [(letter, [float(one) for one in re.findall(r"-?\d+\.?\d*", text)]) for letter, text in found]


def scale_of(drawn: Element, *, powers: bool = False) -> tuple[float, float]:
    """Value of y at coordinate 0 and for each unit of coordinate, read from the ticks that are drawn."""
    ticks = [
        (float(one.attributes["y"]) - 4, float(one.text.replace("−", "-")))
        for one in drawn.all("text")
        if one.attributes.get("text-anchor") == "end" and re.fullmatch(r"[−\d.]+", one.text)
    ]
    (y0, first), (y1, last) = ticks[0], ticks[-1]
    first, last = (log10(first), log10(last)) if powers else (first, last)
    step = (last - first) / (y1 - y0)
    return first - step * y0, step


def steps(drawn: Element, kind: str, place: int = 0) -> list[float]:
    """Coordinates of the values of a line of steps, one for each step."""
    found, y = [], 0.0
    for letter, numbers in way(drawn, kind, place):
        if letter in "MV":
            y = numbers[-1]
        elif letter == "H":
            found.append(y)
    return found


@pytest.mark.parametrize("name", NAMES)
def test_every_page_is_well_formed_and_complete_in_itself(made: Files, name: str) -> None:
    report, quality = made[name]
    for held in (quality, None):
        root = check(page(report, held))
        assert root.one("h1").whole() == f"{name}.raw"
        assert report["recording"]["sha256"] in root.whole()
        assert not root.all("script") and not root.all("img") and not root.all("a")[1:]
        missing = "There is no NAME.quality.json" in root.whole()
        assert missing == (held is None) and bool(root.all("svg")) == (held is not None)


def test_the_same_two_files_make_the_same_bytes(made: Files) -> None:
    report, quality = made["warm"]
    text = page(report, quality)
    assert text == page(copy.deepcopy(report), copy.deepcopy(quality))
    changed = report | {"provenance": report["provenance"] | {"time": "2001-01-01T00:00:00+00:00"}}
    assert page(changed, quality) == text.replace(report["provenance"]["time"], "2001-01-01T00:00:00+00:00")


def test_the_verdict_comes_first_with_the_number_to_quote(made: Files) -> None:
    good, changed, few = (check(page(*made[name])) for name in ("warm", "jumps", "few"))
    mean = made["warm"][0]["calibration_error_mg"]["mean"]
    assert good.one("p", kind="headline").text == "Good: calibrated."
    error = f"Calibration error over all orientations {float(f'{mean:.2g}'):g} mg"
    box = good.one("section", kind="verdict good").whole()
    assert error in box and "The limit is 10 mg." in box and "ENMO at rest" in box
    (caution,) = [one for one in made["jumps"][0]["cautions"] if one["code"] == "sensor_changed"]
    assert caution["values"]["followed"]
    assert changed.one("section", kind="verdict care").whole().count(sentence(Reason(**caution))) == 1
    assert few.one("p", kind="headline").text == "Refused: this recording could not be calibrated."
    said = few.one("section", kind="verdict bad").whole()
    refusal = made["few"][0]
    assert (refusal["reason"], refusal["values"]["orientations"]) == ("too_few_orientations", 1)
    reasons = [Reason(refusal["reason"], refusal["values"]), *(Reason(**one) for one in refusal["advice"])]
    assert len(reasons) > 1 and all(sentence(one) in said for one in reasons)
    assert "no coefficients" in few.whole()


def test_the_page_of_a_provisional_result_has_its_number_the_limit_and_the_reason(tmp_path: Path) -> None:
    """The limit that was asked for is below the interval of a good recording."""
    write_raw(tmp_path / "some.raw", still_counts(directions(60)))
    exit_code("calibrate", tmp_path / "some.raw", "--report-only", "--max-error", "0.01", "-q")
    report, quality = (
        json.loads((tmp_path / f"some.{kind}.json").read_text()) for kind in ("calibration", "quality")
    )
    assert report["outcome"] == "provisional" and report["reason"] == "provisional"
    verdict = check(page(report, quality)).one("section", kind="verdict care")
    headline, error = verdict.one("p", kind="headline").text, report["calibration_error_mg"]
    assert headline == "Use with care: calibrated provisionally."
    mean, low = (float(f"{value:.2g}") for value in (error["mean"], error["ci95"][0]))
    said = verdict.whole()
    assert f"{mean:g} mg (95 % interval {low:g} to" in said
    assert "the limit is 0.01 mg" in said
    assert sentence(Reason(report["reason"], report["values"])) in said
    assert outcome_words("provisional").to_do in said


def test_lines_by_the_hour_are_the_numbers_of_the_file(made: Files) -> None:
    """Their coordinates are read by the ticks of the figure's own axis."""
    report, quality = made["jumps"]
    root, rows = check(page(report, quality)), quality["rows"]
    drawn = figure(root, "error")
    base, step = scale_of(drawn, powers=True)
    for when in ("before", "after"):
        shown = [10 ** (base + step * y) for y in steps(drawn, when)]
        assert shown == pytest.approx(rows[f"{when}_mg"]["mean"], rel=0.02)
    drawn = figure(root, "length")
    base, step = scale_of(drawn)
    for when in ("before", "after"):
        shown = [base + step * y for y in steps(drawn, when)]
        assert shown == pytest.approx(rows[f"{when}_off_mg"]["p50"], abs=0.1 * abs(step) + 0.01)
    band = [numbers[-1] for letter, numbers in way(drawn, "before-band") if letter in "MV"]
    low, high = (rows["before_off_mg"][name] for name in ("p5", "p95"))
    assert [base + step * y for y in band[::3]] == pytest.approx(low, abs=0.1 * abs(step) + 0.01)
    assert [base + step * y for y in band[1::3]] == pytest.approx(high, abs=0.1 * abs(step) + 0.01)


def test_where_the_sensor_changed_there_is_a_mark(made: Files) -> None:
    report, quality = made["jumps"]
    drawn = figure(check(page(report, quality)), "error")
    ((_, (x, _)), _) = way(drawn, "mark")
    times = {one.text: float(one.attributes["x"]) for one in drawn.all("text")}
    assert report["change"]["at"].startswith("2024-03-04T14")
    hour = (times["12:00"] - times["09:00"]) / 3
    assert x == pytest.approx(times["12:00"] + 2 * hour, abs=0.2)
    assert "The sensor changed at 2024-03-04 14:00:00." in drawn.one("desc").text


def test_bars_of_the_histogram_are_shares_of_the_windows(made: Files) -> None:
    report, quality = made["warm"]
    drawn, points = figure(check(page(report, quality)), "histogram"), quality["points"]
    first, step = scale_of_x(drawn)
    for when in ("before", "after"):
        each = np.sort(np.repeat(points[when], points["windows"])) / 100
        bars = bars_of(way(drawn, f"{when}-bar"))
        whole = sum(height for _, _, height in bars)
        for place, (left, right, height) in enumerate(bars):
            low = -np.inf if place == 0 else first + step * left - 1e-3
            high = np.inf if place == len(bars) - 1 else first + step * right - 1e-3
            share = np.mean((each >= low) & (each < high))
            assert height / whole == pytest.approx(share, abs=0.004), (when, place)
    low, high = drawn.one("desc").text.split("windows lie from ")[1].split(" mg")[0].split(" to ")
    each = np.sort(np.repeat(points["before"], points["windows"])) / 100
    exact = [np.percentile(each, percent, method="inverted_cdf") for percent in (5, 95)]
    assert [float(one.replace("−", "-")) for one in (low, high)] == pytest.approx(exact, rel=0.01)


def bars_of(found: list[tuple[str, list[float]]]) -> list[tuple[float, float, float]]:
    """Left and right end and height of each bar of a path."""
    commands = iter(found)
    bars = []
    for letter, numbers in commands:
        assert letter == "M"
        (_, (high,)), (_, (right,)), (_, (low,)), _ = (next(commands) for _ in range(4))
        bars.append((numbers[0], right, low - high))
    return bars


def scale_of_x(drawn: Element) -> tuple[float, float]:
    """Value of x at coordinate 0 and for each unit of coordinate, read from the first row's ticks."""
    held = [one for one in drawn.all("text") if re.fullmatch(r"[−\d.]+", one.text)]
    held = [one for one in held if one.attributes.get("text-anchor") == "middle"]
    ticks = [(float(one.attributes["x"]), float(one.text.replace("−", "-"))) for one in held]
    (x0, first), (x1, second) = ticks[:2]
    step = (second - first) / (x1 - x0)
    return first - step * x0, step


def test_cells_of_the_sphere_are_those_in_which_it_rested(made: Files) -> None:
    """Rings and sectors of equal area, found here from the angle to the pole."""
    report, quality = made["warm"]
    root = check(page(report, quality))
    points = quality["points"]
    unit = np.array([points[axis] for axis in "xyz"], float).T
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    ring = np.floor(5 * np.sqrt(2) * np.sin(np.arccos(np.abs(unit[:, 2])) / 2)).clip(max=4)
    turn = np.arctan2(unit[:, 1], unit[:, 0]) % (2 * pi)
    sector = np.floor(turn / (2 * pi) * 4 * (2 * ring + 1))
    windows = Counter()
    for key, number in zip(zip(unit[:, 2] >= 0, ring, sector, strict=True), points["windows"], strict=True):
        windows[key] += number
    drawn = figure(root, "sphere")
    cells = Counter()
    for one in drawn.all("path"):
        cells[one.attributes["class"]] += one.attributes["d"].count("M")
    kinds = Counter(f"cell{1 + (number >= 12) + (number >= 120)}" for number in windows.values())
    assert {kind: cells[kind] for kind in ("cell1", "cell2", "cell3")} == {
        kind: kinds[kind] for kind in ("cell1", "cell2", "cell3")
    }
    assert cells["cell0"] == 200 - len(windows)
    assert f"in {len(windows)} of 200 equal areas" in drawn.one("desc").text


def test_lanes_of_the_timeline_are_shares_of_the_hours(made: Files) -> None:
    """Hours with something in them are as high as their share, and at least visible; others are empty."""
    report, quality = copy.deepcopy(made["jumps"])
    rows = quality["rows"]
    rows["clipped"][3:7] = [900, 450, 0, 1]
    rows["worn"] = [None, False, *rows["worn"][2:]]
    drawn = figure(check(page(report, quality)), "timeline")
    ground = way(drawn, "lane-bad")[0][1][1]
    found = [(letter, [round(one, 1) for one in numbers]) for letter, numbers in way(drawn, "lane-bad")]
    assert [numbers[-1] for letter, numbers in found if letter in "MV"] == pytest.approx(
        [ground, ground - 9, ground - 4.5, ground, ground, ground - 18 * 0.12, ground], abs=0.06
    )
    assert "1351 samples clipped" in drawn.one("desc").text
    assert "Worn in 22 of the 23 hours" in drawn.one("desc").text
    unknown, empty = (way(drawn, kind) for kind in ("lane-unknown", "lane-off"))
    assert unknown[0][1][0] == pytest.approx(empty[0][1][0] - unknown[1][1][0], abs=0.2)


def test_empty_subsets_are_named(made: Files) -> None:
    report, quality = copy.deepcopy(made["warm"])
    report["coverage"]["subsets"][0][1] = 0
    root = check(page(report, quality))
    drawn = figure(root, "sphere")
    assert "Missing: y near −1 g." in drawn.one("desc").text
    assert [one.text for one in drawn.all("text") if one.attributes.get("class") == "bad"] == ["−y empty"] * 2
    assert [one.text for one in root.all("td") if one.attributes.get("class") == "missing"] == ["empty"]


def test_the_steps_of_the_fit_and_the_dots_by_temperature(made: Files) -> None:
    report, quality = made["warm"]
    root = check(page(report, quality))
    drawn = figure(root, "convergence")
    base, step = scale_of(drawn, powers=True)
    shown = [10 ** (base + step * numbers[1]) for _, numbers in way(drawn, "after")]
    assert shown == pytest.approx(quality["convergence"], rel=0.03)
    drawn = figure(root, "temperature")
    base, step = scale_of(drawn)
    dots = [numbers for letter, numbers in way(drawn, "dots") if letter == "M"]
    values = np.array(quality["points"]["after"]) / 100
    inner = np.abs(values) < 0.9 * np.abs(values).max()
    for value in values[inner].tolist():
        assert min(abs(base + step * y - value) for _, y in dots) <= 0.51 * abs(step)
    assert 0.8 * len(values) < len(dots) <= len(values)


def test_coefficients_and_standard_errors_are_those_of_the_report(made: Files) -> None:
    report, quality = made["warm"]
    root = check(page(report, quality))
    rows = [[cell.whole() for cell in row.children] for row in root.all("tr")]
    held = {row[0]: row[2:] for row in rows if len(row) == 4}
    for name, value in report["calibration"]["parameters"].items():
        error = report["calibration"]["standard_errors"][name]
        assert [float(one.replace("−", "-")) for one in held[name]] == pytest.approx(
            [value, error], abs=5.1e-7
        )
    slopes = report["calibration"]["temperature"]["slope_g_per_c"]
    assert [float(held[f"s{axis}"][0].replace("−", "-")) for axis in "xyz"] == pytest.approx(slopes, abs=5e-7)
    (chosen,) = [row for row in rows if row[-1].startswith("chosen")]
    assert chosen[0] == report["calibration"]["model"]


def test_the_table_has_all_hours(made: Files) -> None:
    report, quality = made["jumps"]
    root = check(page(report, quality))
    (table,) = [one for one in root.all("table") if "Hour by hour" in one.whole()]
    head = [one.text for one in table.one("thead").all("th")]
    rows = [[cell.text for cell in row.children] for row in table.one("tbody").all("tr")]
    assert [row[0] for row in rows] == [f"2024-03-04 {hour:02}:00" for hour in range(24)]
    place = head.index("error after, mean [mg]")
    shown = [float(row[place]) for row in rows]
    assert shown == pytest.approx(quality["rows"]["after_mg"]["mean"], rel=0.006)


HOSTILE = {
    "markup": "<script>alert(1)</script>", "an attribute": "\"'><img src=x onerror=alert(1)>",
    "an end": "</title></style></svg></script><h1>", "control characters": "a\0b\x1b[31m\r\n\x7f",
    "marks of direction": "\u202egpj.exe\u2066\u200f\u061c",
    "blanks nobody sees": "\u200b\ufeff\u2028\u00a0", "templates": "{{ 7 * 7 }}{% raw %}${7*7}",
    "a formula": "=HYPERLINK(1)", "entities": "&lt;b&gt;&#60;", "half a character": "\ud800x",
    "a policy": "'; script-src *; \"",
}  # fmt: skip


def everywhere(report: dict[str, Any], text: str) -> dict[str, Any]:
    """The report with a text in every place that a file or a user may decide."""
    held = copy.deepcopy(report)
    held["recording"] |= {"path": f"x/{text}", "format": text, "timezone": text, "notes": [text, text]}
    held["recording"]["start_time"] = text
    held["recording"]["device"] = {"model": text, "serial": text, "firmware": text}
    held |= {"message": text, "accelcal_version": text, "reason": text, "values": {text: text}}
    held |= {name: [{"code": text, "values": {text: text}}] for name in ("notes", "cautions", "advice")}
    held["file_health"]["problems"] = [
        {"code": text, "message": text, "byte_offset": None, "sample": 0, "count": 1}
    ]
    held["provenance"] = {
        "command": [text], "versions": {text: text}, "time": text, "host": text, "platform": text,
    }  # fmt: skip
    held["calibration"]["optimizer"] |= {"name": text}
    held["settings"] |= {"prior": text, "segment_seconds": text, "max_error_mg": text, "coverage_g": text}
    held["holdout"]["method"] = text
    held["change"]["at"] = text
    for trial in held["models_tried"]:
        trial |= {"reason": text, "prior": text}
    for one in held["misfits"]:
        one |= {"unit": text}
    held["recording"]["gaps"] = [{"sample": 1, "start_time": text, "seconds": 5.0}]
    return held


@pytest.mark.parametrize("kind", HOSTILE)
def test_hostile_texts_stay_texts(made: Files, kind: str) -> None:
    """The elements are those of the page with a harmless text; what cannot be seen is shown."""
    report, quality = made["warm"]
    quality = copy.deepcopy(quality)
    quality["rows"]["start"] = [HOSTILE[kind]] * len(quality["rows"]["start"])
    tame = copy.deepcopy(made["warm"][1])
    tame["rows"]["start"] = ["tame"] * len(tame["rows"]["start"])
    root = check(page(everywhere(report, HOSTILE[kind]), quality))
    expected = check(page(everywhere(report, "tame"), tame))
    assert [one.tag for one in root.all()] == [one.tag for one in expected.all()]
    assert not root.all("script") and not root.all("img")
    said = root.whole()
    if kind == "marks of direction":
        assert "\\u202egpj.exe\\u2066\\u200f\\u061c" in said
    elif kind == "control characters":
        assert "a\\x00b\\x1b[31m\\r\\n\\x7f" in said
    elif kind not in ("blanks nobody sees", "half a character"):
        assert HOSTILE[kind] in root.one("section").whole()


DAMAGE = {
    "no object": lambda held: held.update(rows=[]),
    "columns of different lengths": lambda held: held["rows"]["still"].append(1),
    "a word among numbers": lambda held: held["rows"]["samples"].__setitem__(0, "<b>"),
    "nothing among points": lambda held: held["points"]["x"].__setitem__(0, None),
    "an endless number": lambda held: held["points"]["before"].__setitem__(0, float("inf")),
    "times that are none": lambda held: held["rows"].update(start=[1]),
    "no rate": lambda held: held["row"].update(rate_hz=0),
    "too many rows": lambda held: held["rows"].update(start=["x"] * 513),
    "another recording": lambda held: held.update(sha256="0" * 64),
    "another model": lambda held: held.update(model="3"),
    "no file of ours": lambda held: held.clear(),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_a_quality_file_that_does_not_fit_is_told_and_not_drawn(made: Files, name: str) -> None:
    report, quality = made["warm"]
    DAMAGE[name](quality := copy.deepcopy(quality))
    root = check(page(report, quality))
    assert not root.all("svg")
    told = "is of another result" if name.startswith("another") else "is damaged"
    assert f"NAME.quality.json {told}" in root.whole()


def fullest(
    report: dict[str, Any], quality: dict[str, Any], hours: int = 14 * 24
) -> tuple[dict[str, Any], dict[str, Any]]:
    """So many hours with as many points as there can be, all of them in places of their own."""
    number, random = 4096, np.random.RandomState(2)
    long = copy.deepcopy(quality)
    times = np.datetime64("2024-03-04", "us") + np.arange(hours) * np.timedelta64(3600, "s")
    spread = {name: random.uniform(-90, 90, hours).round(2).tolist() for name in ("p5", "p50", "p95")}
    sizes = {name: random.uniform(0.01, 90, hours).round(2).tolist() for name in ("mean", "p95")}
    rows = {name: random.randint(100_000, 999_999, hours).tolist() for name in long["rows"]}
    rows |= {"start": np.datetime_as_string(times).tolist(), "samples": [360_000] * hours}
    rows |= {"before_mg": sizes, "after_mg": sizes, "before_off_mg": spread, "after_off_mg": spread}
    rows |= {"worn": random.choice([True, False, None], hours).tolist(), "temperature_c": [31.23] * hours}
    unit = random.standard_normal((3, number))
    unit = np.rint(1000 * unit / np.linalg.norm(unit, axis=0)).astype(int)
    points = {name: random.randint(1, 999, number).tolist() for name in ("windows", "weight", "posture")}
    points |= dict(zip("xyz", unit.tolist(), strict=True))
    points |= {name: random.randint(-9999, 9999, number).tolist() for name in ("before", "after")}
    points |= {"temperature": random.randint(200, 380, number).tolist()}
    long |= {"rows": rows, "points": points, "row": {"samples": 360_000, "seconds": 3600.0, "rate_hz": 100.0}}
    gaps = [
        {"sample": one, "start_time": f"{rows['start'][one]}", "seconds": 100.0} for one in range(0, hours, 2)
    ]
    recording = {"gaps": gaps, "start_time": rows["start"][0], "duration_s": 3600.0 * hours}
    return report | {"recording": report["recording"] | recording}, long


def test_two_weeks_with_all_points_make_a_page_below_250_kb(made: Files) -> None:
    text = page(*fullest(*made["warm"]))
    root = check(text)
    assert 150_000 < len(text.encode()) < 250_000, len(text.encode())
    assert len(root.all("tr")) > 14 * 24
    labels = [one.text for one in figure(root, "error").all("text")]
    assert {"4 Mar", "10 Mar", "18 Mar"} <= set(labels)


@pytest.mark.parametrize("hours", [pytest.param(14 * 24, marks=pytest.mark.nightly), 14 * 24 + 1, 512])
def test_a_page_is_never_larger_than_300_kb(made: Files, hours: int) -> None:
    """512 rows are all that there can be: of an hour in three weeks, of four in sixty days and more."""
    report, quality = fullest(*made["warm"], hours)
    report = copy.deepcopy(report)
    report["recording"] |= {"path": "p" * 4000, "gaps": _gaps(quality["rows"]["start"], 1000)}
    problem = {"code": "checksum", "message": "m" * 200, "byte_offset": 10**12, "sample": 0, "count": 10**6}
    report["file_health"] |= {"problems": [problem] * 1000}
    report["provenance"]["command"] = ["accelcal", "calibrate", *["recording.cwa"] * 10_000]
    quality["convergence"] = np.random.RandomState(1).uniform(0.1, 90, 100).round(4).tolist()
    text = page(report, quality)
    check(text)
    assert 200_000 < len(text.encode()) < 300_000, len(text.encode())
    assert "980 more are in the report" in text and "more characters are in the report" in text


def _gaps(starts: list[str], number: int) -> list[dict[str, Any]]:
    begin, end = np.datetime64(starts[0], "us"), np.datetime64(starts[-1], "us")
    moments = begin + np.arange(number) * ((end - begin) // number)
    times = np.datetime_as_string(moments).tolist()
    return [{"sample": place, "start_time": time, "seconds": 1.0} for place, time in enumerate(times)]


def test_rows_of_a_long_recording_have_sums_means_and_the_worst_of_their_hours(made: Files) -> None:
    report, quality = fullest(*made["warm"], 512)
    held = quality["rows"]
    root = check(page(report, quality))
    (table,) = [one for one in root.all("table") if "3 rows of NAME.quality.json in each row" in one.whole()]
    head = [one.text for one in table.one("thead").all("th")]
    rows = [[cell.text.replace("−", "-") for cell in row.children] for row in table.one("tbody").all("tr")]
    assert len(rows) == 171  # of 512, the last of two
    for place in (0, 57, 170):
        part, row = slice(3 * place, 3 * place + 3), dict(zip(head, rows[place], strict=True))
        assert row["Start"] == held["start"][3 * place][:16].replace("T", " ")
        assert float(row["Still"]) == pytest.approx(sum(held["still"][part]), rel=1e-5)
        assert float(row["Filled"]) == pytest.approx(sum(held["filled"][part]), rel=1e-5)
        mean = np.average(held["before_mg"]["mean"][part], weights=held["windows"][part])
        assert float(row["error before, mean [mg]"]) == pytest.approx(mean, rel=0.006)
        worst = max(held["after_mg"]["p95"][part])
        assert float(row["error after, largest 95 % [mg]"]) == pytest.approx(worst, rel=0.006)
        farthest = max(held["after_off_mg"]["p50"][part], key=abs)
        assert float(row["|a| − 1 g after, median farthest off [mg]"]) == pytest.approx(farthest, rel=0.006)
        worn = set(held["worn"][part])
        plain = "yes" if True in worn else "no" if False in worn else "–"
        assert row["Worn"] == ("in part" if {True, False} <= worn else plain)
