"""Coefficients for tools that know scales, offsets and slopes, but no misalignment.

Each form is one small function with the tool's formula and its source. A calibration with misalignment is
never cut down: instead, the fit of the same points without misalignment is exported (judge/verdict.py).
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.declared import from_json
from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.core.identity import identity
from accelcal_cli.core.recording import ThermometerWord
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.core.version import __version__
from accelcal_cli.output.coefficients import (
    FULL_GAIN,
    coefficients_json,
    read_coefficients,
    without_misalignment,
)
from accelcal_cli.output.files import csv_text
from accelcal_cli.output.numbers import mg
from accelcal_cli.output.report_reading import check_sections, file_place
from accelcal_cli.output.sections import Errors, FitSection, RecordingSection

# The degrees in which other tools read a recording's thermometer, which are not always ours.
#
# A .cwa file holds a raw word, of which three lines are in use: ours, by the hardware
# (formats/cwa/sector.py), that of GGIR, raw * 75 / 256 - 50 for all (GGIRread 1.0.9,
# R/readAxivity.R), and that of biobank's accProcess and of omconvert, (raw * 150 - 20500) / 1000 for
# all (AxivityReader.java, omconvert.c). Between any two of them lies a line, so that a slope can be
# exported exactly.
#
# Where a tool reads the degrees that the file states, they are ours. A tool reads no temperature from
# files of other formats, or that of another thermometer: GGIR takes the air's of a Matrix, accelcal
# the skin's.

AXIVITY = "cwa"
WORDS = {
    "ggir": ThermometerWord(75 / 256, -50.0),
    "biobank": ThermometerWord(0.15, -20.5),
    "omconvert": ThermometerWord(0.15, -20.5),
}
"""Line by which each tool reads the temperature of a .cwa file."""

STATED = {"ggir": ("geneactiv", "csv", "unisens"), "biobank": ("geneactiv",), "omconvert": ()}
"""Formats of which each tool takes over the degrees that the file states; GGIR of a CSV file if asked to."""

NAMES = {"ggir": "GGIR", "biobank": "accProcess", "omconvert": "omconvert"}
WARMEST_AT_START_C = 50.0
"""GGIR uses no temperature of a recording if the mean of the first ten is higher (R/g.getmeta.R)."""


@dataclass(frozen=True, slots=True)
class Degrees:
    """A tool's degrees: per_degree * ours + zero."""

    per_degree: float = 1.0
    zero: float = 0.0


def degrees_of(tool: str, recording: RecordingSection) -> Degrees | None:
    """Return the degrees in which a tool reads a recording; None if it reads none, or unknown ones."""
    if recording.format in STATED[tool]:
        return Degrees()
    if recording.format != AXIVITY or recording.thermometer is None:
        return None
    ours, theirs = recording.thermometer, WORDS[tool]
    ratio = theirs.celsius_per_count / ours.celsius_per_count
    return Degrees(ratio, theirs.celsius_at_zero - ratio * ours.celsius_at_zero)


def why_none(tool: str, recording: RecordingSection) -> str:
    """Return why a recording's temperature cannot be exported to a tool."""
    if recording.format == AXIVITY:
        return "the report does not say how it was read: calibrate the recording again with --force"
    return f"{NAMES[tool]} reads no temperature from {recording.format} files, or that of another thermometer"


# Coefficients for tools that know scales, offsets and slopes, but no misalignment.

ALIGNED = ("0", "3", "6", "3T", "6T")
"""Models without misalignment, which are exported as they are."""

NO_RECORDING = {"pool": "a pool of recordings", "points": "a table of points"}
"""Kinds of report, by `recording.format`, that are of no recording, so that other tools have no file."""

