"""The page of one recording, made of its report and its `STEM.quality.json` alone.

The same two files make the same bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from accelcal_cli.core.errors import counted
from accelcal_cli.output import advice
from accelcal_cli.pages import figures, words
from accelcal_cli.pages.figures import NEAR, Figure
from accelcal_cli.pages.gyroscope import gyroscope_of
from accelcal_cli.pages.hours import hours
from accelcal_cli.pages.rendering import Rows, Table, decimals, rendered
from accelcal_cli.pages.svg import number
from accelcal_cli.pages.time_series import Along, UnfitError, along
from accelcal_cli.pages.words import Report

AGAIN = "figures that need it are missing. Calibrate again with --force to have them."
NO_FILE = f"There is no STEM.quality.json beside the report: {AGAIN}"
MOST_PROBLEMS = 20
LONGEST_TEXT = 2000
"""Of what may be of any length, such as a command that names thousands of recordings."""

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
    "temperature_left_out": "left out: temperature that cannot be",
    "saturated_left_out": "left out: near where an axis saturates",
}


def page(report: Report, quality: Mapping[str, Any] | None = None) -> str:
    """The page as HTML.

    Args:
        report: of this version's schema, or an older one's.
        quality: what STEM.quality.json holds; None where it is missing.
    """
    data, note = None, NO_FILE
    if quality is not None:
        try:
            data, note = along(quality, report), ""
        except UnfitError as error:
            note = f"STEM.quality.json {error}: {AGAIN}"
    recording = report["recording"]
    return rendered(
        "recording.html",
        name=recording["path"].rpartition("/")[2] or "(no name)",
        verdict=words.verdict(report),
        note=note,
        facts=_facts(report),
        figures=_drawn(report, data),
        subsets=_subsets(report),
        hours=None if data is None else Table(*hours(data)),
        coefficients=_coefficients(report),
        models=_models(report),
        misfits=_misfits(report),
        known=poses_of(report),
        gyroscope=gyroscope_of(report),
        health=_health(report),
        windows=_windows(report),
        problems=_problems(report),
        notes=recording["notes"],
        methods=words.methods(report),
        origin=_origin(report),
    )


def _drawn(report: Report, data: Along | None) -> dict[str, Figure | None]:
    """The figures by name; None for those that there is nothing to draw of."""
    names = ("length", "histogram", "sphere", "error", "timeline", "temperature", "convergence")
    if data is None:
        return dict.fromkeys(names)
    found = (
        figures.length_along_time(data),
        figures.histogram(data),
        figures.sphere(data, report),
        figures.error_by_hour(data, report.get("change")),
        figures.timeline(data, report["recording"]),
        figures.residual_by_temperature(data),
        figures.convergence(data),
    )
    return dict(zip(names, found, strict=True))


def _facts(report: Report) -> list[tuple[str, str]]:
    """What was recorded, by what."""
    recording = report["recording"]
    device, rate = recording["device"], recording["sample_rate_hz"]
    start = recording["start_time"]
    zone = recording["timezone"] or recording.get("time_zone") or "unknown"
    facts = [
        ("Recording", recording["path"]),
        ("Device", " ".join(filter(None, (device["model"], device["serial"]))) or "not stated"),
        ("Firmware", device["firmware"]),
        ("Format", recording["format"]),
        ("Start", start and f"{start.partition('.')[0].replace('T', ' ')} (time zone: {zone})"),
        ("Length", None if recording["duration_s"] is None else _duration(recording["duration_s"])),
        ("Samples", f"{recording['samples']} at {number(rate)} Hz" if rate else str(recording["samples"])),
        ("SHA-256", recording["sha256"]),
    ]
    return [(name, value) for name, value in facts if value]


def _begun(text: str) -> str:
    """A text, or how it begins if it is as long as no line."""
    if len(text) <= LONGEST_TEXT:
        return text
    return f"{text[:LONGEST_TEXT]} ... ({len(text) - LONGEST_TEXT} more characters are in the report)"


def _duration(seconds: float) -> str:
    """A length of time in the two largest units."""
    days, hours, minutes = seconds / 86_400, seconds / 3600, seconds / 60
    if days >= 2:
        return f"{int(days)} days {round(24 * (days % 1))} hours"
    if hours >= 1:
        return f"{int(hours)} hours {int(minutes % 60)} minutes"
    return f"{int(minutes)} minutes {int(seconds % 60)} seconds"


def _subsets(report: Report) -> Table:
    """Points in F's nine subsets."""
    rows = [
        [near, *(str(count) if count else "empty" for count in counts)]
        for near, counts in zip(NEAR, report["coverage"]["subsets"], strict=True)
    ]
    caption = "Points of the fit in the nine subsets of Farago et al. (a point counts on every axis)"
    return Table(caption, ["", "x", "y", "z"], rows)


