"""`STEM.quality.json` beside the report, and whether coefficients of another recording still fit."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from jsonschema import Draft202012Validator

from accelcal_cli.collect import cells
from accelcal_cli.core.points import PointSet
from accelcal_cli.output.quality import (
    BlockErrors,
    PointErrors,
    QualityInput,
    dumps_quality,
    quality_json,
    quality_schema,
)
from accelcal_cli.pipeline.calibrate import RecordingRun
from tests.cli.run import Ran, assert_one_line, exit_code, nightly, run, verify
from tests.cli.test_change import HOUR, HOURS, jumping, long_raw
from tests.device_recordings import donor, week
from tests.recordings import (
    GAIN,
    LSB_PER_G,
    OFFSET_G,
    directions,
    good_csv,
    good_raw,
    still_counts,
    straightened,
    write_raw,
)


@cache
def validator() -> Draft202012Validator:
    schema = quality_schema()
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


def lengths(columns: dict[str, Any]) -> set[int]:
    """How long the columns of a table are, those of its inner tables too."""
    inner = [
        part
        for value in columns.values()
        for part in (value.values() if isinstance(value, dict) else [value])
    ]
    return {len(column) for column in inner if column is not None}


def document(path: Path) -> dict[str, Any]:
    """A quality file that is what the schema says."""
    found: dict[str, Any] = json.loads(path.read_text("utf-8"))
    validator().validate(found)
    assert len(lengths(found["rows"])) == 1 and len(lengths(found["points"])) == 1
    return found


@pytest.fixture(scope="module")
def day(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a day, its report and quality, and another one whose offsets jump at two."""
    folder = tmp_path_factory.mktemp("day")
    long_raw(folder / "day.raw")
    jumping(folder / "jumps.raw")
    for name, words in (("day", ("--windows", folder / "all.parquet")), ("jumps", ())):
        assert exit_code("calibrate", folder / f"{name}.raw", "--report-only", "-q", *words) == 0
    return folder


def test_the_rows_are_those_of_the_recording(day: Path) -> None:
    found = document(day / "day.quality.json")
    report = json.loads((day / "day.calibration.json").read_text())
    rows = found["rows"]
    assert (found["sha256"], found["outcome"]) == (report["recording"]["sha256"], "calibrated")
    assert found["row"] == {"samples": HOUR, "seconds": 3600.0, "rate_hz": 0.5}
    assert rows["start"] == [f"2024-03-04T{hour:02}:00:00.000000" for hour in range(HOURS)]
    assert rows["samples"] == [HOUR] * HOURS and rows["worn"] == [True] * HOURS
    assert rows["still"] == rows["windows"] and sum(rows["windows"]) == report["fit"]["windows"]["used"]
    for name in ("gap_s", "filled", "clipped", "recovered", "lost_bytes"):
        assert rows[name] == [0] * HOURS, name


def test_errors_are_those_of_the_windows(day: Path) -> None:
    """By hand: means of the windows of an hour within a tenth of a g, and the equation of the report."""
    rows = document(day / "day.quality.json")["rows"]
    made = json.loads((day / "day.calibration.json").read_text())["calibration"]
    held = pd.read_parquet(day / "all.parquet")
    xyz = held[["x", "y", "z"]].to_numpy()
    hour = held["first_sample"].to_numpy() // HOUR
    keys = np.column_stack([hour, np.floor(xyz * 10)])
    one, place, number = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(place.ravel(), xyz[:, axis]) / number for axis in range(3)], axis=1)
    after = (straightened(made, means) + made["offset_g"]) @ np.array(made["gain"]).T
    for name, vectors in (("before_mg", means), ("after_mg", after)):
        errors = 1000 * np.abs(np.linalg.norm(vectors, axis=1) - 1)
        for row in range(HOURS):
            mine = one[:, 0] == row
            all_windows = np.repeat(errors[mine], number[mine])
            assert rows[name]["mean"][row] == pytest.approx(all_windows.mean(), abs=0.006)
            p95 = np.percentile(all_windows, 95, method="inverted_cdf")
            assert rows[name]["p95"][row] == pytest.approx(p95, abs=0.006)
            signed = 1000 * (np.repeat(np.linalg.norm(vectors[mine], axis=1), number[mine]) - 1)
            for percent in (5, 50, 95):
                held = rows[name.replace("_mg", "_off_mg")][f"p{percent}"][row]
                exact = np.percentile(signed, percent, method="inverted_cdf")
                assert held == pytest.approx(exact, abs=0.006)
    assert rows["windows"] == np.bincount(hour).tolist()


