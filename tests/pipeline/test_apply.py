"""Known coefficients applied to a recording: whose they are, what is applied, refused and borrowed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from accelcal_cli.core.calibration import Calibration, TemperatureScale
from accelcal_cli.core.errors import Reason, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Recording
from accelcal_cli.core.results import ErrorSummary, Holdout, Judgement
from accelcal_cli.core.settings import DEFAULT, PAPER, PoseSettings
from accelcal_cli.formats import open_recording
from accelcal_cli.output.coefficients import Coefficients, read_coefficients
from accelcal_cli.pipeline.apply import (
    Relation,
    apply,
    at_reference,
    borrow,
    checked_relation,
    judged_elsewhere,
    keep_coefficients,
    need_temperature,
    relation_of,
    settings_for,
)
from accelcal_cli.pipeline.calibrate import Survey, calibrate
from accelcal_cli.pipeline.jobs import Job, Request, plan
from accelcal_cli.pipeline.outputs import json_round_trip
from tests.device_recordings import donor, edit, set_coefficients, week
from tests.recordings import GAIN, OFFSET_G


def coefficients(folder: Path, *, warm: bool = False) -> tuple[Coefficients, Path]:
    """The coefficients of a device's recording, and that recording."""
    return read_coefficients(donor(folder, warm=warm)), folder / "donor.raw"


def described(path: Path) -> Recording:
    with open_recording(path, ReadOptions()) as reader:
        return reader.recording


def job_of(path: Path, folder: Path) -> Job:
    (job,) = plan([path], folder, None)
    return job


def holdout(before: float, after: float) -> Holdout:
    summary = ErrorSummary(before, before, before), ErrorSummary(after, after, after)
    return Holdout("m", 20, 7, *summary, (0.0, after), ((before, after),) * 7)


def test_a_recording_and_its_own_coefficients(tmp_path: Path) -> None:
    mine, path = coefficients(tmp_path)
    recording = described(path)
    assert relation_of(mine, recording, path, Request()) is Relation.OWN
    in_mg = Request(options=ReadOptions(unit="mg"))
    assert relation_of(mine, recording, path, in_mg) is Relation.OWN, "a flash dump has counts"
    assert relation_of(mine, replace(recording, lsb_per_g=100.0), path, Request()) is Relation.REREAD
    other = week(tmp_path / "other.raw", seed=2)
    assert relation_of(mine, described(other), other, Request()) is Relation.OTHER


UNKNOWN = "neither the recording nor the coefficients say which device they come from"


@pytest.mark.parametrize(
    ("owner", "serial", "message"),
    [
        ("A1", "A1", None),
        ("A1", "B2", "was recorded by device B2, but the coefficients belong to device A1"),
        ("A1", None, "does not say which device recorded it, but the coefficients belong to device A1"),
        (
            None,
            "B2",
            "was recorded by device B2, but the coefficients do not say which device they belong to",
        ),
        (None, None, UNKNOWN),
        ("", None, UNKNOWN),
    ],
)
def test_another_device_is_refused_unless_any_will_do(
    tmp_path: Path, owner: str | None, serial: str | None, message: str | None
) -> None:
    report = edit(donor(tmp_path), lambda held: held["recording"]["device"].update(serial=owner))
    theirs = read_coefficients(report)
    path = week(tmp_path / "other.raw", seed=2, poses=20, serial=serial)
    recording = described(path)
    assert checked_relation(theirs, recording, path, Request(any_device=True)) is Relation.OTHER
    if message is None:
        assert checked_relation(theirs, recording, path, Request()) is Relation.OTHER
    else:
        with pytest.raises(UsageError) as refusal:
            checked_relation(theirs, recording, path, Request())
        assert (refusal.value.message, refusal.value.path) == (message, path)


@pytest.mark.parametrize(
    ("change", "option"), [({"temperature": False}, "--no-temperature"), ({"latitude": 10.0}, "--latitude")]
)
def test_its_own_coefficients_hold_only_as_they_were_found(tmp_path: Path, change: dict, option: str) -> None:
    mine, path = coefficients(tmp_path, warm=True)
    request = Request(settings=replace(DEFAULT, **change), any_device=True)
    with pytest.raises(UsageError) as refusal:
        checked_relation(mine, described(path), path, request)
    assert (
        refusal.value.message == f"the coefficients are this recording's own, and were found without {option}"
    )
    assert refusal.value.hint == f"omit {option}, or calibrate the recording again with it"


