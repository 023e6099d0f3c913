"""Issue 50, item 7: what people decide on the page of a study, and saves as decisions.csv."""

from __future__ import annotations

import json
import re
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.core.errors import printable
from accelcal_cli.output.decisions import Decisions, merged, read_decisions
from accelcal_cli.pages.write import write_study_pages
from accelcal_cli.studies import findings, summary
from tests.browser.conftest import Opened
from tests.browser.test_study import Opens, violations
from tests.pages import made_study
from tests.pages.test_study_page import HOSTILE

FIRST = "#recordings-grid tbody tr:not(.space) >> nth=0"
EARLIER = (
    "recording,use,note,who,when,result\n"
    "site04/S00040_wrist_week0.cwa,no,strap,B. Meyer,2026-11-27,r0\n"
    "elsewhere.cwa,yes,,,,\n"
)


@pytest.fixture(scope="module")
def table() -> list[dict[str, Any]]:
    rows = list(made_study.rows(60))
    for number, name in enumerate(HOSTILE):
        rows[5 + number] |= {"path": printable(name)}
    return sorted(rows, key=lambda row: str(row["path"]))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory, table: list[dict[str, Any]]) -> Path:
    """The page of a study with one decision, on a result that has changed, and one without its recording."""
    out = tmp_path_factory.mktemp("decided")
    (out / "decisions.csv").write_text(EARLIER)
    made = merged(read_decisions(out / "decisions.csv"), table)
    rows = [row | made.changes.get(row["path"], {}) for row in table]
    to_act_on = findings.as_json([*findings.of_decisions(made, {})])
    summary.write(summary.Summary(rows, {}, decisions=made, findings=to_act_on), out, "study")
    write_study_pages(out)
    return out / "study.html"


def decide(window: Opened, path: str, choice: str, note: str = "") -> None:
    """Choose for a recording, after looking for it."""
    window.page.fill("#wanted-text", path)
    window.page.get_by_label(f"decision on {path}", exact=True).select_option(label=choice)
    if note:
        field = window.page.get_by_label(f"note on {path}", exact=True)
        field.fill(note)
        field.press("Enter")


def saved(window: Opened, folder: Path) -> Decisions:
    """Save the decisions and read them as a study does."""
    with window.page.expect_download() as download:
        window.page.click("#save-decisions")
    assert download.value.suggested_filename == "decisions.csv"
    path = folder / "decisions.csv"
    download.value.save_as(path)
    return read_decisions(path)


def test_u50_what_is_decided_on_the_page_is_merged_by_a_study(
    page: Path, table: list[dict[str, Any]], opened: Opens, tmp_path: Path
) -> None:
    """Hostile names, formulas and quotes come back as they were, and earlier decisions stay."""
    window = opened(page)
    assert (window.complaints, window.requests) == ([], [page.as_uri()])
    paths = [printable(name) for name in HOSTILE]
    notes = ["=1+1", 'a "quoted"; note, with all', "-", "Größe", "@x"]
    window.page.fill("#who", "Ana Núñez")
    for at, path in enumerate(paths):
        decide(window, path, ("exclude", "with care", "use")[at % 3], notes[at % len(notes)])
    found = saved(window, tmp_path)
    assert found.findings == []
    rows = {one.recording: one for one in found.rows}
    assert {*rows} == {*paths, "site04/S00040_wrist_week0.cwa", "elsewhere.cwa"}
    assert rows["site04/S00040_wrist_week0.cwa"].note == "strap"
    made = merged(found, table)
    assert [one.code for one in made.findings] == ["decision_without_recording", "decision_outdated"]
    for at, path in enumerate(paths):
        change = made.changes[path]
        assert (change["use"], change["note"]) == (("no", "with care", "yes")[at % 3], notes[at % len(notes)])
        assert change["decided_by"] == "Ana Núñez"
        assert datetime.fromisoformat(change["decided_at"] or "").utcoffset() is not None
    data = (tmp_path / "decisions.csv").read_bytes()
    assert data.startswith(b"\xef\xbb\xbfrecording,use,note,who,when,result\r\n")
    assert window.complaints == []


