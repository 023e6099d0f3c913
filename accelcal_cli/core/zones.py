"""Whose time zone counts: the file's own, else the user's. THE policy of all formats (docs/time.md).

A reader only says which zone a file states: a name or an offset for a clock that shows local time, `UTC`
for times that count from 1970 or end in `Z` or an offset, None where it states none.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta

from accelcal_cli.core.clock import utc_offset_s
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.recording import Recording

UTC, UNKNOWN = "UTC", "unknown"
"""What times in the outputs are in: moments in UTC, or local times of an unknown zone."""

OMIT = "omit {option}, which is for files that state no zone"
TWICE = "{time} occurs twice in {zone} on that day: it is taken to be the first, before clocks were put back"
NEVER = "{time} does not occur in {zone} on that day: the clock is taken to be one that was not put forward"


def zone_of_times(offset_s: int | None) -> str:
    """What the times of outputs are in, by the seconds that the device's clock is ahead of UTC."""
    return UNKNOWN if offset_s is None else UTC


def in_its_zone(
    recording: Recording, wanted: str | None, *, force: bool, option: str = "--timezone"
) -> Recording:
    """A recording that a reader opened, in the zone that counts.

    Args:
        wanted: the user's zone, for files that state none.
        force: the user's zone counts in any case.
        option: by which the user gave it.

    Raises:
        UsageError: the zone that the file states is not the user's; or the user's is to replace offsets
            that the times themselves had.
    """
    zone = _zone(recording, wanted, force, OMIT.format(option=option))
    note = () if zone is None or recording.start_us is None else _start_note(zone, recording.start_us)
    return replace(recording, timezone=zone, notes=(*recording.notes, *note))


def _zone(recording: Recording, wanted: str | None, force: bool, omit: str) -> str | None:
    stated, start_us = recording.timezone, recording.start_us or 0
    if wanted is None or stated is None:
        return wanted or stated
    if utc_offset_s(stated, start_us) == utc_offset_s(wanted, start_us):
        return wanted if force else stated
    if not force:
        what = f"states its time zone, {stated}, which is not {wanted}"
        hint = f"{omit}; or add --force-timezone if the file is wrong"
        raise UsageError(what, path=recording.path, hint=hint)
    if recording.has_offsets:
        what = f"its times have offsets from UTC, which --force-timezone cannot replace with {wanted}"
        raise UsageError(what, path=recording.path, hint=f"{omit}; or write the times without offsets")
    return wanted


def _start_note(zone: str, start_us: int) -> tuple[str, ...]:
    """What a start means that daylight saving made to occur twice or never; nothing for any other."""
    first, second = (utc_offset_s(zone, start_us, fold=fold) or 0 for fold in (0, 1))
    if first == second:
        return ()
    shown = (datetime(1970, 1, 1) + timedelta(microseconds=start_us)).isoformat(" ", "seconds")
    return ((TWICE if first > second else NEVER).format(time=shown, zone=zone),)
