"""Each tool's own formula, with what is exported for it, gives what our coefficients give."""

from __future__ import annotations

import argparse
import csv
import io
import json
import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import IDENTITY, Calibration, TemperatureScale
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.recording import ThermometerWord
from accelcal_cli.core.results import ErrorSummary
from accelcal_cli.core.version import __version__
from accelcal_cli.exports.coefficients import (
    ExportedReport,
    biobank,
    cost,
    decimal,
    ggir,
    omconvert,
    read_exported,
)
from accelcal_cli.output.numbers import mg
from accelcal_cli.output.sections import Errors, HoldoutSection, RecordingSection
from tests.cli.run import run
from tests.device_recordings import donor, edit

COLUMNS = (
    "filename,scale.x,scale.y,scale.z,offset.x,offset.y,offset.z,"
    "temperature.offset.x,temperature.offset.y,temperature.offset.z,meantempcal,"
    "cal.error.start,cal.error.end,n.10sec.windows,n.hours.considered,QCmessage,use.temperature"
)
HOLDOUT = HoldoutSection("", 0, 0, ErrorSummary(31.5, 0, 0), ErrorSummary(2.25, 0, 0), None, (0, 0))
TINY = 1.5e-7
"""As a Python number it is written with an exponent."""


def made(
    *, warm: bool = True, path: str = "/data/a b.cwa", parameters: tuple[int, ...] | None = None
) -> ExportedReport:
    """A report's calibration without misalignment, with slopes or without."""
    p = [1.02, 0.985, 1.013, 0, 0, 0, 0.0317, -0.0211, 0.0469, 0.004, -0.0026, -4 * TINY]
    fixed = parameters or tuple(round(value * ONE) for value in (p if warm else [*p[:9], 0, 0, 0]))
    found = Calibration("6T" if warm else "6", fixed, TemperatureScale(26848, 4.0) if warm else None)
    recording, errors = RecordingSection(path, "", 0, "geneactiv", duration_s=5400.0), Errors(HOLDOUT)
    return ExportedReport(Path("a.calibration.json"), recording, 1205.0, found, errors, found, errors)


def raw() -> tuple[np.ndarray, np.ndarray]:
    """Points [g] and temperatures [degrees C]."""
    random = np.random.RandomState(1)
    return random.uniform(-2, 2, (500, 3)), random.uniform(-5, 45, 500)


def expected(one: ExportedReport, v: np.ndarray, celsius: np.ndarray) -> np.ndarray:
    """Model 6T by the report's own numbers: a = K (v + o + s (T - Tref))."""
    found, ours = one.simple, v + one.simple.offset_g()
    if found.temperature is not None:
        ours = ours + np.outer(celsius - found.reference_c(), found.slope_g_per_c())
    return ours @ found.gain().T


def by_ggir(text: str, v: np.ndarray, celsius: np.ndarray) -> np.ndarray:
    """R/g.part1.R takes columns by name in the file's order, R/g.getmeta.R applies them.

    data = scale(data, center = -offset, scale = 1/scale), and if there is a temperature and meantempcal
    data = data + scale(yy, center = rep(meantempcal, 3), scale = 1/tempoffset).
    """
    head, row = csv.reader(io.StringIO(text))

    def three(name: str) -> np.ndarray:
        at = [place for place, one in enumerate(head) if one in {f"{name}.{axis}" for axis in "xyz"}]
        return np.array([float(row[place]) for place in at])

    with np.errstate(divide="ignore"):
        data = (v - -three("offset")) / (1 / three("scale"))
        mean_c = float(row[head.index("meantempcal")])
        return data + (celsius[:, None] - mean_c) / (1 / three("temperature.offset"))


def by_biobank(line: str, v: np.ndarray, celsius: np.ndarray) -> np.ndarray:
    """x = xyzIntercept[0] + x * xyzSlope[0] + temp * xyzSlopeT[0] (EpochWriter.java)."""
    parser = argparse.ArgumentParser()
    parser.add_argument("inputFile")
    parser.add_argument("--skipCalibration")
    for name in ("calOffset", "calSlope", "calTemp"):
        parser.add_argument(f"--{name}", type=float, nargs=3)
    program, *words = shlex.split(line)
    used = parser.parse_args(words)
    assert (program, used.inputFile, used.skipCalibration) == ("accProcess", "/data/a b.cwa", "True")
    return np.array(used.calOffset) + v * np.array(used.calSlope) + celsius[:, None] * np.array(used.calTemp)