def test_stillness_is_found_as_in_the_donor_but_judged_by_the_default(tmp_path: Path) -> None:
    theirs, _ = coefficients(tmp_path)
    used = replace(DEFAULT, segment_seconds=7.0, optimizer="float64", model="6", latitude=50.0)
    wanted = replace(DEFAULT, precision_mg=0.5, max_damage_percent=20.0)
    edit(theirs.document.path, lambda report: report["settings"].update(used.as_json()))
    theirs = read_coefficients(theirs.document.path)
    own = settings_for(theirs, Relation.OWN, wanted)
    assert own == replace(used, precision_mg=0.5, max_damage_percent=20.0)
    other = settings_for(theirs, Relation.OTHER, wanted)
    place = theirs.calibration.gravity
    assert other == replace(
        wanted, segment_seconds=7.0, temperature=False, latitude=place.latitude, altitude_m=place.altitude_m
    )
    here = settings_for(theirs, Relation.OTHER, replace(wanted, latitude=-30.0))
    assert (here.latitude, here.altitude_m) == (-30.0, None)


def test_settings_of_a_session_or_of_the_papers_are_not_those_of_another_recording(tmp_path: Path) -> None:
    theirs, _ = coefficients(tmp_path)
    for used in (PAPER, PoseSettings()):
        edit(theirs.document.path, lambda report, used=used: report["settings"].update(used.as_json()))
        read = read_coefficients(theirs.document.path)
        assert settings_for(read, Relation.OTHER, DEFAULT) == replace(DEFAULT, temperature=False)


def test_slopes_are_dropped_where_temperature_is_not_wanted(tmp_path: Path) -> None:
    warm, path = coefficients(tmp_path, warm=True)
    scale = warm.calibration.temperature
    assert isinstance(scale, TemperatureScale)
    assert at_reference(warm.calibration, DEFAULT) is warm.calibration
    cold = at_reference(warm.calibration, replace(DEFAULT, temperature=False))
    assert (cold.model, cold.temperature) == (warm.calibration.model.removesuffix("T"), None)
    assert cold.parameters == (*warm.calibration.parameters[:9], 0, 0, 0)
    need_temperature(cold, described(path), has=False)
    need_temperature(warm.calibration, described(path), has=True)
    with pytest.raises(UsageError) as refusal:
        need_temperature(warm.calibration, described(path), has=False)
    assert refusal.value.message == "has no temperature, but the coefficients depend on it"
    at_c = f"{scale.reference_mc / 1000:.1f} °C"
    assert refusal.value.hint == f"--no-temperature applies them as at {at_c}"


def judged(
    donor: Coefficients, calibration: Calibration, recording: Recording, errors: Holdout | None
) -> Judgement:
    """The verdict on a donor's coefficients."""
    found = cast(Survey, SimpleNamespace(recording=recording, coverage=None))
    return judged_elsewhere(donor, calibration, found, errors, 10.0)


def test_the_verdict_has_whose_they_are_what_they_did_and_what_differs(tmp_path: Path) -> None:
    warm, path = coefficients(tmp_path, warm=True)
    recording = described(path)
    own = judged(warm, warm.calibration, recording, holdout(30.0, 1.25))
    whose = {"path": warm.origin.path, "sha256": warm.origin.sha256[:12], "device": "A1"}
    assert own.reason == Reason("borrowed", whose | {"before_mg": 30.0, "after_mg": 1.25, "orientations": 7})
    assert not own.notes and not own.cautions
    other = replace(recording, lsb_per_g=100.0, device=replace(recording.device, serial="B2"))
    cold = judged(warm, at_reference(warm.calibration, replace(DEFAULT, temperature=False)), other, None)
    assert cold.notes == (
        Reason("other_device", {"serial": "B2"}),
        Reason("other_counts_per_g", {"here": 100.0, "there": recording.lsb_per_g}),
        Reason.of("slopes_left_out", at_c=warm.calibration.reference_c()),
    )
    nameless = replace(recording, device=replace(recording.device, serial=None))
    assert judged(warm, warm.calibration, nameless, None).notes == (
        Reason("other_device", {"serial": "unknown"}),
    )