def test_the_points_are_those_of_the_windows(tmp_path: Path) -> None:
    """Against `--integers`, the table of all still windows, and the equation of the report."""
    path, table = week(tmp_path / "warm.raw", warm=True), tmp_path / "all.parquet"
    assert run("calibrate", path, "--integers", "--windows", table, "--report-only").code == 0
    found, fit = (
        document(tmp_path / "warm.quality.json"),
        json.loads((tmp_path / "warm.integers.json").read_text()),
    )
    report = json.loads((tmp_path / "warm.calibration.json").read_text())
    columns, held = found["points"], pd.read_parquet(table)
    raw = np.array(fit["points"]) / 2**29
    assert np.array([columns[axis] for axis in "xyz"]).T.tolist() == np.rint(1000 * raw).astype(int).tolist()
    assert columns["weight"] == np.rint(np.array(fit["weights"]) * 1000 / 2**15).astype(int).tolist()
    each = held[held["role"] == "fit"].groupby("point")
    assert columns["windows"] == each.size().tolist()
    assert columns["posture"] == each["posture"].first().tolist()
    celsius = each["temperature_c"].mean().to_numpy()
    assert np.array(columns["temperature"]) / 10 == pytest.approx(celsius, abs=0.051)
    assert np.array(columns["before"]) / 1e5 + 1 == pytest.approx(np.linalg.norm(raw, axis=1), abs=1e-5)
    made = report["calibration"]
    slope = np.outer(celsius - made["temperature"]["reference_c"], made["temperature"]["slope_g_per_c"])
    a = (straightened(made, raw) + made["offset_g"] + slope) @ np.array(made["gain"]).T
    assert np.array(columns["after"]) / 1e5 + 1 == pytest.approx(np.linalg.norm(a, axis=1), abs=1e-5)
    assert [one % found["postures"]["folds"] for one in columns["posture"]] == each["fold"].first().tolist()
    for when in ("before_mg", "after_mg"):
        assert np.mean(found["postures"][when]) == pytest.approx(report["holdout"][when]["mean"], abs=0.01)
    assert found["rows"]["temperature_c"] == pytest.approx([held["temperature_c"].mean()], abs=0.2)


@pytest.mark.parametrize("name", ["day", "jumps"])
def test_the_fit_converges_from_the_raw_error_to_that_of_the_report(day: Path, name: str) -> None:
    """Also where the sensor changed: the points are those that were fitted, after they were put right."""
    steps = document(day / f"{name}.quality.json")["convergence"]
    fit = json.loads((day / f"{name}.calibration.json").read_text())["fit"]
    assert steps[-1] == fit["after_mg"]
    assert name == "jumps" or steps[0] == fit["before_mg"]  # of points that were put right it is another
    assert len(steps) > 2 and steps[1] < steps[0]


def test_of_a_sensor_that_changed_the_errors_are_those_after_it_was_put_right(day: Path) -> None:
    found = document(day / "jumps.quality.json")
    assert max(found["rows"]["after_mg"]["mean"]) < 1.5 < np.mean(found["rows"]["before_mg"]["mean"])
    off = np.average(np.abs(found["points"]["after"]), weights=found["points"]["windows"])
    assert off < 100  # hundredths of a mg
    report = json.loads((day / "jumps.calibration.json").read_text())
    assert report["calibration"]["course"] is not None


