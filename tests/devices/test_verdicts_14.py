"""Devices judged with each recording's own uncertainty, two sensors under one serial, and copies."""

from __future__ import annotations

import csv
import io
import json
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.devices.review import DeviceReview
from accelcal_cli.output.sentences import of_device
from tests.cli.run import run
from tests.devices.made import FITTED, drifting, fitted, good_devices, refused, reviewed, write

ROOT = Path(__file__).parents[2]
HIGH = "calibration_error_high_mg"


def verdicts(tmp_path: Path, rows: list[dict[str, Any]], **rules: float) -> dict[str, str]:
    return {serial: str(one.verdict) for serial, one in reviewed(tmp_path, rows, **rules).items()}


def codes(device: DeviceReview) -> list[str]:
    return [one.reason.code for one in device.findings]


def unsure(serial: str, day: float, high_mg: float = 19.0, **said: Any) -> dict[str, Any]:
    """A short recording: coefficients to some mg, and a large held-out error."""
    errors = {f"se_{name}": 0.008 for name in FITTED["9"]}
    held_out = {"after_mg": 9.0, "ci95_low_mg": 6.5, "ci95_high_mg": 11.5, "orientations": 5}
    return fitted(serial, day, {"offset_x_g": 0.02 + 1e-5 * day, **errors}, **held_out, **said) | {
        HIGH: high_mg
    }


def sure(serial: str, day: float, offset_g: float = 0.0, **said: Any) -> dict[str, Any]:
    """A long recording whose x offset is known to 0.1 mg."""
    return fitted(serial, day, {"offset_x_g": offset_g + 1e-6 * day}, **said) | {HIGH: 2.0}


def test_verdicts_14_a_device_of_one_short_recording_is_not_known_yet(tmp_path: Path) -> None:
    """Its held-out error is far above that of the others, but so is the recording's uncertainty."""
    found = reviewed(tmp_path, [*good_devices(8), unsure("short", 0), unsure("both", 0), sure("both", 7)])
    assert (found["short"].verdict, codes(found["short"])) == ("unknown", ["device_not_known"])
    (finding,) = found["short"].findings
    assert finding.reason.values == {"recordings": 1, "refused": 0, "shared": 0, "least_high_mg": 19.0}
    assert of_device(finding.reason).startswith("not known yet: the best recording may be 19 mg off; ")
    assert (found["both"].verdict, found["both"].sure, found["both"].held_out_mg) == ("good", 1, 2.0)
    loose = reviewed(tmp_path, [*good_devices(8), unsure("short", 0)], certain_mg=20.0)
    assert codes(loose["short"]) == ["device_held_out"]


def test_verdicts_14_an_error_beyond_the_others_by_less_than_its_interval_is_none(tmp_path: Path) -> None:
    for low_mg, found in ((4.4, []), (4.8, ["device_held_out"])):
        row = sure("x", 0, after_mg=6.0, ci95_low_mg=low_mg, ci95_high_mg=7.5)
        assert codes(reviewed(tmp_path, [*good_devices(8), row])["x"]) == found


def test_verdicts_14_a_provisional_recording_judges_no_device(tmp_path: Path) -> None:
    assert verdicts(tmp_path, [sure("A", 0), sure("B", 0, outcome="provisional")]) == {
        "A": "good",
        "B": "unknown",
    }


def test_verdicts_14_refusals_of_short_recordings_blame_no_device(tmp_path: Path) -> None:
    """A refusal in nine orientations or more tells of the device; one in fewer of how it was worn."""
    for postures, verdict in ((None, "unknown"), (8, "unknown"), (9, "service")):
        rows = [refused("A", 30.0 * number, orientations=postures) for number in range(3)]
        assert verdicts(tmp_path, [*good_devices(4), *rows])["A"] == verdict


def test_verdicts_14_two_sensors_under_one_serial(tmp_path: Path) -> None:
    """Recordings that jump by 31 mg from month to month, and differ by 36 mg on one day."""
    rows = [sure("two", 30.0 * number, 0.031 * (number >= 4)) for number in range(8)]
    rows.append(sure("two", 210.4, -0.005))
    found = reviewed(tmp_path, [*good_devices(4), *rows])
    assert next(iter(found)) == "two"
    assert (found["two"].verdict, codes(found["two"])) == ("two_sensors", ["two_sensors"])
    values = found["two"].findings[0].reason.values
    assert values["parameter"] == "offset_x" and values["change"] == pytest.approx(-36.0, abs=0.1)
    assert values["paths"] == [rows[7]["path"], rows[8]["path"]]
    assert "two sensors under one serial?" in of_device(found["two"].findings[0].reason)


def test_verdicts_14_sensors_in_turn_return_and_one_that_steps_does_not(tmp_path: Path) -> None:
    turns = [sure("turns", 30.0 * number, 0.03 * (number % 2)) for number in range(4)]
    steps = [sure("steps", 30.0 * number, 0.03 * (number > 1)) for number in range(4)]
    found = reviewed(tmp_path, [*turns, *steps])
    assert codes(found["turns"]) == ["two_sensors"]
    assert (found["steps"].verdict, codes(found["steps"])) == ("service", ["device_step"])
    assert of_device(found["steps"].findings[0].reason).startswith("offset x changes by +30.0 +- ")