def by_omconvert(line: str, v: np.ndarray, celsius: np.ndarray) -> np.ndarray:
    """v = (v + offset) * scale + (temp - referenceTemperature) * tempOffset (omconvert.c)."""
    program, name, *options = shlex.split(line)
    assert (program, name, *options[:3]) == (
        "omconvert", "/data/a b.cwa", "-calibrate", "0", "-calibration",
    )  # fmt: skip
    values = [float(token) for token in re.split("[ ,;]+", options[3])]
    assert len(values) == 10
    scale, offset, warmth = (np.array(values[start : start + 3]) for start in (0, 3, 6))
    return (v + offset) * scale + (celsius - values[9])[:, None] * warmth


@pytest.mark.parametrize("warm", [True, False])
def test_the_formula_of_each_tool_gives_what_model_6_or_6t_gives(warm: bool) -> None:
    one, (v, celsius) = made(warm=warm), raw()
    for found in (by_ggir(ggir([one]), v, celsius), by_biobank(biobank(one), v, celsius)):
        assert np.abs(found - expected(one, v, celsius)).max() < 1e-9
    word = np.rint((celsius + 20.5) / 0.15)  # omconvert reads .cwa files only, by this line for all hardware
    line = ThermometerWord(0.15, -20.5)
    one = replace(one, recording=replace(one.recording, format="cwa", thermometer=line))
    found = by_omconvert(omconvert(one), v, word * 0.15 - 20.5)
    assert np.abs(found - expected(one, v, word * 0.15 - 20.5)).max() < 1e-9


def test_a_good_sensor_is_handed_on_as_the_identity() -> None:
    one, (v, celsius) = made(warm=False, parameters=IDENTITY), raw()
    assert np.array_equal(by_ggir(ggir([one]), v, celsius), v)
    assert np.array_equal(by_biobank(biobank(one), v, celsius), v)
    assert np.array_equal(by_omconvert(omconvert(one), v, celsius), v)
    assert cost(one) is None


def test_columns_order_and_units_of_ggir() -> None:
    head, row = ggir([made()]).splitlines()
    assert head == COLUMNS
    cells = dict(zip(head.split(","), next(csv.reader([row])), strict=True))
    assert cells["filename"] == "a b.cwa"
    assert (cells["cal.error.start"], cells["cal.error.end"]) == ("0.0315", "0.00225")
    assert (cells["n.10sec.windows"], cells["n.hours.considered"]) == ("120", "1.5")
    assert (cells["meantempcal"], cells["use.temperature"]) == ("26.848", "TRUE")
    assert cells["QCmessage"] == f"coefficients of accelcal {__version__} (model 6T)"


def test_u11_windows_are_of_10_s_whatever_their_length_was(tmp_path: Path) -> None:
    path = donor(tmp_path)
    used = json.loads(path.read_text())["fit"]["windows"]["used"]
    for seconds in (5.0, 10.0, 1.0):
        edit(path, lambda report, s=seconds: report["settings"].update(segment_seconds=s))
        one = read_exported(path)
        row = dict(zip(*csv.reader(io.StringIO(ggir([one]))), strict=True))
        assert int(row["n.10sec.windows"]) == used * seconds // 10


def test_ggir_needs_a_number_for_the_temperature_also_without_slopes() -> None:
    head, row = csv.reader(io.StringIO(ggir([made(warm=False)])))
    cells = dict(zip(head, row, strict=True))
    assert (cells["meantempcal"], cells["use.temperature"]) == ("0.0", "FALSE")


def test_several_recordings_are_rows_and_the_same_name_twice_is_refused() -> None:
    text = ggir([made(), made(path="C:\\data\\b.cwa")])
    assert [row[0] for row in csv.reader(io.StringIO(text))] == ["filename", "a b.cwa", "b.cwa"]
    with pytest.raises(UsageError, match=r"recordings of the same name, a b\.cwa; GGIR knows them by name"):
        ggir([made(), made(path="/other/a b.cwa")])


@pytest.mark.parametrize("value", [0.0, -0.0, 1.5e-7, -1.5e-7, 1e-300, 0.1, 1 / 3, 123456789.125])
def test_numbers_are_whole_and_without_an_exponent(value: float) -> None:
    assert re.fullmatch(r"-?\d+(\.\d+)?", decimal(value))
    assert float(decimal(value)) == value and decimal(-0.0) == "0.0"


