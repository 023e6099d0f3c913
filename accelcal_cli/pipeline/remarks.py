"""What is said of borrowed coefficients: the report's `message`, and the warning on stderr."""

from __future__ import annotations

from typing import Any

from accelcal_cli.core.judgement import Holdout, Outcome
from accelcal_cli.core.names import printable
from accelcal_cli.core.points import Calibration
from accelcal_cli.core.recording import Recording
from accelcal_cli.output.coefficients import Coefficients

SHOWN_HASH = 12


def sentence(
    donor: Coefficients, calibration: Calibration, recording: Recording, held: Holdout | None, limit_mg: float
) -> str:
    """Whose the coefficients are, what they did, what is different here, and what to beware of."""
    beware = [] if held is None else _warnings(held.before.mean, held.after.mean, limit_mg)
    about = f"coefficients of {_named(donor)}: {_change(held)}"
    return printable("; ".join([about, *beware, *_notes(donor, calibration, recording)]))


def _named(donor: Coefficients) -> str:
    origin = donor.origin
    device = " ".join(word for word in (origin.device.model, origin.device.serial) if word)
    return f"{origin.path} (sha256 {origin.sha256[:SHOWN_HASH]}, device {device or 'unknown'})"


def _change(held: Holdout | None) -> str:
    if held is None:
        return "no two postures of stillness to judge them by"
    return (
        f"{held.before.mean:.1f} mg before, {held.after.mean:.2f} mg after "
        f"on {held.postures} postures, none of which they were found from"
    )


def _notes(donor: Coefficients, calibration: Calibration, recording: Recording) -> list[str]:
    """What is different from the donor, but does not hinder."""
    notes, then = [], donor.document.report["recording"]
    theirs, ours = donor.origin.device, recording.device
    if theirs.serial != ours.serial or not ours.serial:
        notes.append(f"this recording's device is {ours.serial or 'unknown'}")
    elif theirs.model and ours.model and theirs.model != ours.model:
        notes.append(f"this recording's device is a {ours.model} of the same serial")
    direct = then["sha256"] == donor.origin.sha256
    if direct and then["lsb_per_g"] not in (None, recording.lsb_per_g):
        notes.append(f"{recording.lsb_per_g:.10g} counts per g here, {then['lsb_per_g']:.10g} there")
    if donor.calibration.temperature is not None and calibration.temperature is None:
        at_c = donor.calibration.reference_c()
        notes.append(f"used as at {at_c:.1f} C, their temperature slopes are left out")
    return notes


def _warnings(before_mg: float, after_mg: float, limit_mg: float) -> list[str]:
    found = []
    if after_mg > before_mg:
        found.append("the error is larger with them than without")
    if after_mg >= limit_mg:
        found.append(f"{limit_mg:g} mg or more are left")
    return found


def warning(report: dict[str, Any]) -> str | None:
    """What a user must be told of a report of borrowed coefficients, or None."""
    held = report["holdout"]
    if report["outcome"] != Outcome.BORROWED or held is None:
        return None
    before_mg, after_mg = held["before_mg"]["mean"], held["after_mg"]["mean"]
    found = _warnings(before_mg, after_mg, report["settings"]["max_error_mg"])
    return f"warning: {report['message']}" if found else None
