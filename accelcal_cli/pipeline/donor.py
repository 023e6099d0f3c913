"""What coefficients have to do with a recording: are they its own, its device's, another's?"""

from __future__ import annotations

from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.names import printable
from accelcal_cli.core.points import Calibration
from accelcal_cli.core.recording import Recording
from accelcal_cli.core.settings import DEFAULT, SIX_POSE, Settings
from accelcal_cli.output.coefficients import Coefficients
from accelcal_cli.pipeline.identity import sha256
from accelcal_cli.pipeline.rebuild import rebuild
from accelcal_cli.pipeline.request import Request

READING = ("unit", "columns", "sensor", "lsb_per_g", "layout_sha256")
"""Reading options that decide the values themselves."""

ANY_DEVICE = "use --any-device to apply them all the same"


class Link(Enum):
    """Own: found from this very recording, read as it is read now. Reread: from the same file, but
    read otherwise. Other: from another recording."""

    OWN = "own"
    REREAD = "reread"
    OTHER = "other"


def link(donor: Coefficients, recording: Recording, bytes_at: Path, request: Request) -> Link:
    """How a recording and the coefficients to apply to it belong together.

    Raises:
        UsageError: they are not of the same device, or it is not known, and the user did not say
            that this does not matter; or they are its own, but not as they would be applied.
    """
    found = relation(donor, recording, bytes_at, request)
    if found is Link.OWN:
        _refuse_changes(donor, recording, request)
    elif not request.any_device:
        _refuse_other_device(donor, recording, found)
    return found


def relation(donor: Coefficients, recording: Recording, bytes_at: Path, request: Request) -> Link:
    """How a recording and coefficients belong together, whatever is asked for."""
    report = donor.document.report
    if report["recording"]["bytes"] != bytes_at.stat().st_size and "coefficients" not in report:
        return Link.OTHER
    if sha256(bytes_at) != donor.origin.sha256:
        return Link.OTHER
    own = report["recording"]["sha256"] == donor.origin.sha256
    return Link.OWN if own and not _read_otherwise(report, recording, request) else Link.REREAD


def _read_otherwise(report: dict[str, Any], recording: Recording, request: Request) -> bool:
    then = report["recording"]
    if (then["format"], then["sample_rate_hz"], then["lsb_per_g"]) != (
        recording.format,
        recording.rate_hz,
        recording.lsb_per_g,
    ):
        return True
    used = report.get("settings")
    before = used.get("input") if isinstance(used, dict) else None
    if not isinstance(before, dict):
        return True
    now = request.effective_settings(recording.companion)["input"]
    return any(before.get(name) != now[name] for name in READING)


def _refuse_changes(donor: Coefficients, recording: Recording, request: Request) -> None:
    """A recording's own result holds only as it was found."""
    found, wanted = donor.calibration, request.settings
    if found.temperature is not None and not wanted.temperature:
        option = "--no-temperature"
    elif wanted.latitude is not None and wanted.gravity != found.gravity:
        option = "--latitude"
    else:
        return
    raise UsageError(
        f"the coefficients are this recording's own, and {option} was not in their making",
        path=recording.path,
        hint=f"leave {option} out, or calibrate it again with it",
    )


def _refuse_other_device(donor: Coefficients, recording: Recording, found: Link) -> None:
    theirs, ours = donor.origin.device.serial, recording.device.serial
    if found is Link.REREAD:
        raise UsageError(
            "the coefficients are of this very file, but the report is not, or the file was read otherwise",
            path=recording.path,
            hint=f"give its own report and the reading options of then, or {ANY_DEVICE}",
        )
    if theirs and theirs == ours:
        return
    if theirs and ours:
        text = f"was recorded by device {ours}, the coefficients are those of device {theirs}"
    elif theirs:
        text = f"does not say which device recorded it, the coefficients are those of device {theirs}"
    elif ours:
        text = f"was recorded by device {ours}, the coefficients do not say whose they are"
    else:
        text = "neither it nor the coefficients say of which device they are"
    raise UsageError(printable(text), path=recording.path, hint=ANY_DEVICE)


def settings_for(donor: Coefficients, found: Link, wanted: Settings) -> Settings:
    """What finds and judges the recording's stillness: what was used on the donor's, as far as it fits.

    Profile `paper` keeps only eighteen points; another recording is judged by all it has.

    Raises:
        UnreadableError: the donor's report has settings that cannot be.
    """
    held = donor.document.report.get("settings")
    known = isinstance(held, dict) and held.get("profile") != SIX_POSE
    rebuilt = rebuild(donor.document).settings if known else DEFAULT
    base = rebuilt if isinstance(rebuilt, Settings) else DEFAULT
    base = replace(base, precision_mg=wanted.precision_mg)
    if found is Link.OWN:
        return replace(base, max_damage_percent=wanted.max_damage_percent)
    base = base if base.profile == DEFAULT.profile else DEFAULT
    place = wanted.gravity if wanted.latitude is not None else donor.calibration.gravity
    return replace(
        base,
        optimizer=DEFAULT.optimizer,
        precision_mg=wanted.precision_mg,
        model=DEFAULT.model,
        temperature=wanted.temperature and donor.calibration.temperature is not None,
        latitude=place.latitude,
        altitude_m=place.altitude_m,
        max_damage_percent=wanted.max_damage_percent,
    )


def applied(donor: Coefficients, settings: Settings) -> Calibration:
    """The calibration to apply: the donor's, at its reference temperature where none is to be used."""
    found = donor.calibration
    if found.temperature is None or settings.temperature:
        return found
    still = (*found.parameters[:9], 0, 0, 0)
    return replace(found, model=found.model.removesuffix("T"), parameters=still, temperature=None)


def need_temperature(calibration: Calibration, recording: Recording, *, has: bool) -> None:
    """Raise UsageError where slopes meet a recording without temperature."""
    if calibration.temperature is not None and not has:
        raise UsageError(
            "has no temperature, but the coefficients have slopes",
            path=recording.path,
            hint=f"--no-temperature uses them as at {calibration.reference_c():.1f} C",
        )