@pytest.mark.parametrize("path", ["-x.cwa", "a'b; rm -rf ~.cwa", "$(a).cwa", "a\nb.cwa"])
def test_a_hostile_name_stays_one_word_and_one_line(path: str) -> None:
    for line in (biobank(made(path=path)), omconvert(made(path=path))):
        word = shlex.split(line)[1]
        assert word == (f"./{path}" if path[0] == "-" else path.replace("\n", "\\n"))
        assert "\n" not in line


def test_a_report_hands_on_its_fit_without_misalignment_and_what_that_costs(tmp_path: Path) -> None:
    path = donor(tmp_path, warm=True)
    report = json.loads(path.read_text())
    section, found = report["without_misalignment"], read_exported(path)
    assert found.whole.model == "9T" and found.simple.model == section["calibration"]["model"] == "6T"
    assert found.axes("ggir").scale == tuple(np.diag(section["calibration"]["gain"]))
    assert found.axes("ggir").offset_g == tuple(section["calibration"]["offset_g"])
    six, nine = (one["holdout"]["after_mg"]["mean"] for one in (section, report))
    assert six > 5 * nine
    everywhere = [one["calibration_error_mg"]["mean"] for one in (section, report)]
    assert cost(found) == (
        "this form cannot hold misalignment and bend; exported model 6T (9T without misalignment): "
        "calibration error "
        f"{everywhere[0]:.2f} mg instead of {everywhere[1]:.2f} mg, "
        f"held-out error {six:.2f} mg instead of {nine:.2f} mg"
    )


def course(report: dict[str, Any]) -> None:
    knot = {"stretch": [1.0] * 3, "shift_g": [0.0] * 3}
    knot["fixed_point"] = {"stretch": [ONE] * 3, "shift": [0] * 3}
    report["calibration"]["course"] = {"between": "jumps", "knots": [{"sample": 0, **knot}]}


def kind(report: dict[str, Any]) -> None:
    report["recording"]["format"] = "points"


REFUSED = {
    "follows a sensor that changed while it recorded": course,
    "is of a table of points": kind,
    "has no fit without misalignment": lambda report: report.update(without_misalignment=None),
}


@pytest.mark.parametrize("text", REFUSED)
def test_what_cannot_be_handed_on_honestly_is_refused(tmp_path: Path, text: str) -> None:
    path = edit(donor(tmp_path), REFUSED[text])
    with pytest.raises(UsageError) as caught:
        read_exported(path)
    assert text in str(caught.value) and str(path) in str(caught.value)


def with_errors(part: str, before: float, after: float, high: float) -> Callable[[dict[str, Any]], None]:
    """Set the error over all orientations of the fit without misalignment, or that on held-out ones alone."""

    def change(report: dict[str, Any]) -> None:
        section = report["without_misalignment"]
        if part == "calibration_error_mg":
            section[part] |= {"before": before, "mean": after, "ci95": [after / 2, high]}
        else:
            section["calibration_error_mg"] = None
            section["holdout"]["before_mg"]["mean"], section["holdout"]["after_mg"]["mean"] = before, after

    return change


@pytest.mark.parametrize(("before", "after"), [(13.8, 17.2), (13.8, 13.81), (0.4, 0.9)])
@pytest.mark.parametrize("part", ["calibration_error_mg", "holdout"])
@pytest.mark.parametrize("form", ["ggir", "biobank", "omconvert"])
def test_d4_coefficients_worse_than_raw_are_skipped_and_said(
    form: str, part: str, before: float, after: float, tmp_path: Path
) -> None:
    path = edit(donor(tmp_path, warm=True), with_errors(part, before, after, 20.0))
    error = "calibration" if part == "calibration_error_mg" else "held-out"
    text = (
        f"model 6T is worse than the raw data: {error} error {mg(before)} mg before, {mg(after)} mg after; "
    )
    ran = run("export", path, "--to", form, "-q")
    assert (ran.code, ran.out) == (2, "") and f"accelcal: {path}: {text}" in ran.err
    edit(path, with_errors(part, after, before, 20.0))
    assert run("export", path, "--to", form, "-q").code == 0


@pytest.mark.parametrize(("high", "said"), [(9.99, False), (10.0, False), (22.0, True)])
def test_d4_what_may_be_over_the_limit_is_said(high: float, said: bool, tmp_path: Path) -> None:
    path = edit(donor(tmp_path, warm=True), with_errors("calibration_error_mg", 30.0, 8.0, high))
    text = "its calibration error may be over the limit of 10 mg: 8 mg (95 % interval 4 to "
    text += f"{high:g} mg)"
    ran = run("export", path, "--to", "ggir", "-q")
    assert ran.code == 0 and (f"{path}: {text}" in ran.err) == said == bool(ran.err)