def _coefficients(report: Report) -> Table | None:
    """Coefficients with their standard errors."""
    calibration = report["calibration"]
    if calibration is None:
        return None
    errors = calibration["standard_errors"] or {}
    values = dict(calibration["parameters"])
    if calibration["temperature"] is not None:
        slopes = calibration["temperature"]["slope_g_per_c"]
        values |= {f"s{axis}": slope for axis, slope in zip("xyz", slopes, strict=True)}
    rows = [
        [name, words.MEANINGS.get(name, ""), decimals(value), decimals(errors.get(name))]
        for name, value in values.items()
    ]
    return Table(
        f"Coefficients of model {calibration['model']}",
        ["Name", "What it is", "Value", "Standard error"],
        rows,
        (0, 1),
    )


def _models(report: Report) -> Table | None:
    """The models tried, and why each was not taken."""
    rows: Rows = []
    tried, model = report["models_tried"], (report["calibration"] or {}).get("model")
    chosen = max((place for place, trial in enumerate(tried) if trial["model"] == model), default=None)
    for place, trial in enumerate(tried):
        prior = f"with the prior {trial['prior']}" if trial.get("prior") else ""
        why = "; ".join(filter(None, ("chosen" if place == chosen else "", prior, trial["reason"])))
        rows.append([trial["model"], words.model_name(trial["model"]), number(trial["after_mg"]), why])
    head = ["Model", "Corrects", "Held-out error [mg]", "Remark"]
    return (
        Table("Models tried, by their error on postures that they had not seen", head, rows, (0, 1, 3))
        if rows
        else None
    )


def _misfits(report: Report) -> Table | None:
    """What the parameters do not describe."""
    rows = [
        [
            one["kind"],
            "found" if one["found"] else "not found",
            f"{', '.join(number(size, 2) for size in one['size'])} {one['unit']}",
            number(one["before_mg"]),
            number(one["after_mg"]),
        ]
        for one in report.get("misfits") or ()
    ]
    head = ["Looked for", "", "Size on x, y, z", "Held-out error without [mg]", "with [mg]"]
    return (
        Table("What a sensor may do that the coefficients do not describe", head, rows, (0, 1, 2))
        if rows
        else None
    )


def _health(report: Report) -> Table:
    """The state of the file."""
    health, recording = report["file_health"], report["recording"]
    clock = health.get("clock") or {}
    gaps = len(recording["gaps"]) + recording["gaps_omitted"]
    facts: list[tuple[str, Any]] = [
        ("Problems found", str(len(health["problems"]))),
        (
            "Lost to damage",
            None
            if "lost_percent" not in health
            else f"{number(health['lost_percent'])} % ({counted(health['lost_bytes'], 'byte')})",
        ),
        (
            "Gaps",
            f"{gaps}, {number(clock['gap_seconds'])} s in all" if clock.get("gap_seconds") else str(gaps),
        ),
        ("Filled samples", str(health["filled_samples"])),
        ("Samples at the sensor's range", str(health["clipped_samples_before"])),
        (
            "Measured rate",
            None if health["rate_hz_measured"] is None else f"{number(health['rate_hz_measured'], 6)} Hz",
        ),
        (
            "Drift of the clock",
            None if clock.get("drift_s_per_day") is None else f"{number(clock['drift_s_per_day'])} s per day",
        ),
    ]
    return Table("The file", ["", ""], [[name, value] for name, value in facts if value is not None])


