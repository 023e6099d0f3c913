"""Settings back from a report by `pipeline/options.py`: complete, bounded, honest about what was assumed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.settings import (
    DEFAULT,
    PAPER,
    STILLNESS,
    Adaptive,
    PoseSettings,
    Settings,
    setting_of,
    with_stillness,
)
from accelcal_cli.output.report_reading import Document
from accelcal_cli.pipeline.jobs import Request
from accelcal_cli.pipeline.options import ReportSettings, settings_from_report
from accelcal_cli.segment.adaptive import MOVING, NEVER


def bounded(*kinds: Any) -> dict[str, tuple[float, float]]:
    """Lower and upper bounds of all fields that have them."""
    declared = {name: setting_of(kind, name) for kind in kinds for name in kind.__dataclass_fields__}
    return {name: (one.low, one.high) for name, one in declared.items() if None not in (one.low, one.high)}


LIMITS = {
    "shift_s": (-1e9, 1e9),
    "segment_seconds": (1e-6, 3600),
    "stillness_threshold_g": (1e-9, 4),
    "stillness_deviation_g": (1e-9, 4),
    "stillness_axes": (0, 2),
    "cells_per_g": (1, 1000),
    "norm_low_g": (0, 10),
    "norm_high_g": (0, 10),
    "posture_degrees": (1e-3, 180),
    "folds": (2, 1000),
    "min_postures": (2, 1_000_000),
    "coverage_g": (0, 4),
    "max_error_mg": (0, 1e6),
    "min_temperature_range_c": (0, 1e3),
    "temperature_block_c": (1e-3, 1e3),
    "face_degrees": (0.1, 90),
    "state_degrees": (1e-3, 180),
    "min_state_seconds": (0, 3600),
    "max_condition": (1, 1e9),
    "max_vector_error_mg": (0, 1e6),
    "precision_mg": (1e-3, 1e3),
    "latitude": (-90, 90),
    "altitude_m": (-500, 9000),
    "max_damage_percent": (0, 100),
    "min_distance_g": (0, 2),
    "min_subset_points": (1, 100),
    "max_subset_points": (1, 100),
    "longest_gap_s": (0, 10),
    "rate_hz": (1e-3, 1e5),
    "lsb_per_g": (1e-9, 1e9),
    "zero": (-(2**30), 2**30),
    "lsb_per_dps": (1e-9, 1e9),
}
"""What a report may hold, whichever of the records has the field."""

ADAPTIVE_LIMITS = {
    "acceleration_factor": (1, 30),
    "rotation_factor": (1, 30),
    "min_samples": (1, 1_000_000),
    "min_windows": (1, 1_000_000),
    "max_windows": (1, 1_000_000),
    "held_windows": (1, 1_000_000),
}


def stored(request: Request) -> dict[str, Any]:
    return json.loads(json.dumps(request.effective_settings(None).as_json()))


def rebuilt(settings: Any) -> ReportSettings:
    return settings_from_report(Document(Path("a.json"), "", {"settings": settings}))


@pytest.mark.parametrize(
    "settings",
    [
        PAPER,
        replace(DEFAULT, model="6", latitude=3.5),
        replace(PAPER, stillness_axes=(2,), min_subset_points=1, max_subset_points=7),
        *(with_stillness(DEFAULT, name) for name in STILLNESS),
    ],
)
def test_everything_comes_back(settings: Settings) -> None:
    options = ReadOptions(format="csv", rate_hz=30.0, unit="mg", columns=("a", "b", "c"), sensor="s")
    made = rebuilt(stored(Request(options=options, settings=settings, report_only=True)))
    assert made == ReportSettings(settings, options, True, None, None, (), ())
    assert rebuilt(stored(Request(effect=True))).effect


def test_settings_of_a_session_come_back() -> None:
    settings = PoseSettings(face_degrees=20.0, latitude=10.0)
    made = rebuilt(
        json.loads(
            json.dumps(Request(settings=settings, report_only=True).effective_settings(None).as_json())
        )
    )
    assert made == ReportSettings(settings, ReadOptions(), True, None, None, (), ())


def test_missing_and_unknown_settings_are_told() -> None:
    held = stored(Request())
    del held["cells_per_g"], held["report_only"], held["input"]["sensor"], held["input"]["layout_sha256"]
    held["later"], held["input"]["more"] = 1, 2
    made = rebuilt(held)
    assert made.missing == ("cells_per_g", "report_only", "input.sensor", "input.layout_sha256")
    assert made.unknown == ("later", "input.more")
    assert made.settings == DEFAULT


def test_every_number_has_its_limits() -> None:
    """A setting without limits could bring a report that makes nonsense of them to a bug."""
    for record in (Settings, PoseSettings, ReadOptions, Adaptive):
        limits = bounded(record)
        for name, field in record.__dataclass_fields__.items():
            assert name in limits or not any(kind in str(field.type) for kind in ("int", "float")), name


@pytest.mark.parametrize("kind", [Settings, PoseSettings, ReadOptions, Adaptive])
def test_the_bounds_of_numbers_in_reports(kind: Any) -> None:
    expected = ADAPTIVE_LIMITS if kind is Adaptive else LIMITS
    assert bounded(kind) == {n: expected[n] for n in kind.__dataclass_fields__ if n in expected}


@pytest.mark.parametrize("name", sorted(LIMITS))
@pytest.mark.parametrize("value", [-1e12, 1e12, "x", True, {}, [], [1e12]])
def test_what_cannot_be_is_refused_by_name(name: str, value: Any) -> None:
    held = stored(Request())
    if name not in {**held, **held["input"]}:
        held = json.loads(
            json.dumps(Request(settings=PoseSettings(), report_only=True).effective_settings(None).as_json())
        )
    inside = held if name in held else held["input"]
    whole = isinstance(value, float) and isinstance(inside.get(name), int)
    inside[name] = int(value) if whole else value
    with pytest.raises(UnreadableError, match=rf"a\.json: .*{name} cannot be"):
        rebuilt(held)


@pytest.mark.parametrize("name", sorted(ADAPTIVE_LIMITS))
@pytest.mark.parametrize("value", [-1, 0, 10**9, 1.5, "x", None])
def test_numbers_of_the_adaptive_rule_that_cannot_be_are_refused(name: str, value: Any) -> None:
    held = stored(Request(settings=with_stillness(DEFAULT, "adaptive")))
    held["adaptive"][name] = value
    with pytest.raises(UnreadableError, match=rf"a\.json: .*({name}|adaptive) cannot be"):
        rebuilt(held)


def test_the_largest_factors_do_not_overflow() -> None:
    for name in ("acceleration_factor", "rotation_factor"):
        assert ADAPTIVE_LIMITS[name][1] ** 2 * NEVER < MOVING < 1 << 63


def test_the_adaptive_rule_needs_its_numbers_and_no_other_has_them() -> None:
    held = stored(Request(settings=with_stillness(DEFAULT, "adaptive")))
    for change in ({"stillness": "both"}, {"adaptive": None}, {"adaptive": {}}, {"adaptive": 3}):
        with pytest.raises(UnreadableError, match=r"(stillness_axes|adaptive) cannot be"):
            rebuilt(held | change)
    with pytest.raises(UnreadableError, match="adaptive cannot be"):
        rebuilt(stored(Request()) | {"adaptive": held["adaptive"]})
    with pytest.raises(UnreadableError, match="adaptive cannot be"):
        rebuilt(held | {"adaptive": held["adaptive"] | {"later": 1}})


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"profile": "x"}, "profile cannot be 'x'"),
        ({"stillness": "x"}, "stillness cannot be 'x'"),
        ({"model": "12"}, "model cannot be '12'"),
        ({"optimizer": "x"}, "unknown optimizer 'x'"),
        ({"report_only": "no"}, "report_only cannot be 'no'"),
        ({"temperature": 1}, "temperature cannot be '1'"),
        ({"stillness_axes": [1]}, "stillness_axes cannot be (1,)"),
        ({"min_subset_points": 3}, "max_subset_points cannot be 2"),
        ({"input": None}, "does not say how"),
        ({"input": []}, "does not say how"),
        ({"input": {"format": "x"}}, "unknown format 'x'"),
        ({"input": {"unit": "lbs"}}, "unit cannot be 'lbs'"),
        ({"input": {"timezone": "Mars/North"}}, "unknown time zone"),
        ({"input": {"layout": 5}}, "layout cannot be '5'"),
        ({"input": {"columns": ["a", "b"]}}, "columns cannot be"),
    ],
)
def test_unknown_names_are_refused(change: dict[str, Any], part: str) -> None:
    with pytest.raises(UnreadableError) as caught:
        rebuilt(stored(Request()) | change)
    assert part in str(caught.value)


@pytest.mark.parametrize("settings", [None, [], 5, "x"])
def test_settings_that_are_none(settings: Any) -> None:
    with pytest.raises(UnreadableError, match="does not say how"):
        rebuilt(settings)
