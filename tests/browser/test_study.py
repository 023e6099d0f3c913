"""The page of a study in a real browser: offline, by keyboard, for a screen reader, on paper, and fast."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.cli.main import cli
from accelcal_cli.core.errors import printable
from accelcal_cli.pages.write import write_study_pages
from tests.browser.conftest import Opened
from tests.pages import made_study
from tests.pages.test_study_page import HOSTILE
from tests.recordings import GAIN, LSB_PER_G, OFFSET_G, directions, write_raw

Opens = Callable[..., Opened]
MANY = 10_000
LOAD_MS, SORT_MS = 500, 100
"""What is asked of a page of MANY recordings."""
HOUR = 1800
"""Samples at half a hertz."""
DAYS = 6
STEP_AT = "2024-03-07T14:00"
"""The fourth day."""


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a large study, whose recordings' pages are not made."""
    out = made_study.study(tmp_path_factory.mktemp("many"), list(made_study.rows(MANY)))
    write_study_pages(out)
    return out / "study.html"


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a study of 200 recordings with pages of their own, some with hostile names."""
    out, rows = tmp_path_factory.mktemp("few"), list(made_study.rows(200))
    for number, name in enumerate(HOSTILE):
        shown = printable(name)
        serial = name.encode("utf-8", "replace").decode()
        rows[5 + number] |= {"path": shown, "device_serial": serial, "message": shown}
    made_study.study(out, rows)
    for one in rows:
        if one["report"]:
            path = out / one["report"]
            path.parent.mkdir(exist_ok=True)
            path.write_text(json.dumps(made_study.base_report()))
    write_study_pages(out)
    return out / "study.html"


@pytest.fixture(scope="module")
def stepped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a real study of one sensor whose z offset jumps by 20 mg on its fourth day."""
    folder, out = tmp_path_factory.mktemp("stepped"), tmp_path_factory.mktemp("out")
    count = DAYS * 24 * HOUR
    poses = np.repeat(directions(DAYS * 24 * 6), HOUR // 6, axis=0)
    step = (np.arange(count) >= (3 * 24 + 14) * HOUR)[:, None] * np.array([0.0, 0.0, 0.020])
    raw = poses @ np.linalg.inv(GAIN).T - OFFSET_G + step
    noise = 0.003 * np.random.RandomState(4).standard_normal(raw.shape)
    write_raw(folder / "jumps.raw", np.rint((raw + noise) * LSB_PER_G).astype(np.int16))
    layout = folder / "jumps.layout.toml"
    layout.write_text(layout.read_text().replace("rate_hz = 25.0", "rate_hz = 0.5"))
    words = ["study", str(folder), "-d", str(out), "--report-only", "-j", "1", "-q", "--html"]
    assert cli.main(words, standalone_mode=False) == 0
    return out / "study.html"


def status(opened: Opened) -> str:
    text: str = opened.page.inner_text("#recordings-count")
    return text


def violations(opened: Opened, axe: str) -> list[Any]:
    """What axe-core finds, and where."""
    opened.page.evaluate(axe)
    found = opened.page.evaluate("axe.run(document, {resultTypes: ['violations']})")["violations"]
    return [(one["id"], [node["html"][:200] for node in one["nodes"]]) for one in found]


def shown_rows(opened: Opened, key: int) -> list[str]:
    """Cells of a column in the rows that exist, in their order."""
    cells = opened.page.locator(f"#recordings-grid tbody tr:not(.space) td:nth-child({key + 1})")
    texts: list[str] = cells.all_text_contents()
    return texts


def test_the_page_opens_without_a_request_or_a_complaint(few: Path, opened: Opens) -> None:
    window = opened(few)
    assert window.complaints == []
    assert window.requests == [few.as_uri()]
    assert status(window) == "200 recordings"


def test_the_policy_keeps_out_what_is_not_ours(few: Path, opened: Opens) -> None:
    """A script, a style and a picture that got into the page do nothing."""
    window = opened(few)
    window.page.evaluate(
        """() => {
          const script = document.createElement("script");
          script.textContent = "window.caught = true";
          document.body.append(script);
          const image = document.createElement("img");
          image.src = "https://example.org/x.png";
          document.body.append(image);
        }"""
    )
    window.page.wait_for_timeout(200)
    assert window.page.evaluate("window.caught") is None
    assert len(window.complaints) == 2
    assert all("Content Security Policy" in one for one in window.complaints)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", ["few", "stepped"])
def test_axe_finds_nothing(
    name: str, scheme: str, opened: Opens, axe: str, shots: Path, request: pytest.FixtureRequest
) -> None:
    window = opened(request.getfixturevalue(name), color_scheme=scheme, bypass_csp=True)
    assert violations(window, axe) == []
    window.page.screenshot(path=shots / f"study-{name}-{scheme}.png", full_page=True)


def test_sorting_by_keyboard(few: Path, opened: Opens) -> None:
    window = opened(few)
    window.page.focus("#recordings-grid thead th:nth-child(8) button")
    window.page.keyboard.press("Enter")
    head = window.page.locator("#recordings-grid thead th:nth-child(8)")
    assert head.get_attribute("aria-sort") == "ascending"
    values = [float(text) for text in shown_rows(window, 7)]
    assert len(values) > 10 and values == sorted(values)
    assert status(window) == "200 recordings, sorted by after, mg, ascending"
    window.page.keyboard.press("Space")
    assert head.get_attribute("aria-sort") == "descending"
    values = [float(text) for text in shown_rows(window, 7)]
    assert values == sorted(values, reverse=True)
    window.page.keyboard.press("Tab")
    window.page.keyboard.press("Enter")
    assert head.get_attribute("aria-sort") is None
    assert window.page.locator("#recordings-grid th[aria-sort]").count() == 1


LAST_IS_EMPTY = """() => {
  const rows = document.querySelectorAll("#recordings-grid tbody tr:not(.space)");
  return !rows[rows.length - 1].children[7].textContent;
}"""


def test_what_is_not_known_comes_last_either_way(few: Path, opened: Opens) -> None:
    window = opened(few)
    for _ in range(2):
        window.page.click("#recordings-grid thead th:nth-child(8) button")
        assert "" not in shown_rows(window, 7)
        window.page.locator("#recordings-grid").evaluate("box => { box.scrollTop = box.scrollHeight; }")
        window.page.wait_for_function(LAST_IS_EMPTY)
        assert shown_rows(window, 7)[-1] == ""


def test_filtering_by_keyboard(few: Path, opened: Opens) -> None:
    window = opened(few)
    window.page.focus("#wanted-text")
    window.page.keyboard.type("wrist_WEEK3")
    assert status(window).startswith("24 of 200 recordings")
    assert all("_wrist_week3." in path for path in shown_rows(window, 0))
    assert window.page.locator("#recordings-grid table").get_attribute("aria-rowcount") == "25"
    window.page.keyboard.press("Tab")
    window.page.keyboard.press("r")
    assert window.page.input_value("#wanted-outcome") == "refused"
    assert set(shown_rows(window, 1)) <= {"refused"}
    window.page.keyboard.press("Tab")
    window.page.keyboard.press("Tab")
    window.page.keyboard.press("Enter")
    assert status(window) == "200 recordings"
    assert window.page.input_value("#wanted-text") == ""


def test_arrow_keys_go_from_recording_to_recording(few: Path, opened: Opens) -> None:
    window = opened(few)
    window.page.fill("#wanted-text", "site05/")
    window.page.focus("#recordings-grid tbody a >> nth=0")
    names = [window.page.evaluate("document.activeElement.textContent")]
    for _ in range(3):
        window.page.keyboard.press("ArrowDown")
        names.append(window.page.evaluate("document.activeElement.textContent"))
    assert names == shown_rows(window, 0)[:4]
    window.page.keyboard.press("End")
    assert window.page.evaluate("document.activeElement.textContent") == shown_rows(window, 0)[-1]


def test_rows_and_dots_lead_to_the_recordings_pages(few: Path, opened: Opens) -> None:
    window = opened(few)
    for link in window.page.locator("#recordings-grid tbody a").all()[:20]:
        assert Path(few.parent, *_parts(link)).is_file()
    window.page.focus("#at-dot")
    first = window.page.get_attribute("#at-dot", "aria-label")
    window.page.keyboard.press("ArrowRight")
    second = window.page.get_attribute("#at-dot", "aria-label")
    assert first != second and second.startswith(window.page.inner_text("#dot-says"))
    assert Path(few.parent, *_parts(window.page.locator("#at-dot"))).is_file()
    window.page.keyboard.press("Enter")
    window.page.wait_for_url(lambda url: url.startswith(few.parent.as_uri()) and "study.html" not in url)


def _parts(link: Any) -> tuple[str, ...]:
    from urllib.parse import unquote

    return tuple(unquote(link.get_attribute("href"), errors="surrogateescape").split("/"))


def test_pointing_at_a_dot_names_its_recording(few: Path, opened: Opens) -> None:
    window = opened(few)
    window.page.locator("#scatter").scroll_into_view_if_needed()
    window.page.locator("#scatter .marked").first.hover(force=True)
    assert "mg before" in window.page.inner_text("#dot-says")


def test_hostile_names_are_shown_as_they_are(few: Path, opened: Opens) -> None:
    window = opened(few)
    window.page.fill("#wanted-text", "<script>alert")
    assert shown_rows(window, 0)[0] == HOSTILE[0]
    window.page.fill("#wanted-text", "onerror")
    assert shown_rows(window, 0) == [HOSTILE[1]]
    assert window.page.locator("img").count() == 0
    assert window.complaints == []


def test_without_javascript_the_problems_are_there(few: Path, opened: Opens) -> None:
    window = opened(few, java_script_enabled=False)
    assert window.page.locator("#recordings-grid").is_hidden()
    assert "needs JavaScript" in window.page.inner_text("main")
    assert window.page.locator(".problems tbody tr").count() > 10


def test_a_print_has_the_problems_and_no_table_of_all(few: Path, opened: Opens, shots: Path) -> None:
    window = opened(few)
    window.page.pdf(
        path=shots / "study.pdf",
        format="A4",
        margin=dict.fromkeys(("top", "bottom", "left", "right"), "15mm"),
    )
    window.page.emulate_media(media="print")
    assert window.page.locator("#recordings-grid").is_hidden()
    assert window.page.locator("#recordings-filters").is_hidden()
    assert "List of problems" in window.page.inner_text("main")
    assert "All recordings, with all figures, are in study.csv." in window.page.inner_text("main")
    assert window.page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"


def test_a_narrow_window_scrolls_in_the_table_alone(few: Path, opened: Opens) -> None:
    window = opened(few)
    window.page.set_viewport_size({"width": 360, "height": 700})
    assert window.page.evaluate("document.documentElement.scrollWidth") <= 360


def test_a_step_on_the_fourth_day_is_seen_and_said(stepped: Path, opened: Opens) -> None:
    window = opened(stepped)
    first = window.page.inner_text("main").split("\nOutcomes\n")[0]
    assert "The sensor changed while it recorded: 1 recording" in first
    assert f"its offsets jump at {STEP_AT}" in first
    size = float(first.split("by up to ")[1].split(" mg")[0])
    assert 19 <= size <= 22
    assert shown_rows(window, 5) == ["sensor changed"]
    assert float(shown_rows(window, 14)[0]) == pytest.approx(size, abs=0.11)


def test_ten_thousand_recordings_load_and_sort_fast(many: Path, opened: Opens) -> None:
    """Half a second until it is painted, and a tenth: measured, but asked for with ACCELCAL_TIMED only."""
    assert many.stat().st_size <= 2_500_000
    loads, own = zip(*[load_ms(many, opened) for _ in range(5)], strict=True)
    window = opened(many)
    assert status(window) == "10,000 recordings"
    assert window.page.locator("#recordings-grid tbody tr").count() < 60
    heads = window.page.locator("#recordings-grid thead button").count()
    sorts = [min(window.page.evaluate(SORTED_MS, head)) for head in range(heads)]
    print(f"load {min(loads):.0f} ms, {min(own):.0f} ms of it its own work; sort {max(sorts):.0f} ms at most")
    if os.environ.get("ACCELCAL_TIMED"):
        assert min(loads) < LOAD_MS
        assert max(sorts) < SORT_MS


SORTED_MS = """head => [1, 2, 3].map(() => {
  const begun = performance.now();
  document.querySelectorAll("#recordings-grid thead button")[head].click();
  document.body.getBoundingClientRect();
  return performance.now() - begun;
})"""
PAINTED_MS = "new Promise(done => requestAnimationFrame(() => setTimeout(() => done(performance.now()), 0)))"


def load_ms(path: Path, opened: Opens) -> tuple[float, float]:
    """How long a page takes until it is painted, and for how long of this its own thread computed [ms]."""
    window = opened(None)
    session = window.page.context.new_cdp_session(window.page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})
    window.page.goto(path.as_uri())
    painted = window.page.evaluate(PAINTED_MS)
    held = {one["name"]: one["value"] for one in session.send("Performance.getMetrics")["metrics"]}
    window.page.context.close()
    return painted, 1000 * held["TaskDuration"]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_of_a_recording_stands_alone_and_says_its_step(
    stepped: Path, scheme: str, opened: Opens, axe: str, shots: Path
) -> None:
    page = stepped.with_name("jumps.html")
    window = opened(page, color_scheme=scheme)
    assert (window.complaints, window.requests) == ([], [page.as_uri()])
    assert f"its offsets jump at {STEP_AT}" in window.page.inner_text("main")
    window.page.screenshot(path=shots / f"recording-{scheme}.png", full_page=True)
    assert violations(opened(page, color_scheme=scheme, bypass_csp=True), axe) == []