@pytest.mark.parametrize(
    ("name", "chunk"), [("jumps", 499), *(nightly("day", chunk) for chunk in (1, 499, 9999))]
)
def test_the_length_of_chunks_makes_no_difference(day: Path, tmp_path: Path, name: str, chunk: int) -> None:
    words = ("--report-only", "-d", tmp_path, "--chunk-samples", chunk)
    run("calibrate", day / f"{name}.raw", *words)
    written = f"{name}.quality.json"
    assert (tmp_path / written).read_bytes() == (day / written).read_bytes()


def test_a_refused_recording_has_errors_before_only(tmp_path: Path) -> None:
    path = write_raw(tmp_path / "few.raw", still_counts(directions(1)))
    assert run("calibrate", path).code == 4
    found = document(tmp_path / "few.quality.json")
    assert (found["outcome"], found["model"], found["rows"]["after_mg"]) == ("refused", None, None)
    assert found["convergence"] is None and found["rows"]["after_off_mg"] is None
    assert found["points"]["after"] is None and len(found["points"]["before"]) == 1
    assert found["rows"]["before_mg"]["mean"][0] > 10
    write_raw(tmp_path / "none.raw", np.zeros((0, 3), np.int16))
    run("calibrate", tmp_path / "none.raw")
    if (tmp_path / "none.calibration.json").exists():
        assert document(tmp_path / "none.quality.json")["rows"]["start"] == []


def test_coefficients_of_elsewhere_are_those_of_the_errors(tmp_path: Path) -> None:
    coefficients = donor(tmp_path)
    path = week(tmp_path / "other.raw", seed=3)
    assert run("apply", path, "--coefficients", coefficients).code == 0
    found = document(tmp_path / "other.quality.json")
    report = json.loads((tmp_path / "other.calibration.json").read_text())
    assert (found["outcome"], found["postures"]["folds"]) == ("borrowed", None)
    assert np.mean(found["postures"]["after_mg"]) == pytest.approx(
        report["holdout"]["after_mg"]["mean"], abs=0.01
    )
    assert max(found["rows"]["after_mg"]["mean"]) < 2 < min(found["rows"]["before_mg"]["mean"])


@pytest.mark.parametrize("words", [("calibrate", "--profile", "paper"), ("six-pose",)])
def test_what_keeps_no_hours_removes_the_file_of_before(tmp_path: Path, words: tuple[str, ...]) -> None:
    path = good_raw(tmp_path)
    assert run("calibrate", path, "--report-only").code == 0
    assert (tmp_path / "good.quality.json").exists()
    ran = run(words[0], path, *words[1:], "--force")
    assert ran.code in (0, 3, 4)
    assert (tmp_path / "good.quality.json").exists() == (ran.code == 3)  # nothing was written then