GGIR_COLUMNS = (
    "filename", "scale.x", "scale.y", "scale.z", "offset.x", "offset.y", "offset.z",
    "temperature.offset.x", "temperature.offset.y", "temperature.offset.z", "meantempcal",
    "cal.error.start", "cal.error.end", "n.10sec.windows", "n.hours.considered", "QCmessage",
    "use.temperature",
)  # fmt: skip
GGIR_WINDOW_S = 10
NEAR_C = 10.0
"""How far from GGIR's limit of temperatures a mean of them is safe [degrees C]."""
Three = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class AxisCoefficients:
    """a = scale (v + offset + slope (T - reference)), axis by axis; x, y, z of each.

    Attributes:
        offset_g: in standard g.
        slope_g_per_c: temperature slopes of the offsets; zeros without temperature.
    """

    scale: Three
    offset_g: Three
    slope_g_per_c: Three
    reference_c: float

    def warmth(self) -> Three:
        """Return the change of a [g] per degree: scale times slope."""
        x, y, z = (k * s for k, s in zip(self.scale, self.slope_g_per_c, strict=True))
        return x, y, z

    def read_in(self, degrees: Degrees | None) -> AxisCoefficients:
        """Return them for temperatures in other degrees; None: for a tool that has no temperatures."""
        if degrees is None:
            return replace(self, slope_g_per_c=(0.0, 0.0, 0.0), reference_c=0.0)
        x, y, z = (slope / degrees.per_degree for slope in self.slope_g_per_c)
        zero = degrees.per_degree * self.reference_c + degrees.zero
        return replace(self, slope_g_per_c=(x, y, z), reference_c=zero)


@dataclass(frozen=True, slots=True)
class ExportedReport:
    """The part of a report that other tools can use.

    Attributes:
        path: path of the report.
        windows_s: total length of the windows that were used [s].
        whole: its calibration; errors: the errors of that.
        simple: the calibration without misalignment; simple_errors: the errors of that.
        place: where the recording was, None where the report does not say it.
        limit_mg: bound on the calibration error that the recording was judged by.
    """

    path: Path
    recording: RecordingSection
    windows_s: float
    whole: Calibration
    errors: Errors
    simple: Calibration
    simple_errors: Errors
    place: str | None = None
    limit_mg: float = DEFAULT.max_error_mg

    @property
    def file_name(self) -> str:
        """Name of the recording with its suffix."""
        kind = PurePosixPath if "/" in self.recording.path else PureWindowsPath
        return kind(self.recording.path).name

    def axes(self, tool: str) -> AxisCoefficients:
        """Return the simple calibration, axis by axis, in the degrees in which a tool reads the recording."""
        found, gain = self.simple, self.simple.gain()
        columns = ([gain[axis, axis] for axis in range(3)], found.offset_g(), found.slope_g_per_c())
        scale, offset, slope = ((float(x), float(y), float(z)) for x, y, z in columns)
        ours = AxisCoefficients(scale, offset, slope, found.reference_c())
        return ours if found.temperature is None else ours.read_in(degrees_of(tool, self.recording))

    def uses_temperature(self, tool: str) -> bool:
        """Return True if the simple calibration follows a temperature that the tool reads."""
        return self.simple.temperature is not None and degrees_of(tool, self.recording) is not None


def read_exported(path: Path) -> ExportedReport:
    """Read from a report what tools without misalignment can use.

    Raises:
        UnreadableError: it is not a report, is damaged, or its recording was refused.
        UsageError: it has nothing that such a tool can use, or nothing that is better than the raw data.
    """
    found = read_coefficients(path)
    document, whole = found.document, found.calibration
    check_sections(document, ("recording", "settings", "fit", "holdout", "calibration_error_mg"))
    report, recording = document.report, document.recording
    if recording.format in NO_RECORDING:
        text = f"is of {NO_RECORDING[recording.format]}, of which no other tool has a file"
        raise UsageError(text, path=path, hint="name reports of recordings, or use --to json")
    if recording.factory_calibration is not None and recording.factory_calibration.acceleration is not None:
        text = (
            "is of counts of a bare sensor, to which other tools do not apply the maker's calibration first"
        )
        raise UsageError(text, path=path, hint="export the calibrated data (--to csv), or use --to json")
    if whole.correction is not None:
        raise UsageError(
            "follows a sensor that changed while it recorded, which no other tool can",
            path=path,
            hint="export the calibrated data (--to csv), or calibrate with --recalibrate never",
        )
    windows_s = from_json(FitSection, report["fit"]).windows.used * report["settings"]["segment_seconds"]
    errors, place = from_json(Errors, report), file_place(report, "recording")
    limit = float(report["settings"].get("max_error_mg") or DEFAULT.max_error_mg)
    aligned = whole.model in ALIGNED
    simple = whole if aligned else without_misalignment(found)
    if simple is None:
        orientations = "was calibrated on known orientations, and " if whole.model == FULL_GAIN else ""
        text = f"{orientations}has no fit without misalignment"
        raise UsageError(text, path=path, hint="export the calibrated data (--to csv), or use --to json")
    simple_errors = errors if aligned else from_json(Errors, report["without_misalignment"])
    one = ExportedReport(path, recording, windows_s, whole, errors, simple, simple_errors, place, limit)
    _refuse_worse(one)
    return one