def _windows(report: Report) -> Table:
    """What became of the windows."""
    held = report["fit"]["windows"]
    rows = [[text, str(held[name])] for name, text in WINDOWS.items() if held.get(name)]
    return Table("Windows", ["", "Number"], rows)


def _problems(report: Report) -> Table | None:
    """Damage that was found, the first of it."""
    problems = report["file_health"]["problems"]
    rows = [
        [
            one["code"],
            _begun(one["message"]),
            "–" if one["byte_offset"] is None else str(one["byte_offset"]),
            str(one["count"]),
        ]
        for one in problems[:MOST_PROBLEMS]
    ]
    more = (
        f"; {len(problems) - MOST_PROBLEMS} more are in the report" if len(problems) > MOST_PROBLEMS else ""
    )
    return Table(f"Problems{more}", ["Code", "What", "Byte", "Times"], rows, (0, 1)) if rows else None


def _origin(report: Report) -> list[tuple[str, str]]:
    """Who made the report, when and with what."""
    made = report.get("provenance") or {}
    versions = made.get("versions") or {}
    facts = [
        ("accelcal", report["accelcal_version"]),
        ("Command", _begun(" ".join(made.get("command") or ()))),
        ("Time", made.get("time")),
        ("Computer", " ".join(filter(None, (made.get("host"), made.get("platform"))))),
        ("Versions", ", ".join(f"{name} {version}" for name, version in versions.items())),
    ]
    return [(name, value) for name, value in facts if value]


MOST_ROWS = 200
"""The report has the others."""


@dataclass(frozen=True, slots=True)
class KnownOrientations:
    """The part of the page; caution: that nothing was held out, None where something was."""

    caution: str | None
    poses: Table
    rolls: Table | None


def poses_of(report: Report) -> KnownOrientations | None:
    """The part of the page; None for a report without known orientations."""
    known = report.get("known_orientations")
    if not known or "poses" not in report:
        return None
    return KnownOrientations(advice.unchecked_poses(report), _poses(report["poses"]), _rolls(known))


def _poses(poses: list[dict[str, Any]]) -> Table:
    rows: Rows = [
        [
            one["face"],
            _where(one),
            ", ".join(number(value) for value in one["reference_g"]),
            *(number(one[name]) for name in ("raw_mg", "residual_mg", "held_out_mg", "repeat_mg")),
        ]
        for one in poses[:MOST_ROWS]
    ]
    more = f"; {len(poses) - MOST_ROWS} more are in the report" if len(poses) > MOST_ROWS else ""
    head = ["Pose", "Where", "True acceleration [g]", "Raw error [mg]", "Residual of the fit [mg]",
            "Held-out error [mg]", "From the mean of its orientation [mg]"]  # fmt: skip
    return Table(f"Poses, and the errors of their vectors{more}", head, rows, (0, 1, 2))


def _rolls(known: Mapping[str, Any]) -> Table | None:
    rows: Rows = [
        [one["axis"], _where(one), *(_level(one["level_mg"][when]) for when in ("before", "after"))]
        for one in known.get("rolls") or ()
    ]
    head = ["Axis", "Where", "Shows [mg] (SD)", "Calibrated [mg] (SD)"]
    return Table("Rolls with one axis level, which should show nothing", head, rows, (0, 1)) if rows else None


def _where(one: Mapping[str, Any]) -> str:
    times = f"{one['start_s']:.0f} to {one['end_s']:.0f} s"
    return f"{one['file']}, {times}" if "file" in one else times


def _level(level: Mapping[str, Any] | None) -> str:
    return "–" if level is None else f"{number(level['mean'])} ({number(level['sd'])})"
