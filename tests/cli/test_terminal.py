"""At a terminal, a sentence that says how certain the error is; fields if asked for, and in pipes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.cli.output import counted_once, show_row
from accelcal_cli.core.errors import Reason
from accelcal_cli.output import sentences
from tests.cli.run import captured, codes, run, told
from tests.recordings import LSB_PER_G, directions, good_csv, good_raw, still_counts, write_raw

ROW = {
    "outcome": "calibrated",
    "model": "9",
    "before_mg": 13.5,
    "after_mg": 9.8,
    "ci95_low_mg": 5.4,
    "ci95_high_mg": 14.3,
    "improvement_percent": 137.8,
    "improvement_factor": 1.378,
}
UNCERTAIN = (
    "Caution: The calibrated data may be no better than the raw data: the interval includes the error before "
    "calibration (13.5 mg)."
)
REACH = "Caution: The error may be {} mg {}. Do not rely on it where a few mg matter."
ERRORS = {
    "calibration_error_mg": 4.1,
    "calibration_error_low_mg": 1.5,
    "calibration_error_high_mg": 9.9,
    "calibration_error_worst_mg": 7.0,
    "calibration_error_before_mg": 20.0,
}


def shown(
    row: dict[str, object], written: Path | None = None, *, tsv: bool = False, up_to_date: bool = False
) -> str:
    """What is printed of a row at a terminal."""

    def show() -> None:
        show_row(row, Path("a.cwa"), written, {"tsv": tsv}, up_to_date=up_to_date)

    return captured(show, terminal=True).out


def test_an_interval_that_holds_the_raw_error_is_said() -> None:
    """And one that reaches the limit of 10 mg."""
    sentence, *cautions = shown(ROW, Path("a.parquet")).splitlines()
    start = "a.cwa: calibrated with nine parameters: error |r - 1| on held-out data 13.5 -> 9.8 mg "
    assert sentence == f"{start}(95 % interval 5.4 to 14.3), 1.38 times smaller. Written to a.parquet"
    assert cautions == [f"  {REACH.format(14.3, 'on average')}", f"  {UNCERTAIN}"]
    again = shown(ROW, Path("a.parquet"), up_to_date=True).splitlines()[0]
    assert again == sentence.replace("Written to", "Unchanged:"), "what an earlier run wrote"
    assert UNCERTAIN not in shown(ROW | {"ci95_high_mg": 13.4})
    assert shown(ROW | {"ci95_high_mg": 9.9}).count("\n") == 1


def test_what_has_no_error_after_has_no_interval() -> None:
    nothing = dict.fromkeys(ROW) | {"outcome": "refused"}
    assert shown(nothing) == "a.cwa: refused\n"
    assert shown(nothing | {"message": "too short"}) == "a.cwa: refused: too short\n"
    good = nothing | {"outcome": "already_good", "before_mg": 1.25}
    assert shown(good) == "a.cwa: good as it is: the raw data are off by 1.25 mg\n"


def test_with_a_prior_the_interval_is_that_of_the_sphere() -> None:
    """The raw error on postures left out, 13.5 mg, lies in their own interval, which is not shown."""
    assert shown(ROW | ERRORS).count("\n") == 1
    wide = shown(ROW | ERRORS | {"calibration_error_high_mg": 12.0})
    assert wide.endswith(
        f"  {REACH.format(12, 'on average over all orientations, and more in single ones')}\n"
    )
    doubtful = shown(ROW | ERRORS | {"calibration_error_before_mg": 9.5})
    assert doubtful.endswith(f"\n  {UNCERTAIN.replace('13.5', '9.5')}\n")
    assert "no better" not in shown(
        ROW | ERRORS | {"calibration_error_before_mg": 9.5, "outcome": "already_good"}
    )


def test_models_are_said_in_words() -> None:
    fine = ROW | {"ci95_high_mg": 9.9}
    assert " with twelve parameters: " in shown(fine | {"model": "12"})
    assert " with six parameters and temperature: " in shown(fine | {"model": "6T"})
    borrowed = shown(fine | {"outcome": "borrowed"})
    assert "coefficients (nine parameters): error |r - 1| on its own still windows 13.5 -> 9.8 mg" in borrowed


def test_fields_at_a_terminal_are_an_option() -> None:
    assert shown(ROW, tsv=True) == "a.cwa\tcalibrated\t9\t13.500\t9.800\t138\t-\t-\t-\t-\t-\n"


def test_verdicts_10_fields_end_with_the_error_over_all_orientations() -> None:
    """And R of eq. 21 has three digits."""
    row = shown(ROW | ERRORS | {"improvement_percent": 47638.2}, Path("a.parquet"), tsv=True)
    assert row == "a.cwa\tcalibrated\t9\t13.500\t9.800\t47600\ta.parquet\t4.100\t1.500\t9.900\t-\n"


def test_verdicts_10_a_sentence_has_the_error_everywhere_and_the_factor() -> None:
    interval = {"improvement_factor_low": 1.1, "improvement_factor_high": 1.75}
    assert shown(ROW | ERRORS | interval) == (
        "a.cwa: calibrated with nine parameters: error over all orientations 20 -> 4.1 mg (95 % interval "
        "1.5 to 9.9). Error |r - 1| on held-out data 13.5 -> 9.8 mg, 1.38 times smaller (95 % "
        "interval 1.1 to 1.75)\n"
    )


def test_a_pipe_gets_fields(tmp_path: Path) -> None:
    assert len(run("calibrate", good_raw(tmp_path), "--report-only").lines[0].split("\t")) == 11


def terminal(*words: object) -> list[str]:
    """What a command prints where standard output and error are a terminal."""
    ran = run(*words, terminal=True)
    return ran.lines + [line for line in ran.err.splitlines() if line.startswith("accelcal:")]


def test_a_side_that_was_never_up_is_a_caution(tmp_path: Path) -> None:
    poses = directions(60)
    path = write_raw(tmp_path / "up.raw", still_counts(poses[poses[:, 0] > 0.35]))
    said = f"Caution: {sentences.sentence(Reason.of('sides_unchecked', sides=['-x']))}"
    sentence, *rest = terminal("calibrate", path, "--report-only")
    assert sentence.startswith(f"{path}: calibrated with nine parameters: ") and rest == [f"  {said}"]
    assert terminal("calibrate", path, "--report-only", "-q", "--force") == [sentence]
    assert terminal("calibrate", path, "--report-only", "--tsv", "--force")[1:] == []
    piped = run("calibrate", path, "--report-only", "--force")
    assert "Caution" not in piped.out + piped.err
    assert said in run("calibrate", path, "--report-only", "-v", "--force").err


def test_a_refusal_is_said_once_with_a_way_on(tmp_path: Path) -> None:
    path = write_raw(tmp_path / "three.raw", still_counts(directions(60)[:3]))
    refusal, *ways = terminal("calibrate", path, "--strict")
    report = json.loads((tmp_path / "three.calibration.json").read_text())
    why = Reason(report["reason"], report["values"])
    assert why.code == "provisional" and report["outcome"] == "refused"
    assert refusal == f"{path}: refused: {sentences.clause(why)}"
    expected = ["omit_strict", "more_orientations", "rest_on_sides", "other_coefficients"]
    assert codes(report["advice"]) == expected
    assert ways == [f"  What to do: {told(report, code)}" for code in codes(report["advice"])]
    assert "points up: -x, +y and +z. Take" in told(report, "rest_on_sides")
    piped = run("calibrate", path, "--strict", "--force")
    assert piped.err.count("\n") == 1 and "What to do" not in piped.err


@pytest.mark.parametrize(
    ("noise_g", "said"),
    [
        (0.016, "has a standard deviation of 16.8 mg (the limit is 13 mg)"),
        (0.3, "varies by 1.4 g (the limit is 0.12 g)"),
    ],
)
def test_no_stillness_is_told_with_its_numbers(tmp_path: Path, noise_g: float, said: str) -> None:
    counts = still_counts(directions(60), noise_g=noise_g)
    path = write_raw(tmp_path / "a.raw", counts)
    refusal, *ways = terminal("calibrate", path)
    windows = counts[: 360 * 125].reshape(360, 125, 3) / LSB_PER_G
    quietest = windows[np.ptp(windows, axis=1).max(axis=1).argmin()]
    numbers = np.ptp(quietest, axis=0).max(), 1000 * quietest.std(axis=0).max()
    assert f"{numbers[noise_g < 0.1]:.3g} " in said
    assert f"the quietest of 360 windows of 5 s {said}" in refusal
    first = "shorter_windows" if noise_g > 0.1 else "adaptive_rule"
    advice = (first, "record_longer", "record_again", "other_coefficients")
    assert ways == [f"  What to do: {sentences.sentence(Reason(code))}" for code in advice]


def test_windows_longer_than_the_recording_are_told(tmp_path: Path) -> None:
    ran = run("calibrate", good_raw(tmp_path), "--segment-seconds", 3000)
    why = sentences.clause(Reason.of("nothing_measured", seconds=3000))
    assert f"refused: {why}. {sentences.sentence(Reason('shorter_windows_or_longer_gaps'))}" in ran.err


def test_points_of_another_tool_cannot_be_borrowed_for(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("x,y,z\n5,5,5\n")
    assert len(terminal("fit", path)) == 1  # it says that x, y and z must be in g
    path.write_text("x,y,z\n0,0,1\n")
    _, *ways = terminal("fit", path)
    assert len(ways) == 2 and "points up: -x, +x, -y, +y and -z. Take" in ways[1]


def test_u1_several_recordings_are_summed_up_with_their_pages(tmp_path: Path) -> None:
    good, odd = good_csv(tmp_path), tmp_path / "odd.csv"
    odd.write_text("no recording")
    report = tmp_path / "good.calibration.json"
    with_page = terminal("calibrate", good, "--html")
    assert with_page[-1] == f"Page: {tmp_path / 'good.html'}"
    assert not any("page" in line.lower() for line in terminal("calibrate", good))
    several = terminal("calibrate", good, odd)
    assert (
        f"2 recordings: 1 calibrated, 1 failed. For pages: accelcal report {tmp_path}/*.calibration.json"
        in several
    )
    assert f"2 recordings: 1 calibrated, 1 failed. Pages: {tmp_path}/*.html" in terminal(
        "calibrate", good, odd, "--html"
    )
    assert report.exists() and not any(
        "2 recordings" in line for line in terminal("calibrate", good, odd, "-q")
    )
    assert not any("2 recordings" in line for line in terminal("calibrate", good, odd, "--tsv"))


def test_s4_a_problem_is_listed_once_with_its_count() -> None:
    problems = [("checksum", "pages with a wrong checksum, left out: 1")] * 4
    problems += [("checksum", "pages with a wrong checksum, left out: 36"), ("note", "odd: head")]
    assert counted_once([*problems, ("truncated", "an incomplete page, bytes left out: 320")]) == [
        "checksum: pages with a wrong checksum, left out: 40, in 5 places",
        "note: odd: head",
        "truncated: an incomplete page, bytes left out: 320",
    ]
    once = [("checksum", "a page"), ("checksum", "a page: 3")]
    assert counted_once(once) == ["checksum: a page: 3, in 2 places"]