def _refuse_worse(one: ExportedReport) -> None:
    """Raise UsageError if what is exported is worse than the raw data."""
    everywhere, held_out = one.simple_errors.calibration_error_mg, one.simple_errors.holdout
    pair = None if held_out is None else (held_out.before_mg.mean, held_out.after_mg.mean)
    before, after = pair or (0.0, 0.0) if everywhere is None else (everywhere.before, everywhere.mean)
    if after <= before:
        return
    error = "held-out" if everywhere is None else "calibration"
    text = f"model {one.simple.model} is worse than the raw data: {error} error {mg(before)} mg before, "
    hint = "export the calibrated data (-d DIR), which keep the misalignment, or use --to json"
    raise UsageError(f"{text}{mg(after)} mg after", path=one.path, hint=hint)


def over_limit(one: ExportedReport) -> str | None:
    """Return in a sentence that what is exported may be over the limit; None if it is not."""
    error = one.simple_errors.calibration_error_mg
    if error is None or error.ci95[1] <= one.limit_mg:
        return None
    interval = f"{mg(error.mean)} mg (95 % interval {mg(error.ci95[0])} to {mg(error.ci95[1])} mg)"
    return f"its calibration error may be over the limit of {mg(one.limit_mg)} mg: {interval}"


def ggir(reports: Sequence[ExportedReport]) -> str:
    """Return the CSV file for GGIR's `backup.cal.coef`, a row for each recording.

    a = (v + offset) scale + (T - meantempcal) temperature.offset (GGIR 3.3-7, R/g.getmeta.R), T in the
    degrees that GGIR reads. x, y, z are taken by the order of the columns, and `meantempcal` has to be a
    number: without the column the term with T is left out in silence, and an empty cell makes all values NA
    (R/g.part1.R). Errors are those of held-out postures in g; stillness is counted in windows of 10 s.

    Raises:
        UsageError: two recordings have the same name, by which GGIR would give both the first one's row.
    """
    by_name: dict[str, ExportedReport] = {}
    for one in reports:
        if one.file_name in by_name:
            text = f"and {by_name[one.file_name].path} are of recordings of the same name, {one.file_name}"
            raise UsageError(text, path=one.path, hint="GGIR knows them by name: export them separately")
        by_name[one.file_name] = one
    return csv_text(GGIR_COLUMNS, map(_ggir_row, reports))