@pytest.mark.parametrize(("days", "lasts_days", "code"), [(2.0, 0, "two_sensors"), (2.1, 0, "device_step"),
                                                          (6.0, 7, "two_sensors")])  # fmt: skip
def test_verdicts_14_near_is_two_days_or_an_overlap(
    tmp_path: Path, days: float, lasts_days: float, code: str
) -> None:
    rows = [sure("A", 0, duration_s=86_400.0 * lasts_days), sure("A", days, 0.03)]
    assert codes(reviewed(tmp_path, rows)["A"]) == [code]


def test_verdicts_14_a_contradiction_exceeds_the_intervals(tmp_path: Path) -> None:
    """An uncertain recording contradicts nothing by 30 mg, and nothing is within 2 mg between occasions."""
    rows = [sure("A", 0, -0.01), unsure("A", 0.5), sure("B", 0), sure("B", 0.5, 0.012)]
    assert {one.jumps for one in reviewed(tmp_path, rows).values()} == {()}
    rows += [sure("B", 1.0, 0.03)]
    assert codes(reviewed(tmp_path, rows)["B"]) == ["two_sensors"]


def test_verdicts_14_a_true_drift_is_found_as_before(tmp_path: Path) -> None:
    rows = [*drifting("D", 0.003), unsure("D", 10.0), unsure("D", 70.0)]
    found = reviewed(tmp_path, [*good_devices(), *rows])
    assert (found["D"].verdict, codes(found["D"])) == ("service", ["device_drift"])


def test_verdicts_14_a_fast_drift_is_a_drift_and_no_step(tmp_path: Path) -> None:
    """20 mg from month to month contradict a sensor that stays, but a line explains them."""
    device = reviewed(tmp_path, [*good_devices(), *drifting("D", 0.02)])["D"]
    assert device.jumps and codes(device) == ["device_drift"]


def test_verdicts_14_a_copy_names_its_original(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    row = fitted("A", 0, path="b")
    out = write(tmp_path, [row, row | {"path": "a"}, row | {"path": "c"}, fitted("A", 30, path="d")])
    told = csv.DictReader(io.StringIO(run(capsys, "devices", out, "--csv").out))
    assert [(one["path"], one["use"], one["copy_of"]) for one in told] == [
        ("a", "used", ""), ("b", "copy", "a"), ("c", "copy", "a"), ("d", "used", ""),
    ]  # fmt: skip
    (device,) = json.loads(run(capsys, "devices", out, "--json").out)["devices"]
    assert (device["recordings"], device["uses"]) == (2, {"copy": 2, "used": 2})


def test_verdicts_have_codes_and_sentences(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = write(tmp_path, drifting("D", 0.005))
    (device,) = json.loads(run(capsys, "devices", out, "--json").out)["devices"]
    (reason,) = device["reasons"]
    assert (device["verdict"], reason["code"], reason["verdict"]) == ("service", "device_drift", "service")
    assert reason["values"].keys() >= {"parameter", "unit", "per_month", "error", "limit", "certain"}
    assert reason["text"] == "offset x drifts by +4.990 +- 0.016 mg a month"


@pytest.mark.nightly
def test_verdicts_14_no_sound_device_is_blamed_for_short_recordings(tmp_path: Path) -> None:
    """Sixty simulated devices with one to three recordings of 3 to 40 postures, judged as recordings are."""
    tool, random = runpy.run_path(str(ROOT / "tools/compare_priors.py")), np.random.RandomState(3)
    rows = []
    for device in range(60):
        sensor = np.repeat([1.0, 0, 0], 3) + np.repeat([0.02, 0.013, 0.035], 3) * random.standard_normal(9)
        for number in range(random.randint(1, 4)):
            postures = random.randint(3, 9) if random.rand() < 0.4 else random.randint(15, 40)
            verdict = tool["judged"](tool["rest"](sensor, postures, random), None)
            row = tool["row"](verdict, f"{device}-{number}", f"{device:02}", number)
            held_out, error = verdict.holdout, verdict.sphere
            row |= {
                "path": row["sha256"],
                "format": "cwa",
                "exit_code": 0,
                "lost_percent": 0.0,
                "model": None,
            }
            row |= {"reason": verdict.reason.code, "orientations": held_out and held_out.postures}
            if verdict.calibration is not None:
                low, high = held_out.ci95
                row |= {"model": "9", "after_mg": held_out.after.mean, "ci95_low_mg": low}
                row |= {"ci95_high_mg": high, HIGH: error.ci95[1]}
            rows.append(row)
    found = verdicts(tmp_path, rows)
    assert set(found.values()) <= {"good", "unknown"}
    assert list(found.values()).count("good") >= 35