@pytest.mark.parametrize(
    ("before", "after", "warned"),
    [
        (30.0, 1.0, []),
        (5.0, 6.0, ["worse_here"]),
        (30.0, 10.0, ["much_left"]),
        (11.0, 12.0, ["worse_here", "much_left"]),
    ],
)
def test_a_caution_where_the_coefficients_do_not_help(
    tmp_path: Path, before: float, after: float, warned: list[str]
) -> None:
    warm, path = coefficients(tmp_path)
    verdict = judged(warm, warm.calibration, described(path), holdout(before, after))
    assert [one.code for one in verdict.cautions] == warned


def test_the_file_of_the_coefficients_is_not_written_over(tmp_path: Path) -> None:
    job = job_of(tmp_path / "a.raw", tmp_path)
    keep_coefficients(tmp_path / "b.calibration.json", [job])
    job.report.write_text("{}")
    (tmp_path / "link.json").symlink_to(job.report)
    (tmp_path / "folder").symlink_to(tmp_path)
    links = (tmp_path / "link.json", tmp_path / "folder" / job.report.name)
    for path in (job.report, job.parquet, job.integers, job.quality, *links):
        with pytest.raises(UsageError, match="holds the coefficients and would be overwritten"):
            keep_coefficients(path, [job])


def test_apply_again_is_up_to_date_until_something_changes(tmp_path: Path) -> None:
    theirs, _ = coefficients(tmp_path)
    job = job_of(week(tmp_path / "other.raw", seed=2, poses=20), tmp_path / "out")
    first = apply(job, Request(coefficients=theirs))
    assert (str(first.outcome), first.up_to_date) == ("borrowed", False)
    again = apply(job, Request(coefficients=theirs))
    assert (again.report, again.up_to_date) == (json_round_trip(first.report), True)
    edit(theirs.document.path, lambda report: report.update(message="another"))
    changed = read_coefficients(theirs.document.path)
    assert not apply(job, Request(coefficients=changed)).up_to_date
    assert apply(job, Request(coefficients=changed)).up_to_date
    assert not apply(job, Request(coefficients=changed, force=True)).up_to_date
    elsewhere = replace(DEFAULT, latitude=10.0)
    assert not apply(job, Request(coefficients=changed, settings=elsewhere)).up_to_date


def test_the_first_donor_that_proves_itself_lends(tmp_path: Path) -> None:
    good = donor(tmp_path)
    bad = tmp_path / "bad.calibration.json"
    bad.write_bytes(good.read_bytes())
    edit(bad, lambda report: set_coefficients(report, GAIN @ GAIN @ GAIN, -3 * OFFSET_G, "9"))
    poor = week(tmp_path / "poor.raw", seed=2, poses=12)
    job = job_of(poor, tmp_path / "out")
    found = borrow(job, Request(), [bad, good], must_be_better=False)
    assert found.result is not None
    assert str(found.result.outcome) == "borrowed"
    (reason,) = found.reasons
    assert (reason.code, reason.values["path"]) == ("donor", read_coefficients(good).origin.path)
    assert reason.values["why"]["code"] in ("not_less", "over_limit_here")
    assert found.result.report["coefficients"]["path"] == "../donor.calibration.json"
    assert found.result.report["coefficients"]["without_provenance"] is True


def test_a_recordings_own_coefficients_are_not_borrowed(tmp_path: Path) -> None:
    report = donor(tmp_path)
    job = job_of(tmp_path / "donor.raw", tmp_path / "out")
    found = borrow(job, Request(), [report], must_be_better=False)
    origin = read_coefficients(report).origin.path
    assert found.result is None
    same = Reason.of("not_tried", message="it is the same recording")
    assert found.reasons == (Reason.of("donor", path=origin, why=same),)
    assert not list((tmp_path / "out").iterdir())


def test_a_good_calibration_of_its_own_is_preferred(tmp_path: Path) -> None:
    report = donor(tmp_path)
    other = week(tmp_path / "other.raw", seed=2)
    assert str(calibrate(job_of(other, tmp_path), Request()).outcome) == "calibrated"
    found = borrow(job_of(other, tmp_path / "out"), Request(), [report], must_be_better=True)
    assert found.result is None
    assert found.reasons[0].values["why"]["code"] == "own_is_no_worse"


def test_without_stillness_no_donor_can_be_tested(tmp_path: Path) -> None:
    report = donor(tmp_path)
    path = week(tmp_path / "other.raw", seed=2, poses=1)
    found = borrow(job_of(path, tmp_path / "out"), Request(), [report, report], must_be_better=False)
    assert found.reasons == (Reason.of("untested", needed=2),)
