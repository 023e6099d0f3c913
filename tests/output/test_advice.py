"""Cautions and advice that follow from a report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.core.errors import Reason
from accelcal_cli.core.results import Coverage, Judgement, Outcome
from accelcal_cli.output.advice import completed, doubts, is_doubtful, page_verdict
from accelcal_cli.output.sections import ReportView, report_view
from accelcal_cli.output.sentences import message
from tests.device_recordings import donor
from tests.schema import check_report

ERROR = {
    "mean": 1.2, "ci95": [0.8, 2.0], "worst_direction": 2.5, "worst_direction_at": [0, 0, 1], "before": 31,
}  # fmt: skip
SUMMARY = {"mean": 1.0, "median": 1.0, "p95": 2.0}
HOLDOUT = {
    "method": "5 folds", "points": 60, "postures": 40, "before_mg": SUMMARY | {"mean": 30.0},
    "after_mg": SUMMARY, "improvement_percent": 3000.0, "ci95_mg": [0.8, 1.2],
}  # fmt: skip
COVERED = {
    "subsets": [[2] * 3] * 3, "axis_min_g": [-1.0] * 3, "axis_max_g": [1.0] * 3, "cells": 60,
    "condition_number": 2.0, "worst_direction_mg": 1.0, "distinct_orientations": 40, "saturated": [],
    "subsets_full_after_h": None,
}  # fmt: skip
HEALTH = {
    "problems": [], "filled_samples": 0, "clipped_samples_before": 0, "clipped_samples_after": 0,
    "rate_hz_measured": 25.0, "lost_bytes": 0, "lost_percent": 0.0, "missing_bytes": 0, "clock": None,
    "rest": None,
}  # fmt: skip
CALIBRATION = {
    "model": "9", "gain": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "offset_g": [0, 0, 0], "parameters": {},
    "temperature": None, "equation": "",
    "fixed_point": {"fraction_bits": 29, "parameters": {}, "temperature_reference_mc": None,
                    "temperature_span_c": None, "bend": [0, 0, 0]},
    "bend": None, "covariance": None,
    "optimizer": {"name": "fixed32", "arithmetic": "integer", "settings": {}, "iterations": 7,
                  "stop": "minimum", "converged": True, "operations": {}, "predicted_seconds": None},
    "gravity": {"local_g": 1.0, "latitude": None, "altitude": None}, "course": None, "standard_errors": {},
}  # fmt: skip
BASE = {
    "accelcal_version": "1.0.0", "recording": {"path": "a.bin", "sha256": "", "bytes": 1, "format": "raw"},
    "settings": {"max_error_mg": 10.0, "min_postures": 9, "coverage_g": 0.3, "max_damage_percent": 50.0},
    "outcome": "calibrated", "message": "", "calibration": CALIBRATION, "holdout": HOLDOUT,
    "fit": {"points": 60, "postures": 40, "before_mg": 30.0, "after_mg": 1.0,
            "windows": {"complete": 100, "used": 100}},
    "kind": "report", "schema_version": 4, "without_misalignment": None, "coverage": COVERED,
    "models_tried": [], "file_health": HEALTH, "reason": "not_determined", "values": {}, "notes": [],
    "cautions": [], "advice": [], "calibration_error_mg": ERROR, "rest_scatter_mg": 0.5, "change": None,
    "misfits": None, "probability": {"better_than_raw": 1.0, "below_limit": 1.0}, "uncertainty": None,
}  # fmt: skip


def of(**changed: Any) -> ReportView:
    """A good report with some sections changed, and the cautions and advice that follow from it."""
    report = BASE | changed
    return report_view(completed(report, judgement(Outcome(report["outcome"]), Reason(report["reason"]))))


def refused(**changed: Any) -> ReportView:
    return of(**{"outcome": "refused", "calibration": None, "calibration_error_mg": None} | changed)


def codes(reasons: tuple[Reason, ...]) -> list[str]:
    return [one.code for one in reasons]


def test_nothing_speaks_against_a_good_result() -> None:
    assert of().cautions == of().advice == ()
    assert not is_doubtful(of()) and page_verdict(of()).level == "good"


@pytest.mark.parametrize("outcome", ["borrowed", "provisional"])
def test_some_outcomes_are_doubtful_in_themselves(outcome: str) -> None:
    assert is_doubtful(of(outcome=outcome))
    assert page_verdict(of(outcome=outcome)).level == "care"


@pytest.mark.parametrize(
    ("high", "before", "found"),
    [
        (None, 5.0, []),
        (9.9, 31.0, []),
        (10.0, 31.0, ["error_may_reach"]),
        (9.9, 9.9, ["no_better_than_raw"]),
        (12.0, 9.9, ["error_may_reach", "no_better_than_raw"]),
        (12.0, None, ["error_may_reach"]),
    ],
)
def test_what_an_interval_says(high: float | None, before: float | None, found: list[str]) -> None:
    assert [one.code for one in doubts(high, before)] == found


def test_the_interval_is_that_over_all_orientations_or_else_that_of_the_hold_out() -> None:
    """Where no probabilities have decided."""
    wide = ERROR | {"ci95": [1.0, 12.5]}
    held_out = HOLDOUT | {"ci95_mg": [0.8, 12.5]}
    assert of(calibration_error_mg=wide).cautions == ()
    assert of(calibration_error_mg=wide, probability=None).cautions == (
        Reason("error_may_reach", {"high_mg": 12.5, "everywhere": True}),
    )
    assert of(calibration_error_mg=None, probability=None, holdout=held_out).cautions == (
        Reason("error_may_reach", {"high_mg": 12.5, "everywhere": False}),
    )
    lenient = {"max_error_mg": 20.0}
    assert of(calibration_error_mg=wide, settings=lenient).cautions == (), "the limit is the settings'"
    assert refused(calibration_error_mg=wide).cautions == (), "nothing is calibrated"
    as_good = ERROR | {"ci95": [1.0, 3.0], "before": 2.0}
    assert codes(of(calibration_error_mg=as_good, probability=None).cautions) == ["no_better_than_raw"]
    assert of(calibration_error_mg=as_good, outcome="already_good").cautions == ()


def test_a_side_that_was_not_seen_is_a_mild_caution() -> None:
    found = of(coverage=COVERED | {"axis_min_g": [-1.0, -1.0, -0.29], "axis_max_g": [1.0, 0.3, 1.0]})
    assert found.cautions == (Reason("sides_unchecked", {"sides": ["-z"]}),)
    assert not is_doubtful(found)


ROLL = {"axis": "x", "start_s": 0.0, "end_s": 1.0, "samples": 100, "length_g": {"before": 1.0, "after": None}}


@pytest.mark.parametrize(("rolls", "code"), [((), "nothing_checks_poses"), ((1,), "roll_alone_checks_poses")])
def test_poses_that_nothing_checks(rolls: tuple[int, ...], code: str) -> None:
    level = {"before": {"mean": 1.0, "sd": 2.0}, "after": None}
    section = {
        **dict.fromkeys(("K", "O", "standard_errors", "holdout_vector_mg", "repeat_spread_mg", "left_out")),
        "equation": "",
        "orientations": 4,
        "missing_faces": [],
        "unchecked": "nothing_held_out",
        "rolls": [ROLL | {"level_mg": level} for _ in rolls],
    }
    assert code in codes(of(known_orientations=section).cautions)
    assert code not in codes(refused(known_orientations=section).cautions)


REST = {
    "windows": 9, "median_g": 9.81, "p5_g": 9.8, "p95_g": 9.82, "axis_min_g": [-9.8] * 3,
    "axis_max_g": [9.8] * 3,
}  # fmt: skip
FEW = COVERED | {"distinct_orientations": 5}
ONE_SIDED = COVERED | {"axis_min_g": [-1.0, -1.0, -0.1]}
NONE = COVERED | {"cells": 0, "distinct_orientations": 0, "axis_min_g": [0.0] * 3, "axis_max_g": [0.0] * 3}


@pytest.mark.parametrize(("changed", "found"), [
    ({}, ["other_coefficients"]),
    ({"coverage": FEW}, ["more_orientations", "other_coefficients"]),
    ({"coverage": ONE_SIDED}, ["more_orientations", "rest_on_sides", "other_coefficients"]),
    ({"coverage": NONE}, ["record_again", "other_coefficients"]),
    ({"coverage": NONE, "reason": "constant_values"}, ["check_sensor", "other_coefficients"]),
    ({"coverage": NONE, "notes": [{"code": "axes_alike", "values": {}}]}, []),
    ({"file_health": HEALTH | {"rest": REST}}, ["check_unit"]),
    ({"file_health": HEALTH | {"lost_percent": 50.1}}, ["other_coefficients"]),
    ({"file_health": HEALTH | {"lost_percent": 50.1}, "reason": "damaged"}, []),
    ({"settings": {"input": {"format": "points"}}, "coverage": FEW}, ["more_orientations"]),
    ({"settings": {"input": {"format": "points"}}, "coverage": NONE}, []),
    ({"settings": {"profile": "paper"}, "coverage": FEW}, []),
    ({"settings": {"profile": "paper"}, "coverage": FEW, "reason": "subsets_not_full"},
     ["more_orientations", "other_coefficients"]),
    ({"poses": [], "coverage": FEW}, []),
])  # fmt: skip
def test_advice_by_what_a_refused_recording_lacks(changed: dict[str, Any], found: list[str]) -> None:
    assert codes(refused(**changed).advice) == found


def test_only_a_refused_recording_needs_advice() -> None:
    assert of(coverage=FEW).advice == ()


def judgement(outcome: Outcome, reason: Reason, **given: tuple[Reason, ...]) -> Judgement:
    nowhere = (0.0, 0.0, 0.0)
    return Judgement(outcome, reason, Coverage(((0,) * 3,) * 3, nowhere, nowhere, 0, 0), (), **given)


def drafted(**changed: Any) -> dict[str, Any]:
    """A report before its message, cautions and advice are known."""
    order = ("outcome", "reason", "values", "message", "notes", "cautions", "advice")
    report = BASE | changed
    return {name: report[name] for name in (*order, *(key for key in report if key not in order))}


def test_completed_keeps_the_order_of_keys_and_all_else() -> None:
    report = drafted()
    made = completed(report, judgement(Outcome.CALIBRATED, Reason("not_determined")))
    assert list(made) == list(report)
    assert made == report | {"message": "The still windows do not determine it."}


def test_completed_has_the_judges_reasons_first_and_each_advice_once() -> None:
    report = drafted(outcome="refused", calibration=None, coverage=FEW)
    given = (Reason("record_longer"), Reason.of("more_orientations", orientations=4))
    verdict = judgement(Outcome.REFUSED, Reason("not_determined"), advice=given)
    made = completed(report, verdict)
    assert made["advice"] == [one.as_json() for one in (*given, Reason("other_coefficients"))]
    saturated = Reason("axis_saturates", {"axis": "z", "at_g": -0.9})
    wide = drafted(calibration_error_mg=ERROR | {"ci95": [1.0, 12.5]}, probability=None)
    made = completed(wide, judgement(Outcome.CALIBRATED, Reason("not_determined"), cautions=(saturated,)))
    assert [one["code"] for one in made["cautions"]] == ["axis_saturates", "error_may_reach"]


def test_completed_gives_no_general_advice_where_notes_explain_the_values() -> None:
    note = Reason("axis_stuck", {"axis": "x", "at_g": 0.03, "others": ["y"], "by_g": [2.0]})
    learnt = Reason("prior_learnt", {"model": "AX3", "devices": 12, "own": 0})
    report = drafted(outcome="refused", calibration=None, coverage=NONE)
    verdict = judgement(Outcome.REFUSED, Reason("not_determined"), notes=(learnt,))
    assert [one["code"] for one in completed(report, verdict)["advice"]] == [
        "record_again",
        "other_coefficients",
    ]
    odd = report | {"notes": [note.as_json()]}
    assert completed(odd, judgement(Outcome.REFUSED, Reason("not_determined"), notes=(note,)))["advice"] == []


def test_a_message_follows_from_the_codes_alone(tmp_path: Path) -> None:
    report = json.loads(donor(tmp_path).read_text())
    check_report(report)
    assert report["schema_version"] == 4
    assert message(report_view(report | {"message": "changed"})) == report["message"]
    bare = {name: report[name] for name in ("reason", "values", "notes")}
    assert message(of(**bare)) == report["message"]
    noted = report | {"notes": [{"code": "windows_repeated", "values": {"windows": 3}}]}
    text = "3 still windows that repeat earlier ones exactly were left out."
    assert message(report_view(noted)) == f"{report['message']} {text}"
