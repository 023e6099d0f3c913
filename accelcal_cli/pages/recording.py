"""The page of one recording, made of its report and its `NAME.quality.json` alone.

The same two files make the same bytes. Each part of the page is a function here that makes its tables; the
figures are in `figures.py`, the sentences in `output/sentences.py`, the order in `templates/recording.html`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Any

from accelcal_cli.core.errors import Reason, counted
from accelcal_cli.output.advice import page_verdict
from accelcal_cli.output.methods import bibtex, methods_paragraph, references
from accelcal_cli.output.numbers import millionths, number
from accelcal_cli.output.sections import (
    CalibrationSection,
    GyroscopeSection,
    Level,
    PoseSection,
    ReportView,
    Roll,
    report_view,
)
from accelcal_cli.output.sentences import PARAMETERS, clause, corrections_of, sentence
from accelcal_cli.pages.figures import NEAR, UnfitError, figures_of, hourly_table, time_series
from accelcal_cli.pages.rendering import PageTable, Rows, rendered, rendered_fragment

AGAIN = "figures that need it are missing. Calibrate again with --force to have them."
NO_FILE = f"There is no NAME.quality.json next to the report: {AGAIN}"
MOST_PROBLEMS = 20
MOST_POSES = 200
LONGEST_TEXT = 2000
"""Characters that are shown of a text of any length, such as a command that names thousands of recordings."""

WINDOWS = {
    "complete": "windows in all",
    "used": "used",
    "moving": "moving",
    "filled": "filled by the device",
    "clipped": "at the sensor's range",
    "recovered": "from damaged blocks",
    "joined": "joined to the one before",
    "repeated": "repeats of earlier ones",
    "implausible": "not near 1 g",
    "constant_left_out": "left out: never changed",
    "temperature_left_out": "left out: impossible temperature",
    "saturated_left_out": "left out: near where an axis saturates",
}
"""WindowUses of windows, by their keys in the report."""

ACTIVITY = {
    "enmo_mg": "ENMO [mg]",
    "mad_mg": "MAD [mg]",
    "mvpa_min": "MVPA [min]",
    "pim_mg_s": "PIM [mg s per minute]",
    "zcm": "ZCM [per minute]",
    "angle_deg": "Mean angle of the arm [degrees]",
}
"""Measures of activity that have an interval, by their keys in the report."""


def page(report: Mapping[str, Any], quality: Mapping[str, Any] | None = None) -> str:
    """Return the page as HTML.

    Args:
        report: valid by the schema of the version that wrote it.
        quality: content of NAME.quality.json; None where it is missing.
    """
    view = report_view(report)
    data, note = None, NO_FILE
    if quality is not None:
        try:
            data, note = time_series(quality, view), ""
        except UnfitError as error:
            note = f"NAME.quality.json {error}: {AGAIN}"
    return rendered(
        "recording.html",
        name=view.recording.path.rpartition("/")[2] or "(no name)",
        verdict=page_verdict(view),
        note=note,
        facts=_facts(view),
        figures=figures_of(data, view),
        subsets=_subsets(view),
        hours=None if data is None else PageTable(*hourly_table(data)),
        still=view.fit.windows.used > 0,
        coefficients=None if view.calibration is None else _coefficients(view.calibration),
        models=_models(view),
        misfits=_misfits(view),
        activity=_activity(view),
        known=_known_orientations(view),
        gyroscope=None if view.gyroscope is None else _gyroscope(view.gyroscope),
        health=_health(view),
        windows=_windows(view),
        problems=_problems(view),
        notes=view.recording.notes,
        methods=methods_paragraph(view),
        references=references(view),
        bibtex=bibtex(view),
        origin=_origin(view),
    )


def fragment(report: Mapping[str, Any], quality: Mapping[str, Any] | None) -> str:
    """Return the verdict, its number and the first figure as HTML, for a place in another page.

    Args:
        report, quality: as in `page`.
    """
    view, figures = report_view(report), []
    with contextlib.suppress(UnfitError):
        figures = [] if quality is None else figures_of(time_series(quality, view), view)["change"][:1]
    return rendered_fragment(
        name=view.recording.path.rpartition("/")[2] or "(no name)",
        verdict=page_verdict(view),
        figures=figures,
    )


def _facts(report: ReportView) -> list[tuple[str, str]]:
    """Return what was recorded, by what."""
    recording = report.recording
    device, rate, start = recording.device, recording.sample_rate_hz, recording.start_time
    zone = recording.timezone or recording.time_zone or "unknown"
    facts = [
        ("Recording", recording.path),
        ("Device", " ".join(filter(None, (device.model, device.serial))) or "not stated"),
        ("Firmware", device.firmware),
        ("Format", recording.format),
        ("Start", start and f"{start.partition('.')[0].replace('T', ' ')} (time zone: {zone})"),
        ("Length", None if recording.duration_s is None else _duration(recording.duration_s)),
        ("Samples", f"{recording.samples} at {number(rate)} Hz" if rate else str(recording.samples)),
        ("SHA-256", recording.sha256),
    ]
    return [(name, value) for name, value in facts if value]


def _begun(text: str) -> str:
    """Return a text, or how it begins if it is longer than any line."""
    if len(text) <= LONGEST_TEXT:
        return text
    return f"{text[:LONGEST_TEXT]} ... ({len(text) - LONGEST_TEXT} more characters are in the report)"


def _duration(seconds: float) -> str:
    """Write a length of time in the two largest units."""
    days, hours, minutes = seconds / 86_400, seconds / 3600, seconds / 60
    if days >= 2:
        return f"{int(days)} days {round(24 * (days % 1))} hours"
    if hours >= 1:
        return f"{int(hours)} hours {int(minutes % 60)} minutes"
    return f"{int(minutes)} minutes {int(seconds % 60)} seconds"


def _subsets(report: ReportView) -> PageTable:
    rows = [
        [near, *(str(count) if count else "empty" for count in counts)]
        for near, counts in zip(NEAR, report.coverage.subsets, strict=True)
    ]
    caption = "Number of points near -1, 0 and +1 g on each axis (Faragó et al. 2024)"
    return PageTable(caption, ["", "x", "y", "z"], rows)


def _coefficients(calibration: CalibrationSection) -> PageTable:
    errors = calibration.standard_errors or {}
    values = dict(calibration.parameters)
    if calibration.temperature is not None:
        slopes = calibration.temperature.slope_g_per_c
        values |= {f"s{axis}": slope for axis, slope in zip("xyz", slopes, strict=True)}
    if calibration.bend is not None:
        values |= {f"q{axis}": q for axis, q in zip("xyz", calibration.bend.quadratic, strict=True)}
    rows = [
        [name, PARAMETERS.get(name, ""), millionths(value), millionths(errors.get(name))]
        for name, value in values.items()
    ]
    head = ["Name", "Meaning", "Value", "Standard error"]
    return PageTable(f"Coefficients of model {calibration.model}", head, rows, (0, 1))


def _activity(report: ReportView) -> PageTable | None:
    """Return measures of activity, raw and calibrated, if they were asked for."""
    effect = report.effect
    if effect is None:
        return None
    intervals, biases = effect.ci95 or {}, effect.raw_bias or {}
    raw, calibrated = effect.versions["raw"], effect.versions["calibrated"]
    rows: Rows = []
    for name, text in ACTIVITY.items():
        interval, bias = intervals.get(name), biases.get(name)
        between = "–" if interval is None else " to ".join(map(number, interval))
        off = "–" if bias is None else number(bias.value)
        rows.append([text, number(getattr(raw, name)), number(getattr(calibrated, name)), between, off])
    head = ["Measure", "Raw", "Calibrated", "95 % interval", "Raw is off by"]
    return PageTable("Measures of activity, and how uncertain the calibration leaves them", head, rows)


def _models(report: ReportView) -> PageTable | None:
    """Return the models tried, and why each was not taken."""
    rows: Rows = []
    model = None if report.calibration is None else report.calibration.model
    chosen = max((at for at, trial in enumerate(report.models_tried) if trial.model == model), default=None)
    for at, trial in enumerate(report.models_tried):
        prior = f"with the {trial.prior} prior" if trial.prior else ""
        chosen_with = f"chosen ({prior})" if prior else "chosen"
        reason = clause(Reason(trial.reason, trial.values)) if trial.reason else ""
        why = "; ".join(filter(None, (chosen_with if at == chosen else prior, reason)))
        rows.append([trial.model, corrections_of(trial.model), number(trial.after_mg), why])
    head = ["Model", "Corrects", "Held-out error [mg]", "Remark"]
    caption = "Models compared, by error on held-out orientations"
    return PageTable(caption, head, rows, (0, 1, 3)) if rows else None


def _misfits(report: ReportView) -> PageTable | None:
    rows = [
        [
            one.kind.replace("posture", "orientation"),
            "found" if one.found else "not found",
            f"{', '.join(number(size, 2) for size in one.size)} {one.unit}",
            number(one.before_mg),
            number(one.after_mg),
        ]
        for one in report.misfits or ()
    ]
    head = ["Looked for", "", "Size on x, y, z", "Held-out error without [mg]", "with [mg]"]
    caption = "Checks for sensor errors that the model does not cover"
    return PageTable(caption, head, rows, (0, 1, 2)) if rows else None


def _health(report: ReportView) -> PageTable:
    """Return the state of the file."""
    health, gaps = report.file_health, str(report.recording.all_gaps)
    filled, samples = health.filled_samples, report.recording.samples
    lost, rate, clock = health.lost_percent, health.rate_hz_measured, health.clock
    gap_s, drift = (None, None) if clock is None else (clock.gap_seconds, clock.drift_s_per_day)
    facts = [
        ("Problems found", str(len(health.problems))),
        (
            "Lost to damage or missing",
            None if lost is None else f"{number(lost)} % ({counted(health.lost_bytes or 0, 'byte')})",
        ),
        ("Gaps", f"{gaps}, {number(gap_s)} s in all" if gap_s else gaps),
        (
            "Filled samples",
            f"{filled} ({number(100 * filled / samples)} %)" if filled and samples else str(filled),
        ),
        ("Samples at the sensor's range", str(health.clipped_samples_before)),
        ("Measured rate", None if rate is None else f"{number(rate, 6)} Hz"),
        ("Drift of the clock", None if drift is None else f"{number(drift)} s per day"),
    ]
    return PageTable("The file", ["", ""], [[name, value] for name, value in facts if value is not None])


def _windows(report: ReportView) -> PageTable:
    counts = {text: getattr(report.fit.windows, name) for name, text in WINDOWS.items()}
    rows = [[text, str(count)] for text, count in counts.items() if count]
    return PageTable("Windows", ["", "Number"], rows)


def _problems(report: ReportView) -> PageTable | None:
    """Return the damage that was found, the first of it."""
    problems = report.file_health.problems
    rows = [
        [
            one.code,
            _begun(one.message),
            "–" if one.byte_offset is None else str(one.byte_offset),
            str(one.count),
        ]
        for one in problems[:MOST_PROBLEMS]
    ]
    caption = f"Problems{_more(len(problems), MOST_PROBLEMS)}"
    return PageTable(caption, ["Code", "Problem", "Byte", "Number"], rows, (0, 1)) if rows else None


def _more(number_of: int, shown: int) -> str:
    return f"; {number_of - shown} more are in the report" if number_of > shown else ""


def _origin(report: ReportView) -> list[tuple[str, str]]:
    """Return who made the report, when and with what."""
    made = report.provenance
    facts = [
        ("accelcal", report.accelcal_version),
        ("Command", _begun(" ".join(made.command))),
        ("Time", made.time),
        ("Computer", " ".join(filter(None, (made.host, made.platform)))),
        ("Versions", ", ".join(f"{name} {version}" for name, version in made.versions.items())),
    ]
    return [(name, value) for name, value in facts if value]


def _known_orientations(report: ReportView) -> dict[str, Any] | None:
    """Return `poses` and `rolls` (None without any), and `caution`, a sentence that nothing was held out.

    `caution` is empty where something was held out. Returns None for a report without known orientations.
    """
    if report.known_orientations is None or report.poses is None:
        return None
    rolls: Rows = [
        [roll.axis, _where(roll), _level(roll.level_mg.before), _level(roll.level_mg.after)]
        for roll in report.known_orientations.rolls or ()
    ]
    head = ["Axis", "Where", "Shows [mg] (SD)", "Calibrated [mg] (SD)"]
    caption = "Rolls about a level axis, on which gravity should be 0"
    return {
        "caution": " ".join(sentence(one) for one in report.cautions if one.code.endswith("checks_poses")),
        "poses": _poses(report.poses),
        "rolls": PageTable(caption, head, rolls, (0, 1)) if rolls else None,
    }


def _poses(poses: tuple[PoseSection, ...]) -> PageTable:
    rows: Rows = [
        [
            str(one.face),
            _where(one),
            ", ".join(map(number, one.reference_g)),
            *map(number, (one.raw_mg, one.residual_mg, one.held_out_mg, one.repeat_mg)),
        ]
        for one in poses[:MOST_POSES]
    ]
    head = ["Pose", "Where", "True acceleration [g]", "Raw error [mg]", "Residual of the fit [mg]",
            "Held-out error [mg]", "From the mean of its orientation [mg]"]  # fmt: skip
    caption = f"Poses, and the errors of their vectors{_more(len(poses), MOST_POSES)}"
    return PageTable(caption, head, rows, (0, 1, 2))


def _where(one: PoseSection | Roll) -> str:
    times = f"{one.start_s:.0f} to {one.end_s:.0f} s"
    return times if one.file is None else f"{one.file}, {times}"


def _level(level: Level | None) -> str:
    return "–" if level is None else f"{number(level.mean)} ({number(level.sd)})"


def _gyroscope(gyroscope: GyroscopeSection) -> dict[str, Any]:
    """Return the `verdict` and its `reason`, sentences, and two tables, each of which may be None.

    `coefficients` is None if it was refused, `errors` if it was neither turned nor at rest.
    """
    verdict = "Calibrated: angular rates in the calibrated recording are corrected."
    if gyroscope.outcome == "refused":
        verdict = "Not calibrated: angular rates in the calibrated recording are as measured."
    tables = {"coefficients": _gyroscope_coefficients(gyroscope), "errors": _gyroscope_errors(gyroscope)}
    return {"verdict": verdict, "reason": gyroscope.message, **tables}


def _gyroscope_coefficients(gyroscope: GyroscopeSection) -> PageTable | None:
    errors, bias = gyroscope.standard_errors, gyroscope.bias_dps
    if gyroscope.scale is None or bias is None:
        return None
    unknown = ((None,) * 3,) * 3
    rows: Rows = [
        [f"s_{row}{column}", _gain_name(row, column), millionths(value), millionths(error)]
        for row, values, of_row in zip("xyz", gyroscope.scale, errors.scale or unknown, strict=True)
        for column, value, error in zip("xyz", values, of_row, strict=True)
    ]
    for axis, value, error in zip("xyz", bias, errors.bias_dps or (None,) * 3, strict=True):
        rows.append([f"b{axis}", f"bias of {axis} [deg/s]", millionths(value), millionths(error)])
    if gyroscope.temperature is not None:
        for axis, value in zip("xyz", gyroscope.temperature.slope_dps_per_c, strict=True):
            rows.append([f"c{axis}", f"change of the bias of {axis} [deg/s per °C]", millionths(value), "–"])
    head = ["Name", "Meaning", "Value", "Standard error"]
    return PageTable(f"Coefficients of {gyroscope.equation}", head, rows, (0, 1))


def _gain_name(row: str, column: str) -> str:
    return f"scale of {row}" if row == column else f"{column} in {row}"


def _gyroscope_errors(gyroscope: GyroscopeSection) -> PageTable | None:
    holdout, rest = gyroscope.holdout_deg, gyroscope.rest
    rows: Rows = []
    if holdout is not None:
        raw = f"Gravity after a turn, raw, median of {counted(gyroscope.pairs, 'turn')}"
        rows.append([raw, f"{number(holdout.before)} degrees off"])
        between = " to ".join(map(number, holdout.ci95))
        after = f"{number(holdout.after)} degrees off (95 % interval {between})"
        rows.append(["The same on turns that took no part, calibrated", after])
    if rest is not None:
        rows.append(["At rest, raw", f"{number(rest.raw_dps)} deg/s"])
        for rate, text in ((rest.constant_dps, "less a bias"), (rest.slope_dps, "less a bias with a slope")):
            if rate is not None:
                rows.append([f"At rest, {text}, on time that took no part", f"{number(rate)} deg/s"])
    return PageTable("Errors of the gyroscope", ["", ""], rows, (0, 1)) if rows else None
