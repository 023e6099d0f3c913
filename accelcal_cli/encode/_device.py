"""What a recording must be like so that a vendor's device could have made it."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from pathlib import Path

from accelcal_cli.core.errors import OutputError, UsageError
from accelcal_cli.core.recording import Device, Recording
from accelcal_cli.encode._rows import OTHER_FORMAT


def known_rate(recording: Recording, rates: Iterable[float], device: str, rounded_hz: float = 0.0) -> float:
    """The device's rate that the recording has, or that it is rounded from by so much at most.

    Raises:
        UsageError: it has no such rate; the hint names the nearest one.
    """
    rate_hz = recording.rate_hz
    nearest = min(rates, key=lambda rate: abs(rate - rate_hz))
    if abs(nearest - rate_hz) > rounded_hz:
        raise UsageError(f"{device} does not record at {rate_hz:g} Hz", hint=f"use --rate {nearest:g}")
    return nearest


def known_scale(recording: Recording, scales: Collection[tuple[float, float]], device: str) -> None:
    """Make sure that the device has the recording's counts per g and range.

    Args:
        scales: the device's pairs of counts per g and range [g].

    Raises:
        UsageError: it has no such pair; the hint names them.
    """
    if any((recording.lsb_per_g, recording.range_g) == scale for scale in scales):
        return
    known = " or ".join(f"--lsb-per-g {lsb_per_g:g} --range-g {range_g:g}" for lsb_per_g, range_g in scales)
    over = "an unknown range" if recording.range_g is None else f"+-{recording.range_g:g} g"
    raise UsageError(
        f"{device} does not record {recording.lsb_per_g:g} counts per g over {over}", hint=f"use {known}"
    )


def start_us(path: Path, recording: Recording) -> int:
    """Time of the first sample [us since 1970].

    Raises:
        OutputError: the recording does not tell; a vendor's file has no way to say so.
    """
    if recording.start_us is None:
        raise OutputError("the recording has no start time", path=path, hint=OTHER_FORMAT)
    return recording.start_us


def fixed_offset(timezone: str | None) -> str | None:
    """The zone as hours and minutes east of UTC, such as +01:00; None where it is not known so."""
    offset = "+00:00" if timezone == "UTC" else timezone or ""
    return offset if re.fullmatch(r"[+-]\d\d:\d\d", offset) else None


def number_of(device: Device) -> int:
    """The last eight digits of the serial number, for formats that hold a number only; 0 without any."""
    return int("".join(re.findall(r"[0-9]", device.serial or ""))[-8:] or 0)


def remark(device: Device) -> str:
    """Model and serial number as given, in printable ASCII, for a field of remarks."""
    told = " ".join(text for text in (device.model, device.serial) if text)
    return re.sub(r"[^ -~]", "?", told)