def _ggir_row(one: ExportedReport) -> list[object]:
    axes, holdout, seconds = one.axes("ggir"), one.simple_errors.holdout, one.recording.duration_s
    means_mg = (None, None) if holdout is None else (holdout.before_mg.mean, holdout.after_mg.mean)
    errors = [None if mean_mg is None else mean_mg / 1000 for mean_mg in means_mg]
    hours = None if seconds is None else round(seconds / 3600, 2)
    temperature = "TRUE" if one.uses_temperature("ggir") else "FALSE"
    message = f"coefficients of accelcal {__version__} (model {one.simple.model})"
    return [
        one.file_name, *axes.scale, *axes.offset_g, *axes.warmth(), axes.reference_c, *errors,
        int(one.windows_s // GGIR_WINDOW_S), hours, message, temperature,
    ]  # fmt: skip


def biobank(one: ExportedReport) -> str:
    """Return the command line of biobankAccelerometerAnalysis.

    a = calOffset + calSlope v + calTemp T (version 7, EpochWriter.java), T in the degrees that it reads,
    without a reference temperature. `--meanTemp` is not given: it sets all coefficients back. Its parser
    takes a negative number with an exponent for an option, so that all numbers are written without.
    """
    axes = one.axes("biobank")
    parts = zip(axes.scale, axes.offset_g, axes.slope_g_per_c, strict=True)
    values = {
        "calOffset": [k * (offset - slope * axes.reference_c) for k, offset, slope in parts],
        "calSlope": axes.scale,
        "calTemp": axes.warmth(),
    }
    words = [f"--{name} {' '.join(map(decimal, three))}" for name, three in values.items()]
    return f"accProcess {_file(one)} --skipCalibration True {' '.join(words)}"


def omconvert(one: ExportedReport) -> str:
    """Return the command line of omconvert.

    a = (v + offset) scale + (T - Tref) temperature offset (omcalibrate.c); the ten numbers are scales,
    offsets, temperature offsets and Tref (main.c). `-calibrate 0` makes it use them.
    """
    axes = one.axes("omconvert")
    numbers = (*axes.scale, *axes.offset_g, *axes.warmth(), axes.reference_c)
    return f'omconvert {_file(one)} -calibrate 0 -calibration "{",".join(map(decimal, numbers))}"'


def as_json(path: Path) -> str:
    """Return a report's calibration as JSON, with misalignment and, if it was fitted, without.

    Raises:
        UnreadableError: it is not a report, is damaged, or its recording was refused.
    """
    found = read_coefficients(path)
    without_misalignment(found)  # refuses what is damaged
    report = found.document.report
    check_sections(found.document, ("holdout", "calibration_error_mg"))
    names = ("path", "sha256", "device", "factory_calibration")
    recording = {name: report["recording"][name] for name in names if name in report["recording"]}
    shown = {
        **identity("coefficients"),
        "report": {"path": printable(path), "sha256": found.document.sha256},
        "recording": recording,
        "outcome": report["outcome"],
        "calibration": coefficients_json(found.calibration),
        "calibration_error_mg": report.get("calibration_error_mg"),
        "holdout": report.get("holdout"),
        "without_misalignment": report.get("without_misalignment"),
    }
    return json.dumps(shown, allow_nan=False, ensure_ascii=False)


def decimal(value: float) -> str:
    """Return a number in full, without an exponent; reading it gives the same bits."""
    return format(Decimal(repr(value + 0.0)), "f")


def _file(one: ExportedReport) -> str:
    """Return the recording as one word of a shell's command line, and no option."""
    path = printable(one.place or one.recording.path)
    return shlex.quote(f"./{path}" if path.startswith("-") else path)


def cost(one: ExportedReport) -> str | None:
    """Return the cost of leaving out the misalignment in a sentence; None if there is none to leave out."""
    if one.simple == one.whole:
        return None
    with_it, without, parts = one.errors, one.simple_errors, []
    if with_it.holdout is not None and without.holdout is not None:
        means_mg = without.holdout.after_mg.mean, with_it.holdout.after_mg.mean
        parts.append("held-out error {:.2f} mg instead of {:.2f} mg".format(*means_mg))
    if with_it.calibration_error_mg is not None and without.calibration_error_mg is not None:
        means_mg = without.calibration_error_mg.mean, with_it.calibration_error_mg.mean
        parts.insert(0, "calibration error {:.2f} mg instead of {:.2f} mg".format(*means_mg))
    price = ", ".join(parts) or "the loss of accuracy is unknown, because there is too little stillness"
    models = f"{one.simple.model} ({one.whole.model} without misalignment)"
    what = "misalignment and bend" if any(one.whole.bend) else "misalignment"
    return f"this form cannot hold {what}; exported model {models}: {price}"


def temperature_note(one: ExportedReport, tool: str) -> str | None:
    """Return what the tool does not do with the temperature, in a sentence; None if it does all of it."""
    if one.simple.temperature is None:
        return None
    if not one.uses_temperature(tool):
        return f"temperature is left out: {why_none(tool, one.recording)}"
    reference = one.axes(tool).reference_c
    if tool == "ggir" and reference > WARMEST_AT_START_C - NEAR_C:
        return (
            f"{NAMES[tool]} reads temperatures around {reference:.1f} from this device, and uses none if the "
            f"first ones are above {WARMEST_AT_START_C:g}: export the calibrated data (--to ggir -d DIR)"
        )
    return None


def read_for(form: str) -> Callable[[Path], Any]:
    """Return what reads a report for a form; TABLES makes text of what it returns."""
    return as_json if form == "json" else read_exported


TABLES: dict[str, Callable[[Sequence[Any]], str]] = {
    "ggir": ggir,
    "biobank": lambda reports: "".join(f"{biobank(one)}\n" for one in reports),
    "omconvert": lambda reports: "".join(f"{omconvert(one)}\n" for one in reports),
    "json": lambda lines: "".join(f"{line}\n" for line in lines),
}
"""Text of each form for any number of reports."""
