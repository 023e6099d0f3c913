"""Who borrows from whom, by rules that a table of own results decides."""

from __future__ import annotations

from typing import Any

from accelcal_cli.studies.other_recordings import donors, identity, pools


def row(outcome: str = "calibrated", after_mg: float | None = 1.0, **more: Any) -> dict[str, Any]:
    held = {
        "outcome": outcome, "after_mg": None if outcome == "refused" else after_mg, "device_serial": "A1",
        "device_model": None, "start_time": "2024-03-04T00:00:00.000000", "duration_s": 3600.0,
        "lost_percent": 0.0, "lsb_per_g": 256.0, "range_g": 8.0,
    }  # fmt: skip
    return held | more


def at(day: int, hour: int = 0, zone: str = "", **more: Any) -> dict[str, Any]:
    return row(start_time=f"2024-03-{day:02}T{hour:02}:00:00.000000{zone}", **more)


def asked(rows: dict[str, dict[str, Any]], *, compare: bool = True) -> dict[str, list[str]]:
    return donors(rows, compare=compare)


def test_the_nearest_lends_first_by_the_time_between_end_and_start() -> None:
    """b begins 22 h after the refused one; c ended two days before it, but began nine days before."""
    rows = {
        "a": at(20, outcome="refused"),
        "b": at(20, 23),
        "c": at(11, duration_s=7 * 86400.0 + 3600),
        "d": at(20, 22, zone="+05:00"),
        "e": at(10),
    }
    assert asked(rows) == {"a": ["d", "b", "c"]}


def test_ties_go_by_name_and_what_has_no_time_comes_last() -> None:
    rows = {"x": at(4, outcome="refused"), "b": at(5), "a": at(3), "c": row(start_time=None)}
    assert asked(rows) == {"x": ["a", "b", "c"]}
    rows["x"]["start_time"] = None
    assert asked(rows) == {"x": ["a", "b", "c"]}


def test_offsets_count_where_both_recordings_have_one() -> None:
    """By the clocks b is nearer, 2 h after the end at 12:00; in UTC it begins 7 h after it, and c 4 h."""
    ends = at(20, 11, zone="+05:00", outcome="refused")
    assert asked({"a": ends, "b": at(20, 14, zone="+00:00"), "c": at(20, 16, zone="+05:00")}) == {
        "a": ["c", "b"]
    }
    assert asked({"a": ends, "b": at(20, 14), "c": at(20, 16)}) == {"a": ["b", "c"]}


def test_a_clock_at_the_end_of_all_times_is_far_from_all() -> None:
    """The end of a recording that begins in the last hour of the year 9999 has no date."""
    late = row(start_time="9999-12-31T23:30:00.000000")
    assert asked({"x": row("refused"), "a": late, "b": at(20)}) == {"x": ["b", "a"]}
    assert asked({"x": {**late, "outcome": "refused"}, "b": row(), "a": row()}) == {"x": ["a", "b"]}


def test_only_the_same_device_lends() -> None:
    good = {"a": row(device_serial="B2"), "b": row(device_serial=None), "c": row(device_serial="")}
    assert asked({"x": row("refused"), **good}) == {}
    assert asked({"x": row("refused", device_serial=None), **good}) == {}
    assert asked({"x": row("refused", device_serial=""), **good}) == {}
    models = {"a": row(device_model="AX3"), "b": row(device_model="GENEActiv"), "c": row()}
    assert asked({"x": row("refused", device_model="AX3"), **models}) == {"x": ["a", "c"]}


def test_only_good_recordings_lend_and_who_borrows_does_not() -> None:
    rows = {
        "x": row("refused"),
        "y": row("refused"),
        "z": row(after_mg=6.0),
        "a": row("reduced_model", after_mg=2.0),
        "b": row("already_good", after_mg=2.0),
    }
    assert asked(rows) == {name: ["a", "b"] for name in "xyz"}


def test_what_is_lost_to_damage_does_not_borrow() -> None:
    rows = {"x": row("refused", reason="damaged"), "y": row("refused", lost_percent=60.0), "a": row()}
    assert asked(rows) == {"y": ["a"]}


def test_a_calibration_is_looked_at_again_where_it_is_twice_and_a_milligravity_poorer() -> None:
    assert asked({"x": row(after_mg=2.0), "a": row(after_mg=1.0)}) == {"x": ["a"]}
    assert asked({"x": row(after_mg=1.99), "a": row(after_mg=1.0)}) == {}
    assert asked({"x": row(after_mg=1.4), "a": row(after_mg=0.5)}) == {}
    assert asked({"x": row(after_mg=2.0), "a": row(after_mg=1.0)}, compare=False) == {}


def test_at_most_three_are_asked() -> None:
    rows = {"x": at(20, outcome="refused"), **{f"a{day}": at(day) for day in range(1, 10)}}
    assert asked(rows) == {"x": ["a9", "a8", "a7"]}


def test_pooled_recordings_stay_as_they_are_but_lend() -> None:
    rows = {"x": row("refused"), "a": row(after_mg=4.0), "b": row(after_mg=1.0)}
    assert asked(rows) == {"x": ["b"], "a": ["b"]}
    assert donors(rows, compare=True, settled=["a"]) == {"x": ["a", "b"]}


def test_a_pool_agrees_in_device_counts_per_g_and_range() -> None:
    rows = {
        "b": row("refused"), "a": row(), "model": row(device_model="AX3"), "fine": row(lsb_per_g=2048.0),
        "wide": row(range_g=16.0), "other": row(device_serial="B2"), "none": row(device_serial=None),
        "damaged": row("refused", reason="damaged"), "less": row("already_good", lost_percent=40.0),
    }  # fmt: skip
    rows = {name: {**held, "sha256": name} for name, held in rows.items()}
    assert pools(rows) == [["a", "b", "less"]]
    finer = rows["fine"] | {"sha256": "finer"}
    assert pools({**rows, "finer": finer}) == [["a", "b", "less"], ["fine", "finer"]]
    assert pools({**rows, "copy": rows["fine"], "again": rows["a"]}) == [["a", "b", "less"]]
    assert pools({"a": rows["a"]}) == []


def test_any_change_of_a_result_is_another_identity() -> None:
    assert identity(row()) == identity(row())
    assert identity(row()) != identity(row(after_mg=1.0001))


def test_a_recording_whose_sensor_changed_lends_nothing_and_is_in_no_pool() -> None:
    kinds = {"a": "step", "b": "none", "c": None}
    rows = {"x": row("refused"), **{name: row(change=kind) for name, kind in kinds.items()}}
    rows = {name: {**held, "sha256": name} for name, held in rows.items()}
    assert asked(rows, compare=False) == {"x": ["b", "c"]}
    assert pools(rows) == [["b", "c", "x"]]


def test_verdicts_14_copies_of_a_donor_take_no_places_of_other_donors() -> None:
    rows = {"x": at(20, outcome="refused", sha256="x"), "c": at(18, sha256="c"), "d": at(17, sha256="d")}
    rows |= {name: at(19, sha256="b") for name in ("b", "b2", "b3", "b4")}
    assert asked(rows) == {"x": ["b", "c", "d"]}
