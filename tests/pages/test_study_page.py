"""The page of a study: what it says, what it is made of, and that hostile names stay names."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.devices.trends import Drift
from accelcal_cli.output import sentences
from accelcal_cli.output.sentences import outcome_words
from accelcal_cli.pages import study_figures
from accelcal_cli.pages.study import WANTED, DeviceLine, StudyContent, page
from accelcal_cli.pages.study_figures import Wear, by_wear
from accelcal_cli.pages.write import write_study_pages
from tests.cli.run import Ran, assert_one_line, run
from tests.devices.made import drifting, fitted, good_devices, write
from tests.pages import made_study
from tests.pages.html import Element, parsed
from tests.pages.reading import cell_texts, check_page, data_of
from tests.recordings import directions, still_counts, write_raw

Capture = pytest.CaptureFixture[str]
HOSTILE = (
    "<script>alert(1)</script>.cwa", "</script><img src=x onerror=alert(1)>.cwa",
    "\"'><svg onload=alert(1)>.cwa", "a\u202egnp.cwa", "line\none\x00\x1b[31m.cwa", "=HYPERLINK(1).cwa",
    "javascript:alert(1).cwa", "line\u2028separator\u2029.cwa", "{{ 7 * 7 }}{% raw %}.cwa",
    "<!--<script>.cwa", "half\udc80byte.cwa",
)  # fmt: skip
SHAPELESS = re.compile("[\u0000-\u0009\u000b-\u001f\u007f-\u009f\u200b-\u200f\u2028-\u202e\u2066-\u2069]")


def row(path: str, outcome: str = "calibrated", **more: Any) -> dict[str, Any]:
    """A row of a good recording."""
    good = {"message": "fine", "before_mg": 30.0, "after_mg": 2.0, "calibration_error_mg": 1.0}
    good |= {"calibration_error_before_mg": 40.0, "calibration_error_high_mg": 2.0, "lost_percent": 0.0}
    good |= {"change": "none", "misfits": "none", "model": "9"}
    return dict.fromkeys(WANTED) | {"path": path, "outcome": outcome} | good | more


def assert_refused(ran: Ran, code: int, *parts: str) -> None:
    assert ran.code == code
    assert_one_line(ran, *parts)


def problems_of(root: Element) -> list[list[tuple[str, ...]]]:
    """The cells of each list of problems."""
    tables = [one for one in root.all("table") if one.attributes.get("class") == "problems"]
    return [[tuple(cell.whole() for cell in line.all("td")) for line in one.all("tr")[1:]] for one in tables]


def content(*rows: dict[str, Any], **more: Any) -> StudyContent:
    pages = [None if one["outcome"] == "failed" else f"{one['path']}.html" for one in rows]
    return replace(StudyContent(rows, pages, {}, (), 0, 2.0), **more)


def device(
    name: str, verdict: str = "good", drift: float | None = None, reasons: tuple[str, ...] = ()
) -> DeviceLine:
    offset = None if drift is None else Drift(drift, 0.1, 1.0, 9, 0.5, abs(drift) > 1)
    return DeviceLine(
        name, verdict, reasons, 8, 7, 1, "2025-01-06T09:30", "2025-08-04T09:30", 0.5, offset, None
    )


@pytest.fixture(scope="module")
def varied() -> str:
    """The page of a study of 500 recordings with all kinds of problems."""
    rows = [dict.fromkeys(WANTED) | one for one in made_study.rows(500)]
    pages = [one["report"] and one["report"].replace(".calibration.json", ".html") for one in rows]
    devices = [
        device("60000", "service", 3.0, ("offset x drifts by +3.0 ± 0.1 mg a month",)),
        device("60001", drift=0.2),
    ]
    return page(StudyContent(rows, pages, {"waiting": 3}, devices, 10, 2.0))


def test_a_page_is_complete_labelled_and_closed(varied: str) -> None:
    check_page(parsed(varied))


def test_an_empty_study_has_a_page() -> None:
    root = parsed(page(content()))
    check_page(root)
    assert "no recording has a problem" in root.whole()
    assert "No recording names its device." in root.whole()


def test_the_table_holds_every_row(varied: str) -> None:
    table = data_of(parsed(varied))["recordings"]
    rows = list(made_study.rows(500))
    assert cell_texts(table, "path") == [one["path"] for one in rows]
    assert cell_texts(table, "outcome") == [one["outcome"] for one in rows]
    assert cell_texts(table, "device") == [one["device_serial"] or "-" for one in rows]
    assert cell_texts(table, "after") == [
        None if (error := one["calibration_error_mg"]) is None else float(f"{error:.4g}") for one in rows
    ]
    found = cell_texts(table, "message")
    refused = [at for at, one in enumerate(rows) if one["outcome"] == "refused"]
    assert [found[at] for at in refused] == [rows[at]["message"] for at in refused]
    assert len(refused) == 25
    assert {table["pages"][at] for at in refused} == {1}
    assert [page for page, one in zip(table["pages"], rows, strict=True) if one["outcome"] == "failed"] == [
        0
    ] * 10


def test_starts_are_minutes_by_the_clock_of_the_recording() -> None:
    starts = ("1970-01-02T00:01:30.000000", "1970-01-01T01:00:00+05:00", "no time", None)
    rows = [row("a", start_time=start) for start in starts]
    table = data_of(parsed(page(content(*rows))))["recordings"]
    assert cell_texts(table, "start") == [1441, 60, None, None]


def test_each_recording_is_listed_under_its_weightiest_problem_the_worst_first() -> None:
    rows = [
        row("good"),
        row("small step", change="step", change_mg=5.0, change_at="2025-01-10T14:00:00.000000"),
        row("large drift", change="drift", change_mg=20.0),
        row("lost", lost_percent=0.5),
        row("hardly lost", lost_percent=0.09),
        row("wide", calibration_error_high_mg=10.5, lost_percent=50.0),
        row("bent", misfits="quadratic"),
        row("no", "refused", message="too short; record longer"),
        row("site/bad.cwa", "failed", message="/data/site/bad.cwa, byte 3: is empty; copy it again"),
    ]
    root = parsed(page(content(*rows)))
    during = "The sensor changed during the recording"
    assert problems_of(root) == [
        [("site/bad.cwa", "-", "/data/site/bad.cwa, byte 3: is empty; copy it again")],
        [("large drift", "-", f"{during}: its offsets drift, by up to 20.0 mg."),
         ("small step", "-", f"{during}: its offsets jump at 2025-01-10T14:00:00, by up to 5.0 mg.")],
        [("no", "-", "too short; record longer")],
        [("wide", "-", "1.0 mg over all orientations, but perhaps 10.5 mg (95 %)")],
        [("lost", "-", "0.5 % of the file is lost")],
        [("bent", "-", "found: quadratic")],
    ]  # fmt: skip
    problems = cell_texts(data_of(root)["recordings"], "problem")
    assert problems[:4] == ["", "sensor changed", "sensor changed", "file damaged"]
    assert problems[4:] == ["", "uncertain", "not described", "refused", "failed"]


def test_provisional_recordings_are_listed_with_their_errors_and_can_be_used() -> None:
    """The list says how large the error may be, the table of outcomes what to do; the widest comes first."""
    unsure = {"calibration_error_mg": 17.3, "calibration_error_high_mg": 45.0, "reason": "provisional"}
    rows = [
        row("fine"),
        row("narrow", "provisional", calibration_error_high_mg=9.0),
        row("wide", "provisional", **unsure),
    ]
    root = parsed(page(content(*rows)))
    assert problems_of(root) == [
        [("wide", "-", sentences.uncertain(17.3, 45.0)), ("narrow", "-", sentences.uncertain(1.0, 9.0))]
    ]
    table = data_of(root)["recordings"]
    assert cell_texts(table, "outcome") == ["calibrated", "provisional", "provisional"]
    assert cell_texts(table, "problem") == ["", "uncertain", "uncertain"]
    text = " ".join(root.whole().split())
    assert outcome_words("provisional").use in text and "3 (100.0 %)" in text


def test_verdicts_14_copies_are_named_and_count_once() -> None:
    bad = row("b", "refused", reason="fit_diverges")
    root = parsed(page(content(row("a"), bad, bad | {"path": "b2", "copy_of": "b"}, row("c", copy_of="a"))))
    text = " ".join(root.whole().split())
    assert "A study of 2 recordings" in text and "2 (and 2 copied from them)" in text
    assert "1 (50.0 %)" in text
    table = data_of(root)["recordings"]
    assert cell_texts(table, "problem") == ["", "refused", "copy", "copy"]
    assert cell_texts(table, "message")[2:] == [
        "a copy of b, which counts once",
        "a copy of a, which counts once",
    ]
    ((listed,),) = problems_of(root)
    assert listed[0] == "b"


def test_the_limit_of_the_settings_decides_what_is_uncertain() -> None:
    one = row("wide", calibration_error_high_mg=6.0)
    at_five = page(content(one, summary={"settings": {"max_error_mg": 5.0}}))
    assert "Calibrated, but uncertain" in at_five
    assert "Calibrated, but uncertain" not in page(content(one))


def test_reasons_are_counted_by_their_codes_whatever_the_messages_say() -> None:
    rows = [
        row(f"{number}", "refused", reason="too_few_orientations", message=f"{number} words")
        for number in range(4)
    ]
    rows += [
        row("a", "refused", reason="fit_diverges"),
        row("b", "refused"),
        row("c", "failed", reason="bug"),
    ]
    text = " ".join(parsed(page(content(*rows))).whole().split())
    for line in ("too few orientations4", "fit diverges1", "no reason is known1", "bug1"):
        assert line in text.replace(" 4", "4").replace(" 1", "1")


def test_the_list_of_problems_has_an_end_and_says_so() -> None:
    rows = [row(f"{number:04}", "refused", message="too short") for number in range(1010)]
    root = parsed(page(content(*rows)))
    (listed,) = problems_of(root)
    assert len(listed) == 1000
    assert "10 more are not listed here" in root.whole()


def test_hostile_texts_are_shown_and_not_obeyed() -> None:
    rows = [row(name, device_serial=name, message=name, device_model=name, model=name) for name in HOSTILE]
    rows += [row(f"x/{name}", "refused", message=f"{name}; {name}") for name in HOSTILE]
    devices = [device(name, "service", 3.0, (name,)) for name in HOSTILE]
    said = {"mixed_times": HOSTILE[0], "waiting": HOSTILE[1]}
    said |= {"pools": {HOSTILE[2]: {}}, "settings": HOSTILE[3]}
    text = page(content(*rows, devices=devices, summary=said))
    text.encode()
    root = parsed(text)
    check_page(root)
    assert [one.attributes.get("type") for one in root.all("script")] == ["application/json", None]
    assert not root.all("img") and SHAPELESS.search(text) is None
    assert "<script>alert(1)</script>.cwa" in root.whole()
    assert r"a\u202egnp.cwa" in root.whole()
    assert "{{ 7 * 7 }}" in root.whole()
    paths = cell_texts(data_of(root)["recordings"], "path")
    assert paths[:2] == [*HOSTILE[:2]] and paths[3] == r"a\u202egnp.cwa"


def test_addresses_stay_below_the_folder_whatever_the_names() -> None:
    names = [*HOSTILE, "//evil.example/x", "a b?c#d%41.cwa"]
    rows = [row(name) for name in names]
    links = [one.attributes["href"] for one in parsed(page(content(*rows))).all("a")]
    assert {link[0] for link in links if link and link != "study.csv"} <= {"#", "."}
    table = data_of(parsed(page(content(*rows))))["recordings"]
    assert "./a%20b%3Fc%23d%2541.cwa.html" in table["pages"]
    assert "./half%80byte.cwa.html" in table["pages"]


def test_the_same_content_gives_the_same_page() -> None:
    rows = [row("b", "refused"), row("a", misfits="quadratic")]
    assert page(content(*rows)) == page(content(*rows))


def test_an_axis_goes_from_step_to_step() -> None:
    axis = study_figures.LogAxis.of([3.0, 40.0], 0, 140)
    assert (axis.low_mg, axis.high_mg) == (2.0, 50.0)
    assert [tick.label for tick in axis.ticks] == ["2", "5", "10", "20", "50"]
    assert (axis.at(2.0), axis.at(10.0), axis.at(50.0), axis.at(1e9)) == (0.0, 70.0, 140.0, 140.0)


def test_dots_lie_where_their_errors_are() -> None:
    scatter = study_figures.Scatter.of([(10.0, 0.1), None, (100.0, 1.0)])
    assert (scatter.x.low_mg, scatter.x.high_mg) == (10.0, 200.0)
    assert scatter.places[0] == (56.0, scatter.y.at(0.1)) and scatter.places[1] is None
    assert scatter.y.at(0.1) == 356.0
    dots = scatter.dots(["calibrated", "calibrated", "already_good"])
    assert [(name, number) for name, _, number in dots] == [("already_good", 1), ("calibrated", 1)]
    assert dots[1][1] == "M56 356h0"


def test_drifts_are_drawn_the_fastest_first_with_their_limits() -> None:
    figure = study_figures.drifts(
        [
            ("slow", Drift(0.5, 0.1, 1.0, 9, 0.5, False)),
            ("none", None),
            ("fast", Drift(-4, 0.2, 1.0, 9, 0.0, True)),
        ],
        2.0,
    )
    assert figure is not None
    assert [(one.name, one.certain) for one in figure.rows] == [("fast", True), ("slow", False)]
    assert figure.rows[0].x < figure.limits[0] < figure.zero < figure.rows[1].x < figure.limits[1]
    assert figure.rows[0].x - figure.rows[0].low == pytest.approx(
        figure.rows[0].high - figure.rows[0].x, abs=0.11
    )
    assert study_figures.drifts([("none", None)], 2.0) is None


def test_the_devices_of_a_study_are_those_of_the_review(tmp_path: Path) -> None:
    out = write(tmp_path, [*good_devices(3), *drifting("07", 0.004)])
    assert write_study_pages(out).changed
    root = parsed((out / "study.html").read_text())
    check_page(root)
    table = data_of(root)["devices"]
    assert cell_texts(table, "device") == ["07", "00000", "00001", "00002"]
    assert cell_texts(table, "verdict") == ["service", "good", "good", "good"]
    assert cell_texts(table, "offset")[0] == pytest.approx(4.0, abs=0.1)
    assert "07: offset x drifts by +" in root.whole()


def test_verdicts_14_a_device_of_two_sensors_is_shown_first(tmp_path: Path) -> None:
    two = [fitted("two", 0.1 * n, {"offset_x_g": 0.03 * (n % 2) + 1e-6 * n}) for n in range(2)]
    out = write(tmp_path, [*good_devices(3), *drifting("07", 0.004), *two])
    write_study_pages(out)
    root = parsed((out / "study.html").read_text())
    assert cell_texts(data_of(root)["devices"], "verdict")[:2] == ["two sensors", "service"]
    assert "2 devices to service or to sort out" in root.whole()


def small_study(out: Path, count: int = 6) -> Path:
    """A study with the reports of its recordings, no values."""
    rows = list(made_study.rows(count))
    made_study.study(out, rows)
    for one in rows:
        if one["report"]:
            path = out / one["report"]
            path.parent.mkdir(exist_ok=True)
            path.write_text(json.dumps(made_study.base_report() | {"message": one["message"]}))
    return out


def stamps(out: Path) -> dict[str, int]:
    return {path.relative_to(out).as_posix(): path.stat().st_mtime_ns for path in out.rglob("*.html")}


def test_only_pages_that_changed_are_made_again(tmp_path: Path) -> None:
    out = small_study(tmp_path / "out")
    first = write_study_pages(out)
    assert (first.changed, first.made, first.kept, first.faults) == (True, 5, 0, [])
    before = stamps(out)
    assert len(before) == 6
    again = write_study_pages(out)
    assert (again.changed, again.made, again.kept) == (False, 0, 5)
    assert stamps(out) == before
    report = out / "site03" / "S00003_wrist_week3.calibration.json"
    report.write_text(report.read_text() + "\n")
    third = write_study_pages(out)
    assert (third.changed, third.made, third.kept) == (False, 1, 4)
    after = stamps(out)
    assert {name for name in after if after[name] != before[name]} == {"site03/S00003_wrist_week3.html"}


def test_a_page_is_made_again_if_its_quality_changed_or_it_is_gone(tmp_path: Path) -> None:
    out = small_study(tmp_path / "out", 3)
    write_study_pages(out)
    (out / "site01" / "S00001_wrist_week1.quality.json").write_text("{}")
    (out / "site02" / "S00002_wrist_week2.html").unlink()
    assert write_study_pages(out).made == 2


def test_a_recording_called_study_does_not_take_the_place_of_the_page(tmp_path: Path) -> None:
    one = next(one for one in made_study.rows(3) if one["report"])
    out = made_study.study(tmp_path, [one | {"path": "study.cwa", "report": "study.calibration.json"}])
    (out / "study.calibration.json").write_text(json.dumps(made_study.base_report()))
    write_study_pages(out)
    assert data_of(parsed((out / "study.html").read_text()))["recordings"]["pages"] == [
        "./study.recording.html"
    ]
    assert (out / "study.recording.html").is_file()


def test_a_report_with_a_name_that_cannot_be_shown_is_found(tmp_path: Path) -> None:
    one = next(one for one in made_study.rows(3) if one["report"])
    out = made_study.study(tmp_path, [one | {"path": r"a\nb.cwa", "report": r"a\nb.calibration.json"}])
    (out / "a\nb.calibration.json").write_text(json.dumps(made_study.base_report()))
    assert write_study_pages(out).made == 1
    assert data_of(parsed((out / "study.html").read_text()))["recordings"]["pages"] == ["./a%0Ab.html"]


def test_a_damaged_report_costs_its_own_page_alone(tmp_path: Path, capsys: Capture) -> None:
    out = small_study(tmp_path / "out", 4)
    (out / "site03" / "S00003_wrist_week3.calibration.json").write_text("{")
    done = run(capsys, "report", out)
    assert done.code == 1
    assert "S00003_wrist_week3.calibration.json: is not valid JSON" in done.err
    assert "study.html and 2 recording pages" in done.err
    assert 'aria-label="site03/S00003' not in (out / "study.html").read_text()


def test_a_page_of_somebody_else_is_not_replaced(tmp_path: Path, capsys: Capture) -> None:
    out = write(tmp_path, [fitted("1", 0.0)])
    (out / "study.html").write_text("<p>notes on my study")
    done = run(capsys, "report", out)
    assert_refused(done, 5, "study.html", "was not written by accelcal")
    assert run(capsys, "report", out, "--force").code == 0
    assert "A study of 1 recording" in (out / "study.html").read_text()


def test_a_folder_without_a_study_is_refused(tmp_path: Path, capsys: Capture) -> None:
    assert_refused(
        run(capsys, "report", tmp_path), 2, "is not the output folder of a study: no study.parquet"
    )


def test_a_study_makes_its_pages_and_again_only_what_is_new(tmp_path: Path, capsys: Capture) -> None:
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    write_raw(folder / "a<b>&.raw", still_counts(directions(60)))
    words = ("study", folder, "-d", out, "--report-only", "-j", "1", "--html")
    done = run(capsys, *words)
    assert done.code == 0
    assert "study.html and 1 recording page" in done.err
    root = parsed((out / "study.html").read_text())
    check_page(root)
    (link,) = {
        one.attributes["href"] for one in root.all("a") if ".html" in (one.attributes["href"] or "")
    } or {None}
    table = data_of(root)["recordings"]
    assert link == "./a%3Cb%3E%26.html"  # of its hours
    assert table["pages"] == [1] and cell_texts(table, "path") == ["a<b>&.raw"]
    made_by = dict(zip(*([one.whole() for one in root.all(tag)] for tag in ("dt", "dd")), strict=True))
    assert made_by["Results in"] == "out" and f"-d {out}" in made_by["Command"]
    assert made_by["Newest result"].endswith(" UTC")
    assert (out / "a<b>&.html").is_file()
    before = stamps(out)
    assert "study.html and 0 recording pages (1 unchanged)" in run(capsys, *words).err
    assert stamps(out) == before
    assert_refused(run(capsys, *words, "--shard", "1/2"), 2, "--html")


@pytest.mark.nightly
def test_ten_thousand_recordings_take_two_and_a_half_megabytes(tmp_path: Path) -> None:
    out = made_study.study(tmp_path, list(made_study.rows(10_000)))
    write_study_pages(out)
    assert (out / "study.html").stat().st_size < 2_500_000


def test_five_hundred_recordings_take_no_more_than_their_share(varied: str) -> None:
    assert len(varied.encode()) < 60_000 + 500 * 240


def test_bars_by_month_have_all_recordings_with_a_date() -> None:
    """Heights add up to the numbers, counted here."""
    starts = ["2025-01-06T09:30:00", "2025-01-31T00:00:00", "2025-03-01T00:00:00", None, "what"]
    outcomes = ["calibrated", "refused", "calibrated", "calibrated", "failed"]
    months = study_figures.by_month(starts, outcomes, ["calibrated", "refused"])
    assert months is not None and months.omitted == 2
    drawn = [(one.text, one.height) for one in months.bars]
    assert drawn == [
        ("2025-01: 1 calibrated", 65.0),
        ("2025-01: 1 refused", 65.0),
        ("2025-03: 1 calibrated", 65.0),
    ]
    bottom, above = months.bars[:2]
    assert above.y + above.height == bottom.y and months.bars[2].y == bottom.y
    assert [tick.label for tick in months.ticks] == ["2025-01", "2025-02", "2025-03"]
    assert study_figures.by_month(starts[:2], outcomes[:2], []) is None


def test_a_clock_that_was_never_set_does_not_hide_the_months_of_others() -> None:
    """Of 70 months the last 60 are drawn; years that no study has are not among them."""
    starts = [f"{2019 + month // 12}-{month % 12 + 1:02d}-01T00:00:00" for month in range(70)]
    odd = ["1980-01-01T00:00:00", "2079-06-01T00:00:00"]
    months = study_figures.by_month(starts + odd, ["calibrated"] * 72, ["calibrated"])
    assert months is not None and len(months.bars) == 60 and months.omitted == 12
    assert months.ticks[0].label == "2019-11"


def test_the_line_of_the_limit_is_where_the_axis_says() -> None:
    scatter = study_figures.Scatter.of([(40.0, 0.5), (30.0, 20.0)])
    assert scatter.limit(10.0) == f"M{scatter.x.begin} {scatter.y.at(10.0)}H{scatter.x.end}"
    assert study_figures.Scatter.of([(4.0, 0.5)]).limit(100.0) == ""


def test_51_3_hours_of_wear_have_a_figure_and_a_table_by_device_and_site() -> None:
    rows = [
        row("wrist/a.cwa", wear_hours=2.0, device_model="AX3", calibration_error_mg=4.0),
        row("wrist/b.cwa", "refused", wear_hours=2.5, device_model="AX3", calibration_error_mg=None),
        row("wrist/c.cwa", wear_hours=None, duration_s=30 * 3600, device_model="AX3"),
        row("hip_d.gt3x", wear_hours=200.0, device_model="Link", calibration_error_mg=0.5),
        row("hip_copy.gt3x", wear_hours=200.0, device_model="Link", copy_of="hip_d.gt3x"),
    ]
    root = parsed(page(content(*rows)))
    check_page(root)
    (table,) = (one for one in root.all("table") if "by hours of wear" in one.whole())
    assert [[cell.whole() for cell in line.all("th", "td")] for line in table.all("tr")] == [
        ["Device", "1 to 3 h", "24 to 72 h", "168 h or more"],
        ["AX3, wrist", "50 % of 2, 4 mg", "100 % of 1, 1 mg", ""],
        ["Link, hip", "", "", "100 % of 1, 0.5 mg"],
        ["all", "50 % of 2, 4 mg", "100 % of 1, 1 mg", "100 % of 1, 0.5 mg"],
    ]


def test_51_3_errors_are_drawn_against_hours_of_wear() -> None:
    known = [Wear("AX3", 1.0, "calibrated", True, 10.0), Wear("AX3", 10.0, "calibrated", True, 1.0)]
    figure = by_wear([*known, Wear("AX3", None, "failed", False, None)])
    assert figure is not None and figure.head == ["1 to 3 h", "6 to 12 h"]
    (first, second), x, y = figure.scatter.places, figure.scatter.x, figure.scatter.y
    assert first == (x.at(1.0), y.at(10.0)) and second == (x.at(10.0), y.at(1.0))
    assert by_wear(known[:1]) is None


def test_u50_decisions_are_on_the_page_and_hostile_ones_are_texts() -> None:
    """A file of `study.json` that others changed leaves nothing on the page but texts."""
    good = ["a.cwa", "no", "</script><img src=x>", "=who", "2026", "r1"]
    nonsense: list[Any] = [None, "text", ["a.cwa", "no"], [*good[:5], 3], ["a.cwa", "delete", "", "", "", ""]]
    found = [{"message": f"{name} is odd"} for name in HOSTILE]
    held = {"file": HOSTILE[0], "rows": [good, *nonsense], "rows_not_listed": 7}
    to_act_on = {"number": 9 + len(found), "listed": [*found, "nonsense", 3]}
    no = {"use": "no", "decided_by": "=who", "result": "r1"}
    no |= {"why": "A person decided not to use it: <b>loose</b>."}
    rows = (row("a.cwa", **no), row("b.cwa", use="no"))
    text = page(content(*rows, summary={"decisions": held, "findings": to_act_on}))
    root = parsed(text)
    check_page(root)
    assert data_of(root)["decisions"] == [good] and data_of(root)["decisions_not_listed"] == 7
    assert root.whole().count(" is odd") == len(found) and "and 9 more" in root.whole()
    assert data_of(root)["recordings"]["results"] == ["r1", ""]
    assert "<b>loose" not in text and "&lt;b&gt;loose&lt;/b&gt;" in text
    assert not SHAPELESS.search(text)
    assert "<dt>Can be used</dt><dd>1 (50.0 %)</dd>" in text
    for odd in (None, 3, {"rows": 3, "listed": None}, {"rows": {"a": 1}, "listed": 3, "number": "x"}):
        changed = parsed(page(content(*rows, summary={"decisions": odd, "findings": odd})))
        assert data_of(changed)["decisions"] == [] and data_of(changed)["decisions_not_listed"] == 0
