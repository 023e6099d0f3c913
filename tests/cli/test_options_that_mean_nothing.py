"""Reading options that a format does not understand: never taken in silence, never among the settings."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.output.report import Member
from accelcal_cli.pipeline.jobs import Request, sha256
from accelcal_cli.pipeline.pool import pool
from tests.cli.run import assert_one_line, report_of, run
from tests.cli.studies import rows, study
from tests.device_recordings import rest, write_device
from tests.formats import make_cwa
from tests.recordings import RATE_HZ, directions, good_csv, good_raw, still_counts

NOTE = "--unit does not apply to format raw and was not used"


def mixed(folder: Path) -> Path:
    """A dump, for which a unit means nothing, and a table, for which it does."""
    folder.mkdir()
    good_raw(folder, "a.raw")
    good_csv(folder, "b.csv")
    return folder


@pytest.mark.parametrize(
    ("words", "name", "kind"),
    [
        (("--unit", "mg"), "--unit", "raw"),
        (("--columns", "x,y,z"), "--columns", "raw"),
        (("-R", "time_column=t", "-R", "date_format=dmy"), "-R time_column and -R date_format", "raw"),
        (("--sensor", "imu"), "--sensor", "raw"),
    ],
)
@pytest.mark.parametrize("command", ["calibrate", "inspect", "six-pose"])
def test_for_one_recording_they_are_wrong_usage(
    tmp_path: Path, command: str, words: tuple[str, ...], name: str, kind: str
) -> None:
    path = good_raw(tmp_path) if kind == "raw" else good_csv(tmp_path)
    before = sorted(tmp_path.iterdir())
    ran = run(command, path, *words, code=2)
    several = " and " in name
    assert_one_line(ran, f"{name} {'do' if several else 'does'} not apply to format {kind}; omit ")
    assert ("omit them" in ran.err) == several
    assert sorted(tmp_path.iterdir()) == before


def test_columns_of_a_cwa_are_wrong_usage(tmp_path: Path) -> None:
    made = make_cwa.make(tmp_path, still_counts(directions(2)), RATE_HZ, 256.0)
    ran = run("calibrate", made.path, "--columns", "x,y,z", "--unit", "mg")
    assert_one_line(ran, "--unit and --columns do not apply to format cwa", code=2)


def test_of_several_those_that_they_are_not_meant_for_say_so(tmp_path: Path) -> None:
    folder = mixed(tmp_path / "in")
    words = ("--unit", "g", "--report-only", "-d", tmp_path)
    assert run("calibrate", *sorted(folder.glob("[ab].[rc]*")), *words).code == 0
    told, used = report_of(tmp_path / "a.calibration.json"), report_of(tmp_path / "b.calibration.json")
    assert (told["settings"]["input"]["unit"], told["recording"]["notes"]) == (None, [NOTE])
    assert told["settings"]["input"]["unused"] == ["unit"]
    assert used["settings"]["input"]["unit"] == "g" and "unused" not in used["settings"]["input"]
    assert not any("not apply" in note for note in used["recording"]["notes"])


@pytest.mark.nightly
def test_in_a_study_too_whatever_was_there_before(tmp_path: Path) -> None:
    """The note is part of the result: one without it is made again, and verify finds it again."""
    folder, out = mixed(tmp_path / "in"), tmp_path / "out"
    assert study(folder, "--report-only").code == 0
    assert study(folder, "--report-only", "--unit", "g").code == 0
    told = report_of(out / "a.calibration.json")
    assert (told["settings"]["input"]["unit"], told["recording"]["notes"]) == (None, [NOTE])
    assert report_of(out / "b.calibration.json")["settings"]["input"]["unit"] == "g"
    assert "2 unchanged" in study(folder, "--report-only", "--unit", "g").err
    assert [row["outcome"] for row in rows(out)] == ["calibrated"] * 2
    ran = run("verify", out / "a.calibration.json", folder / "a.raw")
    assert (ran.code, ran.out.split("\t")[1]) == (0, "identical"), ran


def test_in_a_study_they_must_mean_something_for_one(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    raw = good_raw(folder, "a.raw")
    cwa = make_cwa.make(folder, still_counts(directions(2)), RATE_HZ, 256.0).path
    ran = study(folder, "--sensor", "imu")
    assert_one_line(ran, "--sensor does not apply to formats cwa and raw", code=2)
    assert not list((tmp_path / "out").glob("*.json"))
    ran = run("calibrate", raw, cwa, "--sensor", "imu")
    assert_one_line(ran, "--sensor does not apply to formats cwa and raw", code=2)


def test_what_means_nothing_for_all_members_is_left_out_of_a_pool(tmp_path: Path) -> None:
    members = []
    for name, seed in (("one", 1), ("two", 2)):
        path = write_device(tmp_path / f"{name}.raw", rest(directions(12), seed)[0])
        members.append(Member(path, sha256(path)))
    made = pool(members, Request(options=ReadOptions(unit="g"), several=True))
    assert (made["settings"]["input"]["unit"], made["recording"]["notes"]) == (None, [NOTE])


@pytest.mark.nightly
def test_a_pool_leaves_out_what_means_nothing_for_its_members(tmp_path: Path) -> None:
    folder = mixed(tmp_path / "in")
    values, _ = rest(directions(24))
    for name, part in (("one", values[: len(values) // 2]), ("two", values[len(values) // 2 :])):
        write_device(folder / f"{name}.raw", part)
    assert study(folder, "--pool", "device", "--report-only", "--unit", "g").code == 0
    (pool,) = (tmp_path / "out").glob("study.pool.*.json")
    made = report_of(pool)
    assert (made["settings"]["input"]["unit"], made["recording"]["notes"]) == (None, [NOTE])


@pytest.mark.parametrize("worded", ["otherwise", "", None])
def test_no_program_reads_the_note(tmp_path: Path, worded: str | None) -> None:
    """Reports name the options as values: verify and a second run do not look at the sentence."""
    folder = mixed(tmp_path / "in")
    words = ("--unit", "g", "--report-only", "-d", tmp_path)
    assert run("calibrate", *sorted(folder.glob("[ab].[rc]*")), *words).code == 0
    told = tmp_path / "a.calibration.json"
    content = report_of(told)
    content["recording"]["notes"] = [] if worded is None else [worded]
    told.write_text(json.dumps(content))
    assert run("verify", told, folder / "a.raw").code == 0
    assert "up to date" in run("calibrate", *sorted(folder.glob("[ab].[rc]*")), *words).err
    for wrong in ("unit", ["units"], [["unit"]], [3]):
        content["settings"]["input"]["unused"] = wrong
        told.write_text(json.dumps(content))
        assert_one_line(run("verify", told, folder / "a.raw"), "settings: input.unused cannot be ", code=3)


def test_two_of_them_are_noted_in_a_sentence_and_verified(tmp_path: Path) -> None:
    folder = mixed(tmp_path / "in")
    words = ("--unit", "g", "--columns", "1,2,3", "--report-only", "-d", tmp_path)
    assert run("calibrate", *sorted(folder.glob("[ab].[rc]*")), *words).code == 0
    told = tmp_path / "a.calibration.json"
    note = "--unit and --columns do not apply to format raw and were not used"
    assert report_of(told)["recording"]["notes"] == [note]
    ran = run("verify", told, folder / "a.raw")
    assert (ran.code, ran.out.split("\t")[1]) == (0, "identical"), ran