def test_a_missing_file_alone_is_not_made_again(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    run("calibrate", path)
    (tmp_path / "good.quality.json").unlink()
    assert "up to date" in run("calibrate", path).err
    assert not (tmp_path / "good.quality.json").exists()


def test_the_report_is_written_after_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it cannot be written, there is no report."""
    path = good_csv(tmp_path)
    (tmp_path / "good.quality.json").mkdir()
    ran = run("calibrate", path, "--force")
    assert ran.code == 5 and "Traceback" not in ran.err
    assert not (tmp_path / "good.calibration.json").exists()


def test_two_weeks_with_all_points_are_below_200_kb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The widest numbers that there can be."""
    made: list[QualityInput] = []
    whole = RecordingRun.result

    def kept(*words: Any, **more: Any) -> Any:
        found = whole(*words, **more)
        quality = found.quality()
        assert quality is not None
        made.append(quality)
        return found

    monkeypatch.setattr(RecordingRun, "result", kept)
    exit_code("calibrate", good_raw(tmp_path), "--report-only", "-q")
    (one,) = made
    text = dumps_quality(quality_json(_largest(one)))
    validator().validate(json.loads(text))
    assert 150_000 < len(text) < 200_000, len(text)


def _largest(one: QualityInput) -> QualityInput:
    hours, number, random = 14 * 24, 4096, np.random.RandomState(2)
    facts = replace(one.data.facts, utc_offset_s=3600)
    columns = {item.name: (123_456,) * hours for item in fields(one.rows) if item.name != "block_samples"}
    columns |= {
        "gap_us": (0,) * hours,
        "lost_bytes": (0,) * hours,
        "filled": (0,) * hours,
        "recovered": (0,) * hours,
    }
    columns |= {"clipped": (0,) * hours, "temperature_mc": (31_234.5,) * hours, "worn": (False,) * hours}
    vectors = random.standard_normal((number, 3))
    vectors /= np.linalg.norm(vectors, axis=1)[:, None]
    points = PointSet(
        (vectors * 2**29).astype(np.int64),
        random.randint(1, 2**15, number),
        random.lognormal(2, 1.5, number).astype(np.int64) + 1,
    )
    errors = PointErrors(points, 40 * random.standard_normal(number), 2 * random.standard_normal(number),
                         random.randint(0, 250, number), random.uniform(20, 38, number))  # fmt: skip
    blocks = {
        hour: BlockErrors(720, (43.57, 77.86, -77.86, 43.57, 77.86), (10.04, 20.11, -20.11, 10.04, 20.11))
        for hour in range(hours)
    }
    begun = [1_700_000_000_000_000 + hour * 3_600_000_000 for hour in range(hours)]
    data = replace(one.data, facts=facts)
    return replace(
        one, data=data, rows=replace(one.rows, **columns), begun_us=begun, errors=blocks, points=errors
    )


LATER = ("no_longer_fits", "error_rises")


def checked(recording: Path, *words: object) -> tuple[Ran, list[dict[str, Any]]]:
    """What `apply --report-only` printed, and its cautions about errors along time."""
    ran = run("apply", recording, *words, "--report-only")
    report = json.loads(recording.with_name(f"{recording.stem}.calibration.json").read_text())
    return ran, [one for one in report["cautions"] if one["code"] in (*LATER, "offsets_jump")]


def test_coefficients_of_a_first_recording_hold_on_a_second(day: Path, tmp_path: Path) -> None:
    second = second_day(tmp_path / "second.raw")
    ran, cautions = checked(second, "--coefficients", day / "day.calibration.json", "--any-device")
    assert (ran.code, cautions) == (0, [])
    errors = document(tmp_path / "second.quality.json")["rows"]["after_mg"]["mean"]
    assert len(errors) == HOURS and max(errors) < 2
    assert not (tmp_path / "second.calibrated.parquet").exists()


def second_day(path: Path, step_g: float = 0.0, at_hour: int = 0) -> Path:
    """The same sensor on other postures, whose offsets may jump."""
    poses = np.repeat(directions(6 * HOURS + 7)[7:], HOUR // 6, axis=0)
    late = np.arange(HOURS * HOUR) >= at_hour * HOUR
    raw = poses @ np.linalg.inv(GAIN).T - OFFSET_G + np.outer(late, [step_g, -step_g, step_g])
    noise = 0.003 * np.random.RandomState(9).standard_normal(raw.shape)
    write_raw(path, np.rint((raw + noise) * LSB_PER_G).astype(np.int16))
    layout = path.with_name(path.stem + ".layout.toml")
    layout.write_text(layout.read_text().replace("rate_hz = 25.0", "rate_hz = 0.5"))
    return path


@pytest.mark.parametrize(("at_hour", "since"), [(15, "2024-03-04T15:00:00.000000"), nightly(0, None)])
def test_a_step_is_told_with_its_hour(day: Path, tmp_path: Path, at_hour: int, since: str | None) -> None:
    second = second_day(tmp_path / "second.raw", 0.012, at_hour)
    words = ("--coefficients", day / "day.calibration.json", "--any-device")
    ran, cautions = checked(second, *words, "-q")
    assert ran.code == 0
    why = cautions[0]
    assert (why["code"], why["values"]["since"], why["values"]["until"]) == ("no_longer_fits", since, None)
    assert why["values"]["error_mg"] > 6 and why["values"]["new_mg"] < 2
    when = "From 2024-03-04T15:00:00 on their error is" if at_hour else "From the beginning on their error is"
    assert when in ran.err, "a quiet run says it, too"
    rows = document(tmp_path / "second.quality.json")["rows"]["after_mg"]["mean"]
    assert min(rows[at_hour:]) > 4 and max(rows[:at_hour], default=0) < 2
    told = verify(tmp_path / "second.calibration.json", second)[0]
    assert told.code == 0, told


def test_a_step_back_is_told_too(day: Path, tmp_path: Path) -> None:
    """Coefficients that fit the end and not the beginning."""
    second_day(tmp_path / "later.raw", 0.012, 0)
    assert run("calibrate", tmp_path / "later.raw", "--report-only").code == 0
    second = second_day(tmp_path / "second.raw", 0.012, 9)
    ran, cautions = checked(
        second, "--coefficients", tmp_path / "later.calibration.json", "--any-device", "-v"
    )
    values = cautions[0]["values"]
    assert (ran.code, values["since"], values["until"]) == (0, None, "2024-03-04T09:00:00.000000")
    assert "From the beginning to 2024-03-04T09:00:00 their error is" in ran.err


def test_hours_are_told_without_errors_of_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """More orientations and temperatures than are kept: errors are not known by hours, all the rest is."""
    monkeypatch.setattr(cells, "MAX_TIMED", 300)
    path = tmp_path / "day.cwa"
    run("simulate", path, "--format", "cwa", "--days", 1, "--rate", 12.5, "--seed", 3, "-q")
    assert run("calibrate", path, "--report-only", "--html", "-q").code == 0
    report = json.loads((tmp_path / "day.calibration.json").read_text())
    assert report["change"]["unchecked"] == "too_many_cells"
    found = document(tmp_path / "day.quality.json")
    rows = found["rows"]
    assert len(rows["start"]) == 24 and sum(rows["samples"]) == 86_400 * 25 // 2
    assert rows["before_mg"] == {"mean": [None] * 24, "p95": [None] * 24}
    assert (tmp_path / "day.html").exists()


def test_few_postures_cannot_tell(day: Path, tmp_path: Path) -> None:
    path = write_raw(tmp_path / "few.raw", still_counts(np.repeat(directions(4), 3, axis=0)))
    words = ("--coefficients", day / "day.calibration.json", "--any-device")
    assert checked(path, *words)[1] == []


def test_coefficients_that_are_far_off_need_no_long_recording(day: Path, tmp_path: Path) -> None:
    path = write_raw(tmp_path / "other.raw", still_counts(-directions(20)) + np.int16(20))
    words = ("--coefficients", day / "day.calibration.json", "--any-device")
    ran, _ = checked(path, *words, "-q")
    assert ran.code == 0 and "mg or more" in ran.err


def test_a_removed_command_names_its_new_form() -> None:
    for words, form in (
        (("quality", "a.cwa"), "accelcal apply --coefficients NAME.calibration.json RECORDING --report-only"),
        (("effect", "a.cwa", "--epoch", 60), "accelcal calibrate RECORDING --effect"),
    ):
        assert_one_line(run(*words), f"`{words[0]}` is now {form}", code=2)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [1, 2])
def test_the_independent_generator(tmp_path: Path, real_data: Path, seed: int) -> None:
    """Two days of one sensor: with coefficients of other days, and with a step of 12 mg on the second one."""
    tool = real_data.parent / "tools" / "make_recording.py"
    step = ("--at-hour", "30", "--step-mg", "12", "-10", "12")
    for name, more in (
        ("first", ("--seed", "1")),
        ("second", ("--seed", "2")),
        ("steps", ("--seed", "3", *step)),
    ):
        command = [
            sys.executable,
            str(tool),
            "--days",
            "2",
            "--truth",
            str(seed),
            "--out",
            str(tmp_path / name),
        ]
        subprocess.run([*command, *more], check=True, capture_output=True)
    assert run("calibrate", tmp_path / "first.cwa", "--report-only").code == 0
    coefficients = tmp_path / "first.calibration.json"
    assert checked(tmp_path / "second.cwa", "--coefficients", coefficients)[1] == []
    _, cautions = checked(tmp_path / "steps.cwa", "--coefficients", coefficients)
    assert cautions[0]["values"]["since"] == "2024-03-05T06:00:00.000000"
