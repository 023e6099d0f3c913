"""Hours as strips by `pages/study_figures.py`: states of hours, and boxes as long as their runs."""

from __future__ import annotations

from typing import Any

from accelcal_cli.pages.study_figures import STRIPS_LEFT as LEFT
from accelcal_cli.pages.study_figures import STRIPS_WIDTH as WIDTH
from accelcal_cli.pages.study_figures import states_of, strips

ROWS: dict[str, list[Any]] = {
    "samples": [100, 100, 100, 100, 0, 100, 100],
    "still": [50, 95, 50, 0, 0, 10, 1],
    "moving": [50, 5, 0, 0, 0, 0, 9],
    "filled": [0, 0, 0, 60, 0, 0, 0],
    "gap_s": [0.0, 0.0, 0.0, 0.0, 0.0, 1800.0, 0.0],
    "worn": [True, True, False, True, None, True, None],
}
STATES = ["worn", "still", "off", "filled", "gap", "gap", "unknown"]


def test_each_hour_is_what_it_is_mostly() -> None:
    assert states_of({"row": {"seconds": 3600.0}, "rows": ROWS}) == (STATES, 3600.0)


def test_what_is_no_quality_file_has_no_hours() -> None:
    assert states_of({}) is None
    assert states_of({"row": {"seconds": "long"}, "rows": ROWS}) is None
    assert states_of({"row": {"seconds": 3600.0}, "rows": ROWS | {"worn": [True]}}) is None
    assert strips([]) is None


def test_boxes_are_as_long_as_the_runs_of_hours() -> None:
    figure = strips([("a/b.cwa", "./b.html", (["gap"] * 12 + ["worn"] * 36, 3600.0))])
    assert figure is not None
    (row,) = figure.rows
    day = (WIDTH - LEFT - 10) / 2
    assert (row.name, row.href) == ("b.cwa", "./b.html")
    assert dict(row.paths) == {
        "gap": f"M{LEFT} {row.y}h{day / 2}v12h-{day / 2}z".replace("M170 ", "M170.0 "),
        "worn": f"M{LEFT + day / 2} {row.y}h{1.5 * day}v12h-{1.5 * day}z",
    }
    assert figure.ticks == [(170.0, "0"), (170 + day, "1"), (170 + 2 * day, "2")]