def test_u50_the_page_shows_decisions_and_what_is_wrong_with_them(page: Path, opened: Opens) -> None:
    window = opened(page, java_script_enabled=False)
    text = window.page.inner_text("main")
    assert "decisions.csv: Row 3 names elsewhere.cwa, which is not a recording of the study." in text
    assert "has changed since row 2 decided no" in text
    assert "A person decided not to use it (B. Meyer, 2026-11-27): strap." in text
    window = opened(page)
    decision = window.page.get_by_label("decision on site04/S00040_wrist_week0.cwa")
    assert (decision.input_value(), decision.get_attribute("title")) == ("no", "strap, B. Meyer, 2026-11-27")
    assert window.page.inner_text("#decided-count") == "2 decisions"


def test_u50_a_decision_is_taken_back_and_made_by_keyboard(page: Path, opened: Opens, tmp_path: Path) -> None:
    window = opened(page)
    decide(window, "site04/S00040_wrist_week0.cwa", "")
    assert window.page.get_by_label("note on site04/S00040_wrist_week0.cwa").is_disabled()
    window.page.fill("#wanted-text", "site11/")
    window.page.locator(FIRST).locator("a, select").first.focus()
    if window.page.evaluate("document.activeElement.tagName") == "A":
        window.page.keyboard.press("Tab")
    window.page.keyboard.press("e")
    name = window.page.evaluate("document.activeElement.getAttribute('aria-label')").removeprefix(
        "decision on "
    )
    window.page.keyboard.press("Tab")
    window.page.keyboard.type("by keyboard")
    window.page.keyboard.press("Tab")
    found = saved(window, tmp_path)
    assert [(one.recording, one.use, one.note) for one in found.rows] == [
        ("elsewhere.cwa", "yes", ""), (name, "no", "by keyboard"),
    ]  # fmt: skip
    assert re.match("2 decisions, saved as a download", window.page.inner_text("#decided-count"))


def test_u50_marks_outlive_a_reload_until_the_file_has_them(
    page: Path, opened: Opens, tmp_path: Path
) -> None:
    path = "site08/S00044_wrist_week4.cwa"
    window = opened(page)
    decide(window, path, "exclude", "cold")
    decide(window, "site04/S00040_wrist_week0.cwa", "use")
    window.page.reload()
    window.page.fill("#wanted-text", path)
    assert window.page.get_by_label(f"note on {path}").input_value() == "cold"
    window.page.evaluate(
        """() => {
          const key = Object.keys(localStorage).find((one) => one.startsWith("accelcal decisions"));
          const kept = JSON.parse(localStorage.getItem(key));
          kept.chosen[1][2] = '[["another", "row"]]';
          kept.chosen.push(["x", ["too", "short"], null]);
          localStorage.setItem(key, JSON.stringify(kept));
        }"""
    )
    window.page.reload()
    found = saved(window, tmp_path)
    assert {one.recording: one.use for one in found.rows} == {
        path: "no", "site04/S00040_wrist_week0.cwa": "no", "elsewhere.cwa": "yes",
    }  # fmt: skip


@pytest.mark.parametrize("kept", ["no", "{", "[]", json.dumps({"who": 1, "chosen": [[1]]})])
def test_u50_a_browser_that_keeps_nothing_or_nonsense_is_borne(
    page: Path, opened: Opens, tmp_path: Path, kept: str
) -> None:
    window = opened(None)
    denied = "Object.defineProperty(window, 'localStorage', { get() { throw new Error('denied'); } })"
    nonsense = f"localStorage.setItem('accelcal decisions ' + location.pathname, {json.dumps(kept)})"
    window.page.add_init_script(denied if kept == "no" else nonsense)
    window.page.goto(page.as_uri())
    decide(window, "site08/S00044_wrist_week4.cwa", "with care")
    assert len(saved(window, tmp_path).rows) == 3
    assert window.complaints == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_u50_axe_finds_nothing_where_people_decide(
    page: Path, scheme: str, opened: Opens, axe: str, shots: Path
) -> None:
    window = opened(page, color_scheme=scheme, bypass_csp=True)
    decide(window, "site08/S00044_wrist_week4.cwa", "exclude", "cold")
    assert violations(window, axe) == []
    window.page.locator("#recordings").scroll_into_view_if_needed()
    window.page.screenshot(path=shots / f"decisions-{scheme}.png")
