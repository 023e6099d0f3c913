"""Numbers for people, what an outcome means, and the sentences of reasons (`output/sentences.py`)."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

import accelcal_cli
from accelcal_cli.core.errors import Reason
from accelcal_cli.core.results import Outcome
from accelcal_cli.output.numbers import figure, formatted, mg, number, percent, times_smaller, with_error
from accelcal_cli.output.sentences import (
    DEVICES,
    OUTCOMES,
    SENTENCES,
    changed,
    clause,
    outcome_words,
    sentence,
)


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (3.00234, 0.00278, "+3.0023 +- 0.0028"),
        (-151.04, 0.12, "-151.04 +- 0.12"),
        (5.0, 1.26, "+5.0 +- 1.3"),
        (41.3, 12.2, "+41 +- 12"),
        (412.6, 123.4, "+413 +- 123"),
        (1.0, 1e-12, "+1.000000 +- 0.000000"),
        (1.0, 0.0, "+1.00 +- 0.00"),
    ],
)
def test_an_error_has_two_digits(value: float, error: float, text: str) -> None:
    assert with_error(value, error) == text


@pytest.mark.parametrize(("value", "text"), [
    (None, "–"), (0.0, "0"), (-0.0, "0"), (-0.01234, "−0.0123"), (1.5, "1.5"), (123456.7, "123457"),
    (2.0, "2"),
])  # fmt: skip
def test_a_number_on_a_page(value: float | None, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize(("value", "sentence", "cell"), [
    (None, "-", "-"), (0.5, "0.5", "0.500"), (123.4, "123", "123"), (1234.5, "1234", "1234"),
    (99.96, "100", "100"),
])  # fmt: skip
def test_a_number_at_the_terminal(value: float | None, sentence: str, cell: str) -> None:
    assert (mg(value), figure(value)) == (sentence, cell)
    assert formatted(value, ".1f") == ("-" if value is None else f"{value:.1f}")


@pytest.mark.parametrize(
    ("factor", "ci95", "text"),
    [
        (476.38, (377.7, 600.9), ", 476 times smaller (95 % interval 378 to 601)"),
        (476.38, None, ", 476 times smaller"),
        (1.0, (0.8, 1.25), ", 1 times smaller (95 % interval 0.8 to 1.25)"),
        (0.5, (0.25, 1.0), ", 2 times larger (95 % interval 1 to 4)"),
        (None, None, ""),
    ],
)
def test_verdicts_10_an_improvement_is_a_factor_with_its_interval(
    factor: float | None, ci95: tuple[float, float] | None, text: str
) -> None:
    assert times_smaller(factor, ci95) == text


@pytest.mark.parametrize(
    ("value", "text"), [(47638.2, "47600"), (137.8, "138"), (50.0, "50.0"), (99.96, "100"), (None, "-")]
)
def test_verdicts_10_eq_21_has_three_digits(value: float | None, text: str) -> None:
    assert percent(value) == text


def test_every_outcome_has_its_words() -> None:
    assert {str(one) for one in Outcome} == OUTCOMES.keys() - {"failed"}
    assert [name for name, words in OUTCOMES.items() if not words.usable] == ["refused", "failed"]
    assert outcome_words("another").result == "another"


WHY: dict[str, Any] = {"code": "no_stillness_on_sides", "values": {"sides": ["-z"], "reach_g": 0.3}}
FACTOR = {"factor": 15.44, "factor_ci95": [11.8, 20.2]}
HELD_OUT = {"before_mg": 31.5, "after_mg": 2.04, "orientations": 14, "held_out": "orientations"} | FACTOR
HERE = {"before_mg": 31.5, "after_mg": 2.04, "orientations": 1}
WORSE_HERE = {"before_mg": 2.04, "after_mg": 3.1, "orientations": 1}
BAD_HERE = {"before_mg": 31.5, "after_mg": 12.0, "orientations": 1, "limit_mg": 10.0}
NO_BETTER = HELD_OUT | {"before_mg": 5.5, "after_mg": 5.1, "factor": 1.078, "factor_ci95": [0.9, 1.3]}
NOT_HERE = dict.fromkeys(HERE)
LEVEL = {"mean": -3.25, "sd": 0.5}
VECTORS = {"before_mg": 35.0, "after_mg": 4.5, "norm_before_mg": 30.0, "norm_after_mg": 1.5}
REST = {"of": "rest", "median_g": 9.81}

FIT = {"error_mg": 1.2, "low_mg": 0.8, "high_mg": 2.0, "limit_mg": 10.0, "model": "9", "raw_mg": 31.0}
FIT |= {"percent": 99.0, "percent_below": 97.0}

EXAMPLES: dict[str, list[dict[str, Any]]] = {
    "beyond_range": [{}],
    "change_not_looked_for": [{}],
    "give_latitude": [{}],
    "cut_recording": [{}],
    "may_have_changed": [{"at": "2024-03-04T09:00:00.000000", "percent": 98.0}],
    "no_longer_fits": [
        {"since": None, "until": "2024-03-04T09:00:00.000000", "error_mg": 12.0, "new_mg": 0.3},
        {"since": "2024-03-04T09:00:00.000000", "until": None, "error_mg": 12.0, "new_mg": 0.3},
    ],
    "error_rises": [{"since": "2024-03-04T09:00:00.000000", "error_mg": 12.0, "before_mg": 0.3}],
    "accelerometer_not_calibrated": [{}],
    "adaptive_rule": [{}],
    "allow_damage": [{}],
    "omit_strict": [{}],
    "axes_alike": [{"axes": ["x", "y"]}],
    "known_fault": [
        {
            "name": "16CPAN03",
            "fault": "raw data are attenuated",
            "shipped_from": shipped,
            "shipped_to": "2014-03-24",
            "source": "https://actigraph.desk.com",
        }
        for shipped in (None, "2013-11-07")
    ],
    "axis_saturates": [{"axis": "z", "at_g": -0.9}],
    "axis_stuck": [{"axis": "x", "at_g": 0.03, "others": ["y", "z"], "by_g": [2.0, 1.5]}],
    "borrowed": [
        {"path": "a.cwa", "sha256": "0123456789ab", "device": "AX3 42", **here} for here in (HERE, NOT_HERE)
    ],
    "calibrated": [FIT | HELD_OUT],
    "calibrated_before": [{"origin": "a table of calibrated values", "before_mg": 2.0, "orientations": 9}],
    "calibrated_before_unchecked": [{"origin": "a table of calibrated values"}],
    "calibrated_held_out": [
        HELD_OUT | {"model": "9", "asked_for": asked, "held_out": "control points"} for asked in (False, True)
    ],
    "calibrated_in_part": [
        HELD_OUT | {"model": "3", "asked_for": False, "left_out": "scale and misalignment", "why": None},
        HELD_OUT | {"model": "6", "asked_for": False, "left_out": "misalignment", "why": WHY},
        HELD_OUT | {"model": "6", "asked_for": True, "why": None},
    ],
    "calibration_error_over_limit": [{"error_mg": 12.0, "low_mg": 8.0, "high_mg": 120.0, "limit_mg": 10.0}],
    "check_references": [{}],
    "check_sensor": [{}],
    "check_unit": [{}],
    "constant_values": [{}],
    "nothing_but_saturated": [{}],
    "copy_again": [{}],
    "cut_short": [
        {"missing_bytes": None, "missing_percent": None},
        {"missing_bytes": 2841600, "missing_percent": None},
        {"missing_bytes": 2841600, "missing_percent": 49.87},
    ],
    "damaged": [{"lost_percent": 61.53, "lost_bytes": 1234567, "limit_percent": 50.0}],
    "decided_by_a_person": [
        {"who": who, "when": when, "note": note, "decided": decided}
        for who, when, note, decided in (
            ("", "", "", "yes"),
            ("", "2026-11-27", "", "with care"),
            ("B. Meyer", "2026-11-27", "The strap was loose.", "no"),
        )
    ],
    "decision_outdated": [{"recording": "a.cwa", "row": 2, "decided": "yes", "use": "with care"}],
    "decision_unreadable": [
        {"row": 3, "column": "recording", "cell": ""},
        {"row": 3, "column": "use", "cell": "maybe"},
    ],
    "decision_without_recording": [{"row": 4, "recording": "b.cwa"}],
    "decisions_contradict": [
        {"recording": "a.cwa", "rows": [2, 5], "more": 7, "use": "no"},
        {"recording": "a.cwa", "rows": [2, 5], "use": "no"},
    ],
    "decision_followed": [{"row": 2, "recording": "a.cwa", "now": "b.cwa"}],
    "decision_without_data": [{"row": 2, "recording": "a.cwa", "decided": "yes", "use": "no"}],
    "donor": [{"path": "a.cwa", "why": {"code": "not_less", "values": WORSE_HERE}}],
    "error_may_reach": [{"high_mg": 12.34, "everywhere": everywhere} for everywhere in (False, True)],
    "factory_calibration_differs": [{"applied_here": here} for here in (False, True)],
    "few_orientations_differ_in_temperature": [{}],
    "few_still_stretches": [{}],
    "rows_without_values": [{"empty_percent": 60.0, "empty_rows": 5400}],
    "unlikely_year": [{"start": "2079-06-06T00:00:00"}],
    "clock_reset": [
        {"sample": 8960, "before": "2024-03-04T00:02:59.2", "after": "2000-01-01T00:00:00.0", "resets": 1}
    ],
    "filled_share": [{"filled_percent": 12.5, "filled_samples": 1234}],
    "fit_diverges": [{}],
    "gravity_is_zero": [{"of": "rest"}, {"of": "samples"}],
    "gravity_still_off": [{"after_deg": 12.5}],
    "gyroscope_by_revolutions": [{"revolutions": 3, "turns": 8, "before_deg": 1.4, "after_deg": 0.56}],
    "gyroscope_calibrated": [
        {"turns": 40, "before_deg": 4.5, "after_deg": 0.53, "unusual": unusual} for unusual in (False, True)
    ],
    "gyroscope_never_at_rest": [{}],
    "held_out_error_over_limit": [
        HELD_OUT | {"after_mg": 12.0, "model": "9", "asked_for": False, "limit_mg": 10.0}
    ],
    "unfinished_copy": [{"suffix": ".part"}],
    "excluded": [{"by": "--exclude"}],
    "belongs_to_another": [{"name": "acc.bin"}],
    "not_a_file": [{}],
    "not_looked_into": [{"fault": "Permission denied"}],
    "archive_without_recordings": [{}],
    "epochs": [{"whose": "ActiGraph's"}, {"whose": "a table of"}],
    "other_kind": [{"what": "a PDF document"}],
    "database": [{}],
    "still_windows": [{}],
    "no_acceleration": [{}],
    "other_quantities": [{"columns": ["time", "lat", "lon"]}],
    "no_numbers": [{}],
    "no_format": [{}],
    "decisions_gone": [{"number": 3}],
    "disk_may_be_away": [{"results": 12}],
    "file_cut_short": [{"lost_percent": 0.0}, {"lost_percent": 48.2}],
    "copied_under_another_name": [{"first": "P001.gt3x"}],
    "pool_refused": [
        {"recordings": 2, "device_serial": "A1", "message": "The device was still in only 1 orientation."}
    ],
    "times_mixed": [{"utc": 3, "unknown": 2}],
    "recording_elsewhere": [{"source": "a.cwa", "folder": "/data/pilot"}],
    "recording_gone": [{"source": "a.cwa"}],
    "recording_renamed": [{"source": "a.cwa", "now": "b.cwa"}],
    "sensor_gone": [{"source": "table.csv", "sensor": "sensor=A"}],
    "left_out_of_pool": [{"why": {"code": "worse_than_usual", "values": HERE | {"usual_mg": 1.0}}}],
    "misfit": [
        {"kind": kind, "size": [1.0, -2.5, 0.25], "unit": "%", "largest_mg": 12.5}
        for kind in ("cubic", "gain by temperature", "curved by temperature", "previous posture")
    ],
    "model_not_fitted": [{"model": "9", "why": {"code": "fit_diverges", "values": {}}}],
    "model_uncertain": [{"model": "9", "why": {"code": "uncertain_somewhere", "values": {"by_mg": 51.0}}}],
    "more_orientations": [{"orientations": 1}, {"orientations": 7}],
    "much_left": [{"limit_mg": 10.0}],
    "no_better_than_raw": [{"before_mg": 3.5}],
    "no_model_tried": [{"why": WHY}],
    "no_point_near_1_g": [{}],
    "no_points": [{}],
    "no_stillness_on_sides": [{"sides": ["-x", "+y"], "reach_g": 0.3}, WHY["values"]],
    "no_stillness_along": [{"axes": ["z"], "reach_g": 0.3}],
    "not_1_g": [REST],
    "not_better": [NO_BETTER | {"model": "9", "asked_for": True}],
    "not_clearly_better": [FIT | NO_BETTER],
    "not_determined": [{}],
    "not_less": [WORSE_HERE],
    "not_tried": [{"message": "it is the same recording"}],
    "nothing_but_filled": [{"filled_percent": 95.5}],
    "nothing_checks_poses": [{}],
    "nothing_held_out": [{}],
    "nothing_measured": [{"seconds": 5.0}],
    "nothing_near_quietest": [{}],
    "nothing_still": [
        {},
        {"windows": 720, "seconds": 5.0, "quietest": "range", "measured_g": 0.31, "limit_g": 0.1},
        {"windows": 720, "seconds": 5.0, "quietest": "deviation", "measured_g": 0.0312, "limit_g": 0.013},
        {"windows": 1, "seconds": 2.5, "quietest": "deviation", "measured_g": 0.0312, "limit_g": None},
    ],
    "optimizer_never_fits": [{"optimizer": "ellipsoid", "what": "misalignment"}],
    "orientations_disagree": [{"orientations": 12, "by_mg": 25.4}],
    "other_coefficients": [{}],
    "other_counts_per_g": [{"here": 256.0, "there": 341.0}],
    "other_device": [{"serial": "B2"}],
    "other_model": [{"model": "AX6"}],
    "other_rule": [{}],
    "other_stillness": [{"options": "--stillness both"}],
    "over_limit_here": [BAD_HERE],
    "own_coefficients": [{}],
    "own_is_no_worse": [{"after_mg": 2.5, "own_mg": 2.0}, {"after_mg": None, "own_mg": 2.0}],
    "pooled": [
        {"recordings": 3, "serial": "A1", "pool": {"code": "calibrated_held_out", "values": values}, **here}
        for here in (HERE, NOT_HERE)
        for values in [HELD_OUT | {"model": "9", "asked_for": False}]
    ],
    "poses_calibrated": [
        VECTORS | {"unchecked": unchecked, "missing": missing}
        for unchecked, missing in ((["+z"], ["-z"]), (["+z"], []), ([], []))
    ],
    "poses_disagree": [
        VECTORS
        | {
            "after_mg": 25.0,
            "vector_limit_mg": 20.0,
            "limit_mg": 10.0,
            "worst": "+z",
            "start_s": 125.0,
            "worst_mg": 90.0,
        }
    ],
    "poses_no_better": [VECTORS | {"before_mg": 4.0}],
    "poses_unchecked": [{"orientations": 4, "before_mg": 35.0}],
    "prior_learnt": [
        {"model": "AX3", "devices": 12, "own": 0},
        {"model": "", "devices": 12, "own": 1},
        {"model": "AX3", "devices": 0, "own": 2},
        {"model": "AX3", "devices": 1, "own": 1},
    ],
    "provisional": [FIT | HELD_OUT | {"percent": 97.0}],
    "raw_no_worse": [NO_BETTER],
    "record_again": [{}],
    "record_longer": [{}],
    "recordings_contradict": [{"path": "a.cwa", "why": {"code": "over_limit_here", "values": BAD_HERE}}],
    "rest_on_faces": [{}],
    "rest_on_sides": [{"sides": ["-z"]}, {"sides": ["+x", "-z"]}],
    "rest_scatters": [{"low_g": 0.36, "high_g": 1.05}],
    "roll_alone_checks_poses": [{}],
    "rolled": [{"axis": "z", "before_mg": LEVEL, "after_mg": after} for after in (None, LEVEL)],
    "scatter_over_limit": [{"scatter_mg": 24.0}],
    "scale_no_better": [{"before_deg": 0.25}],
    "scale_not_determined": [{}],
    "sensor_changed": [
        {
            "kind": kind,
            "at": "2024-03-04T16:00:00.000000" if kind in ("step", "gain", "device") else None,
            "size_mg": 39.5,
            "followed": followed,
            "left_percent": 80.0 if kind == "walk" else None,
            "constant_mg": 12.5,
            "changing_mg": 2.0,
        }
        for kind in ("drift", "step", "gain", "device", "walk")
        for followed in (False, True)
    ],
    "shorter_windows": [{}],
    "shorter_windows_or_longer_gaps": [{}],
    "not_converged": [{"iterations": 50}],
    "sides_unchecked": [{"sides": ["-z"]}, {"sides": ["+x", "-z"]}],
    "slopes_left_out": [{"at_c": 25.0}],
    "still_far_from_1_g": [{}, {"median_g": 9.81}],
    "subsets_not_full": [
        {"of": "fit", "subsets": ["x -1 g", "z 0 g"], "points": 2, "apart_g": 0.2},
        {"of": "control", "subsets": ["y +1 g"], "points": 2, "apart_g": 0.0},
    ],
    "temperature_too_even": [{"range_c": 1.25, "least_c": 2.0}],
    "too_few_orientations": [{"orientations": 1, "needed": 9}, {"orientations": 8, "needed": 9}],
    "too_few_turns": [{"turns": 11, "least_deg": 20.0, "needed": 12}],
    "too_little_turning": [{"axis": "x", "standard_error": 0.125}],
    "too_many_cells": [{}],
    "too_short": [{}],
    "turns_miss_an_axis": [{"axis": "x"}],
    "uncertain_somewhere": [{"by_mg": 51.04}],
    "unlike_most_sensors": [{"parameters": ["k_xx", "oy"]}],
    "unlike_prior": [{}],
    "untested": [{"needed": 2}],
    "use_default_profile": [{}],
    "use_optimizer": [{"optimizer": "fixed32"}],
    "use_options": [{"options": "--profile paper --stillness both"}],
    "windows_repeated": [{"windows": 1}, {"windows": 35}],
    "worse_here": [{}],
    "worse_than_usual": [HERE | {"usual_mg": 1.0}],
    "wrong_counts_per_g": [REST | {"lsb_per_g": 128.0, "fits": 256.0}],
    "wrong_unit": [REST | {"unit": "m/s2", "read_as": "g"}],
    "wrong_unit_of_rates": [{"factor": 57.3}, {"factor": 0.01745}],
}
"""Values that each code is emitted with."""

CASES = [pytest.param(code, values, id=code) for code, many in EXAMPLES.items() for values in many]


def constants(argument: ast.expr) -> Iterator[str]:
    """Find the strings that an argument may be."""
    if isinstance(argument, ast.Constant) and isinstance(argument.value, str):
        yield from [argument.value] if argument.value else []
    elif isinstance(argument, ast.IfExp):
        yield from (*constants(argument.body), *constants(argument.orelse))
    elif isinstance(argument, ast.BoolOp):
        yield from (code for value in argument.values for code in constants(value))


def emitted(pattern: str = "**/*.py", without: str = "devices") -> Iterator[tuple[str, set[str], bool]]:
    """Find each code that is emitted, the names of the values given with it, and whether there are more."""
    for path in sorted(PACKAGE.glob(pattern)):
        if path.parent == PACKAGE / without:
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        imported = {
            name.name
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom) and node.module in REASONS_FROM
            for name in node.names
        }
        if path == PACKAGE / "core/errors.py":
            imported.add("Reason")
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call):
                continue
            called = ast.unparse(node.func)
            if called.partition(".")[0] not in imported or not node.args:
                continue
            if called in ("Reason", "Reason.of"):
                names = {keyword.arg for keyword in node.keywords if keyword.arg}
                more = len(node.args) > 1 or any(keyword.arg is None for keyword in node.keywords)
                yield from ((code, names, more) for code in constants(node.args[0]))
            elif called == "Change":
                yield from ((code, set(), False) for one in node.args[1:2] for code in constants(one))


PACKAGE = Path(accelcal_cli.__file__).parent
REASONS_FROM = ("accelcal_cli.core.errors", "accelcal_cli.core.results")
EMITTED = sorted(emitted(), key=lambda one: (one[0], sorted(one[1]), one[2]))


def test_every_code_has_a_sentence_and_every_sentence_a_code() -> None:
    codes = {code for code, _, _ in EMITTED}
    of_devices = {code for code, _, _ in emitted("devices/*.py", without="")}
    assert of_devices <= DEVICES.keys() and not DEVICES.keys() & codes
    assert codes - SENTENCES.keys() == set(), "no sentence"
    assert SENTENCES.keys() - codes == set(), "never emitted"
    assert SENTENCES.keys() == EXAMPLES.keys(), "no example, or one too many"
    assert all(re.fullmatch("[a-z][a-z0-9_]*", code) for code in codes)


@pytest.mark.parametrize(("code", "names", "more"), EMITTED)
def test_examples_have_the_values_that_the_package_gives(code: str, names: set[str], more: bool) -> None:
    assert any(names == set(one) or (more and names <= set(one)) for one in EXAMPLES[code])


@pytest.mark.parametrize(("code", "values"), CASES)
def test_each_code_makes_plain_sentences(code: str, values: Mapping[str, Any]) -> None:
    text = sentence(Reason(code, values))
    assert text != code
    assert re.fullmatch(r"[A-Z0-9].*[a-z0-9)%]\.", text), text
    assert not re.search(r"[{};]|\bNone\b|\bnan\b|\.\.|  | \.|\. [a-z]|: [^:.]*: ", text), text
    assert sentence(Reason.of(code, **values)), "the values are JSON"


def test_a_sentence_shows_its_values() -> None:
    found = sentence(Reason.of("not_clearly_better", **FIT | HELD_OUT | {"percent": 62.0, "orientations": 7}))
    assert found == (
        "A calibration is better than the raw data with a probability of only 62 %. Calibration error over "
        "all orientations: 31 mg before, 1.2 mg after (95 % interval 0.8 to 2 mg, 7 recorded orientations)."
    )
    missing = sentence(Reason("subsets_not_full", EXAMPLES["subsets_not_full"][0]))
    assert missing.endswith("at least 0.2 g apart. Missing in the fit set: x -1 g and z 0 g.")
    assert sentence(Reason("calibrated", EXAMPLES["calibrated"][0])).endswith(
        " Error |r - 1| on held-out orientations: 31.5 mg before, 2.04 mg after, 15.4 times smaller (95 % "
        "interval 11.8 to 20.2)."
    )
    part = sentence(Reason("calibrated_in_part", EXAMPLES["calibrated_in_part"][1]))
    assert part.endswith(" It leaves misalignment out: no still window has -z pointing up (0.3 g or more).")
    assert clause(Reason("fit_diverges")) == ("the optimizer came to no minimum")


@pytest.mark.parametrize(
    ("code", "values"),
    [
        ("a_code_of_a_later_version", {}),
        ("too_few_orientations", {"needed": 9}),
        ("uncertain_somewhere", {"by_mg": "much"}),
        ("model_uncertain", {"model": "9", "why": {"unknown": 1}}),
        ("rolled", {"axis": "z", "before_mg": 3, "after_mg": None}),
        ("misfit", {"kind": [], "size": 1, "largest_mg": None}),
    ],
)
def test_a_reason_that_no_sentence_fits_is_shown_by_its_code(code: str, values: dict[str, Any]) -> None:
    assert sentence(Reason(code, values)) == code


def test_a_study_s_table_says_how_a_sensor_changed() -> None:
    text = (
        "The sensor changed during the recording: its offsets jump at 2025-01-10T14:00:00, by up to 40.0 mg."
    )
    assert changed("step", "2025-01-10T14:00:00.000000", 40.0) == text


def test_text_from_a_file_stays_on_its_line() -> None:
    assert "\n" not in sentence(Reason("other_device", {"serial": "A\n1"}))


def documented_row(code: str) -> str:
    """The row of docs/reasons.md on a code: the sentence of its last example, and all names of its values."""
    examples = EXAMPLES[code]
    text = sentence(Reason(code, examples[-1])).replace("|", r"\|")
    names = dict.fromkeys(name for one in examples for name in one)
    return f"| `{code}` | {text} | {' '.join(f'`{name}`' for name in names)} |".replace("  |", " |")


def test_every_code_is_documented() -> None:
    """Put the rows that are missing here into docs/reasons.md, in the order of the alphabet."""
    lines = (PACKAGE.parent / "docs" / "reasons.md").read_text(encoding="utf-8").splitlines()
    table = lines[lines.index("| code | as a sentence | values |") :]
    rows = [line for line in table if line.startswith("| `")]
    expected = [documented_row(code) for code in sorted(SENTENCES)]
    assert set(expected) - set(rows) == set(), "missing"
    assert rows == expected
