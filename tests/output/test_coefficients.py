"""Coefficients read back from a report: exact, and refused in one line where anything is wrong."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.calibration import Calibration, TemperatureScale
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.output.coefficients import calibration_of, coefficients_json, read_coefficients
from tests.device_recordings import ONE, donor, edit, set_coefficients

K = st.integers(round(0.8 * ONE), round(1.2 * ONE))
SMALL = st.integers(-ONE // 20, ONE // 20)


@pytest.fixture
def report(tmp_path: Path) -> Path:
    return donor(tmp_path, warm=True)


def refused(report: Path) -> str:
    with pytest.raises(UnreadableError) as caught:
        read_coefficients(report)
    assert caught.value.exit_code == 3
    text = str(caught.value)
    assert text.startswith(str(report))
    assert "\n" not in text
    return text


@given(
    st.tuples(K, K, K, *[SMALL] * 9),
    st.integers(-20_000, 60_000),
    st.sampled_from([1.0, 4.0, 16.0]),
    st.sampled_from([(None, None), (52.5, None), (-33.0, 1200.0)]),
)
def test_what_was_written_comes_back_to_the_bit(
    parameters: tuple[int, ...], reference_mc: int, span_c: float, place: tuple[Any, Any]
) -> None:
    made = Calibration("9T", parameters, TemperatureScale(reference_mc, span_c), Gravity(*place))
    assert calibration_of(json.loads(json.dumps(coefficients_json(made)))) == made


@given(st.tuples(K, K, K, *[SMALL] * 6), st.tuples(SMALL, SMALL, SMALL))
def test_a_full_gain_comes_back_too(parameters: tuple[int, ...], upper: tuple[int, int, int]) -> None:
    made = Calibration("12", (*parameters, 0, 0, 0), upper=upper)
    back = calibration_of(json.loads(json.dumps(coefficients_json(made))))
    assert back == made
    assert (back.gain() == made.gain()).all()


def test_the_origin_is_the_reports_recording(report: Path) -> None:
    found = read_coefficients(report)
    assert (found.origin.device.serial, found.calibration.model) == ("A1", "9T")
    assert found.origin.sha256 == json.loads(report.read_text())["recording"]["sha256"]


REPORT = b'{"kind": "report", "accelcal_version": "9", "schema_version": '


@pytest.mark.parametrize(
    ("data", "part"),
    [
        (b"", "not valid JSON"),
        (b"\xff\xfe{}", "not UTF-8"),
        (b'{"a": ', "not valid JSON"),
        (b"[" * 100_000, "not valid JSON"),
        (b"null", "not a report"),
        (b"[1]", "not a report"),
        (b"{}", "not a report"),
        (b'{"schema_version": 1}', "not a report"),
        (b'{"accelcal_version": "0.1.0", "prediction": {}}', "made by a development version (0.1.0) of"),
        (b'{"accelcal_version": "0.3.0", "schema_version": 3}', "made by a development version (0.3.0) of"),
        (b'{"accelcal_version": {}, "schema_version": 3}', "made by a development version of accelcal"),
        (b'{"kind": "quality", "accelcal_version": "9", "schema_version": 4}', "not a report of accelcal"),
        (REPORT + b"5}", "has schema version 5, of another version (9) of accelcal"),
        (REPORT + b"true}", "schema version True"),
        (REPORT + b"4}", "recording is missing"),
        (REPORT + b"NaN}", "NaN is not a JSON number"),
        (b'{"accelcal_version": ' + b"9" * 5000 + b"}", "not valid JSON"),
    ],
)
def test_what_is_no_report(tmp_path: Path, data: bytes, part: str) -> None:
    path = tmp_path / "a.calibration.json"
    path.write_bytes(data)
    assert part in refused(path)


def test_no_file_a_folder_and_a_recording(tmp_path: Path) -> None:
    assert "file not found" in refused(tmp_path / "absent.json")
    assert "cannot be read" in refused(tmp_path)
    big = tmp_path / "big.json"
    with big.open("wb") as file:
        file.truncate((64 << 20) + 1)
    assert "too large" in refused(big)


def test_every_cut_of_a_report_is_refused(report: Path) -> None:
    text = report.read_text().rstrip()
    for end in range(0, len(text), 97):
        report.write_text(text[:end])
        refused(report)


def test_a_refused_recording_has_no_coefficients(report: Path) -> None:
    edit(report, lambda held: held.update(calibration=None, outcome="refused", message="too short"))
    assert "no coefficients" in refused(report)
    assert "too short" in refused(report)


def leaves(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if path:
        yield path
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in inner:
        yield from leaves(part, (*path, key))


def inside(report: dict, path: tuple[Any, ...]) -> Any:
    for key in path[:-1]:
        report = report[key]
    return report


UNUSED = ("standard_errors", "covariance", "optimizer")


def test_every_key_that_is_used_is_needed_and_checked(report: Path) -> None:
    """Dropped, of another type, or another number than the others say: refused, each by its name."""
    whole = json.loads(report.read_text())
    read_coefficients(report)
    for path in leaves(whole["calibration"]):
        if path[0] in UNUSED:
            continue
        where = ("calibration", *path)
        for change in ("drop", "type", "number"):
            held = copy.deepcopy(whole)
            part, key = inside(held, where), where[-1]
            if change == "drop" and not isinstance(key, int):
                del part[key]
            elif change == "number" and isinstance(part[key], int | float):
                part[key] += 1 if isinstance(part[key], int) else 2**-40
            else:
                part[key] = {"no": "such"}
            report.write_text(json.dumps(held))
            assert "damaged report: " in refused(report), (where, change)


@pytest.mark.parametrize("path", ["path", "sha256", "device"])
def test_the_recording_is_named(report: Path, path: str) -> None:
    edit(report, lambda held: held["recording"].pop(path))
    assert f"recording.{path} is missing" in refused(report)


def model(name: str) -> Callable[[dict], None]:
    return lambda held: held["calibration"].update(model=name)


def parameters(**changed: int) -> Callable[[dict], None]:
    return lambda held: held["calibration"]["fixed_point"]["parameters"].update(changed)


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (model("9"), "contradict each other"),
        (model("12"), "contradict each other"),
        (model("7"), "calibration.model"),
        (model("3T"), "model 3T has no parameter k_xx"),
        (model("6T"), "model 6T has no parameter k_yx"),
        (parameters(k_xy=5), "model 9T has no parameter k_xy"),
        (parameters(k_xx=ONE * 4), "k_xx is not a 32-bit integer"),
        (parameters(ox=0), "calibration.offset_g is not what calibration.fixed_point says"),
        (parameters(sx=0), "calibration.temperature is not what calibration.fixed_point says"),
        (
            lambda held: held["calibration"]["fixed_point"].update(temperature_span_c=0),
            "temperature_span_c cannot be 0",
        ),
        (
            lambda held: held["calibration"]["fixed_point"].update(temperature_reference_mc=-300_000),
            "temperature_reference_mc cannot be",
        ),
        (lambda held: held["calibration"]["gravity"].update(latitude=45), "calibration.gravity is not"),
        (lambda held: held["calibration"]["fixed_point"].update(fraction_bits=28), "fraction_bits is 28"),
    ],
)
def test_numbers_that_contradict_each_other(report: Path, change: Callable[[dict], None], part: str) -> None:
    edit(report, change)
    assert part in refused(report)


@pytest.mark.parametrize(
    ("gain", "offset_g", "part"),
    [
        (np.diag([1.0, 1.0, 0.0]), [0, 0, 0], "stretches by 0 to 1"),
        (np.diag([1.0, 1.0, 2.5]), [0, 0, 0], "stretches by 1 to 2.5"),
        (np.array([[1, 1, 0], [1, 1, 0], [0, 0, 1.0]]), [0, 0, 0], "stretches by"),
        (np.eye(3), [0, 1.5, 0], "an offset is beyond 1 g"),
    ],
)
def test_what_no_sensor_has(tmp_path: Path, gain: np.ndarray, offset_g: list[float], part: str) -> None:
    report = donor(tmp_path)
    edit(report, lambda held: set_coefficients(held, gain, np.array(offset_g, float)))
    assert part in refused(report)


def test_axes_may_be_swapped_and_turned(tmp_path: Path) -> None:
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    report = edit(donor(tmp_path), lambda held: set_coefficients(held, turned, np.zeros(3)))
    assert (read_coefficients(report).calibration.gain() == turned).all()
