"""Local times of a recording: whose zone counts, what the user states, daylight saving.

This is the policy of all formats (docs/time.md). A reader only says which zone a file states: a name or an
offset for a clock that shows local time, `UTC` for times that count from 1970 or end in `Z` or an offset,
None if it states none.

A user may state when a recording began, that its clock was wrong, or the zone in which it was worn. Times
then move as a whole, by one number of microseconds, so that no row is lost, doubled or moved against another.

A device's clock runs on when its zone changes its offset. A computer's clock follows the change: times in its
tables skip an hour in spring and repeat one in autumn. `LocalStamps` makes such times run on too, so that
all later stages see one offset for a whole recording.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, tzinfo
from functools import partial

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, StartTime, iso_time, offset_at_s, utc_offset_s
from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.recording import Chunk, Intake, Reader, Recording
from accelcal_cli.core.written_times import written_start

UTC, UNKNOWN = "UTC", "unknown"
"""Meaning of times in the outputs: moments in UTC, or local times of an unknown zone."""

OMIT = "omit {option}, which is for files that state no zone"
TWICE = "{time} occurs twice in {zone} on that day: it is taken to be the first, before clocks were put back"
NEVER = "{time} does not occur in {zone} on that day: the clock is taken to be one that was not put forward"

NO_START = "no_start_time"
"""Code of the problem of a recording without dates; its times count from 1970."""

FIRST_SAMPLES = 1
ISO_HINT = "write it as 2024-03-04T10:00:00, with an offset such as +01:00 if it is known"
STARTED = "it does not say when it began: {} was given with -R start"
SHIFTED = "{:+g} s were added to all times (-R shift)"
WORN = "the clock was set in {there} and worn in {here}: times are those of {here}, {hours:+g} h"

FOLLOWED = "clock_followed"
"""Code of the problem that says where times followed a change of their zone."""

PAUSE_US = 60 * MICROSECONDS
"""Longest pause [us] between the rows before and after a change whose times are said to follow it."""

SHIFT_STEP_US, LARGEST_SHIFT_US = 1800 * MICROSECONDS, 3 * 3600 * MICROSECONDS
"""Step and maximum [us] by which clocks are put forward or back."""

_DAY_S = 86_400


def zone_of_times(offset_s: int | None) -> str:
    """Return the meaning of times in the outputs, by the seconds that the clock is ahead of UTC."""
    return UNKNOWN if offset_s is None else UTC


def in_its_zone(
    recording: Recording, wanted: str | None, *, force: bool, option: str = "--timezone"
) -> Recording:
    """Return a recording as a reader opened it, in the zone that counts.

    Args:
        wanted: the user's zone, for files that state none.
        force: the user's zone counts in any case.
        option: the option that gave it.

    Raises:
        UsageError: the zone that the file states is not the user's; or the user's is to replace offsets
            that the times themselves had.
    """
    zone = _zone(recording, wanted, force, OMIT.format(option=option))
    notes, start_us = recording.notes, recording.start_us
    if zone is not None and start_us is not None:
        first, second = (utc_offset_s(zone, start_us, fold=fold) or 0 for fold in (0, 1))
        if first != second:
            shown = (datetime(1970, 1, 1) + timedelta(microseconds=start_us)).isoformat(" ", "seconds")
            notes = (*notes, (TWICE if first > second else NEVER).format(time=shown, zone=zone))
    return replace(recording, timezone=zone, notes=notes)


def _zone(recording: Recording, wanted: str | None, force: bool, omit: str) -> str | None:
    stated, start_us = recording.timezone, recording.start_us or 0
    if wanted is None or stated is None:
        return wanted or stated
    if utc_offset_s(stated, start_us) == utc_offset_s(wanted, start_us):
        return wanted if force else stated
    if not force:
        what = f"states its time zone, {stated}, which is not {wanted}"
        hint = f"{omit}; or add -R force_timezone=true if the file is wrong"
        raise UsageError(what, path=recording.path, hint=hint)
    if recording.has_offsets:
        what = f"its times have offsets from UTC, which -R force_timezone cannot replace with {wanted}"
        raise UsageError(what, path=recording.path, hint=f"{omit}; or write the times without offsets")
    return wanted


@dataclass(frozen=True, slots=True)
class ZoneChange:
    """Change of a zone's offset from UTC during a recording.

    Attributes:
        at_us: time of the change, on a clock that had the zone's offset until then [us since 1970].
        before_s, after_s: seconds ahead of UTC.
        followed: True if the times followed it; None if they do not show it, and count as those of a clock
            that runs on.
    """

    zone: str
    at_us: int
    before_s: int
    after_s: int
    followed: bool | None = False

    def note(self) -> str:
        """Return the sentence for the report."""
        shift_s = self.after_s - self.before_s
        hours = f"{abs(shift_s) / 3600:g} h"
        put, off, wrong = ("forward", "behind", "late") if shift_s > 0 else ("back", "ahead of", "early")
        then = {
            True: "the times of this file follow that, and were read so",
            False: f"the device's clock was not, and is {hours} {off} local time from then on",
            None: "the rows that were read do not show whether the clock of this file was, too: it is taken "
            f"to be one that was not; if it was, later times are {hours} too {wrong}",
        }
        at = iso_time(self.at_us, self.before_s)
        return f"clocks in {self.zone} were put {put} by {hours} at {at}; {then[self.followed]}"


def zone_changes(zone: str | None, start_us: int, end_us: int) -> Iterator[ZoneChange]:
    """Yield the changes of a zone's offset during a recording; none for a fixed or unknown zone.

    Args:
        start_us, end_us: local times of the first and last sample, on a clock that keeps its offset.
    """
    place = _place(zone)
    if zone is None or place is None:
        return
    try:
        offset_s = before_s = utc_offset_s(zone, start_us) or 0
        low_s, end_s = (time_us // MICROSECONDS - offset_s for time_us in (start_us, end_us))
        while low_s < end_s:
            high_s = min(low_s + _DAY_S, end_s)
            if (after_s := _offset_at(place, high_s)) != before_s:
                at_s = _first_other(place, low_s, high_s, before_s)
                yield ZoneChange(zone, (at_s + before_s) * MICROSECONDS, before_s, after_s)
                before_s = after_s
            low_s = high_s
    except (OverflowError, ValueError, OSError):
        return


def _place(zone: str | None) -> tzinfo | None:
    """Return a zone that may change its offset, one of a region and place; else None."""
    from zoneinfo import ZoneInfo  # few recordings name one

    return None if zone is None or "/" not in zone else ZoneInfo(zone)


def _first_other(place: tzinfo, low_s: int, high_s: int, offset_s: int) -> int:
    """Return the first second with another offset, between one that has it and one that does not."""
    while high_s - low_s > 1:
        middle = (low_s + high_s) // 2
        low_s, high_s = (middle, high_s) if _offset_at(place, middle) == offset_s else (low_s, middle)
    return high_s


def _offset_at(place: tzinfo, utc_s: int) -> int:
    offset = datetime.fromtimestamp(utc_s, place).utcoffset()
    return 0 if offset is None else round(offset.total_seconds())


class LocalStamps:
    """Makes the times of a table's rows those of a clock that runs on.

    Times follow a change of the zone if they jump by as much as its clocks did, just when these did. Such a
    jump is undone; any other stays.
    """

    def __init__(self, zone: str | None) -> None:
        self._zone = zone
        self._place = _place(zone)
        self._start_s: int | None = None
        self._offset_s = 0
        self._before = 0

    def running_on(self, times: NDArray[np.int64]) -> tuple[NDArray[np.int64], list[int]]:
        """Return the next times (n,) [us] on a clock that runs on.

        Returns:
            the times, and the rows before which they follow a change.
        """
        if self._place is None or not len(times):
            return times, []
        if self._start_s is None:
            self._before = int(times[0])
            self._start_s = self._offset_s = utc_offset_s(self._zone, self._before) or 0
        before = np.concatenate(([self._before], times[:-1]))
        self._before = int(times[-1])
        rows, running = [], times + (self._start_s - self._offset_s) * MICROSECONDS
        steps = times - before
        far = np.flatnonzero((np.abs(steps) > SHIFT_STEP_US // 2) & (np.abs(steps) <= LARGEST_SHIFT_US))
        for row in far[steps[far] % SHIFT_STEP_US <= PAUSE_US].tolist():
            shift_s = self._shift_s(int(before[row]), int(times[row]))
            if shift_s:
                self._offset_s += shift_s
                running[row:] -= shift_s * MICROSECONDS
                rows.append(row)
        return running, rows

    def _shift_s(self, before_us: int, after_us: int) -> int:
        """Return the seconds by which clocks and times were put forward between two rows; else 0."""
        assert self._place is not None
        utc_us = before_us - self._offset_s * MICROSECONDS
        try:
            now_s, then_s = (
                _offset_at(self._place, moment // MICROSECONDS) for moment in (utc_us, utc_us + PAUSE_US)
            )
            lasted_us = after_us - before_us - (then_s - now_s) * MICROSECONDS
            moved = now_s == self._offset_s and 0 <= lasted_us <= PAUSE_US
            moved = moved and _offset_at(self._place, (utc_us + lasted_us) // MICROSECONDS) == then_s
        except (OverflowError, ValueError, OSError):
            return 0
        return then_s - now_s if moved else 0


@dataclass(frozen=True, slots=True)
class Retiming:
    """Statements of the user about times; None or 0 where nothing is stated.

    Attributes:
        zone: zone of the device's clock, for files that state none; by_option: the option that gave it.
        force: that zone counts in any case.
        start: start of a recording without dates, ISO 8601.
        shift_us: added to all times.
        worn_zone: zone in which the device was worn while its clock showed another.
    """

    zone: str | None = None
    by_option: str = "--timezone"
    force: bool = False
    start: str | None = None
    shift_us: int = 0
    worn_zone: str | None = None

    def check(self) -> None:
        """Raise UsageError for an unknown zone, a start that is not a time, or an incomplete pair of
        options."""
        utc_offset_s(self.zone, 0)
        utc_offset_s(self.worn_zone, 0)
        if self.force and self.zone is None:
            raise UsageError("-R force_timezone has no zone to use", hint="give it with --timezone")
        if self.by_option != "--timezone" and self.worn_zone is None:
            raise UsageError(
                "-R configured_zone is for -R worn_zone", hint="give that, too, or use --timezone"
            )
        self.started()

    def started(self) -> StartTime | None:
        """Return the start; None if none is stated.

        Raises:
            UsageError: it is not a time.
        """
        if self.start is None:
            return None
        start = written_start(self.start)
        if start is None:
            raise UsageError(f"-R start={self.start[:40]!r} is not a date and time", hint=ISO_HINT)
        return start


class RetimedReader(Reader):
    """Reader that moves the times of another one's chunks.

    Args:
        recording: its description, with the moved times.
        by_us: added to all times.
        dated: the start is known, whatever the file says.
    """

    def __init__(self, reader: Reader, recording: Recording, by_us: int, *, dated: bool) -> None:
        self.recording = recording
        self._reader, self._moved = reader, partial(moved, by_us=by_us, dated=dated)

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """See `Reader`."""
        self._reader.threads, self._reader.with_others = self.threads, self.with_others
        return map(self._moved, self._reader.chunks(chunk_samples))

    def intake(self) -> Intake:
        """See `Reader`."""
        return RetimedIntake(self._reader.intake(), self._moved)

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """See `Reader`."""
        return map(self._moved, self._reader.preview(chunk_samples, pieces))

    def close(self) -> None:
        """Release the file."""
        self._reader.close()


def moved(chunk: Chunk, by_us: int, *, dated: bool) -> Chunk:
    """Return a chunk with moved times; if `dated`, without the problem that there are no dates."""
    problems = chunk.problems
    if dated:
        problems = tuple(problem for problem in problems if problem.code != NO_START)
    return replace(chunk, clock=chunk.clock.shifted(by_us), problems=problems)


class RetimedIntake(Intake):
    """Intake that moves the times of another one's chunks as `RetimedReader` does."""

    def __init__(self, intake: Intake, moved: Callable[[Chunk], Chunk]) -> None:
        self._intake, self._moved = intake, moved

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`."""
        return map(self._moved, self._intake.take(data, last=last))


def retimed(reader: Reader, stated: Retiming) -> Reader:
    """Return a reader as its format opened it, with the times that count.

    Raises:
        UnreadableError: no sample can be read.
        UsageError: what is stated contradicts the file, or does not suffice.
    """
    found, by_us = reader.recording, 0
    if found.shown_in is not None:
        found, by_us = _in_zone(found, found.shown_in)
    if stated.start is not None:
        found, by_us = _started(reader, stated)
    if stated.shift_us:
        _need_start(found, "-R shift")
        found = _moved(found, stated.shift_us, SHIFTED.format(stated.shift_us / 1e6))
        by_us += stated.shift_us
    found = in_its_zone(found, stated.zone, force=stated.force, option=stated.by_option)
    reader.recording = replace(reader.recording, timezone=found.timezone)
    if stated.worn_zone is not None:
        found, moved_us = _worn(found, stated.worn_zone)
        by_us += moved_us
    elif not by_us and stated.start is None:
        reader.recording = found
        return reader
    return RetimedReader(reader, found, by_us, dated=stated.start is not None)


def _moved(recording: Recording, by_us: int, note: str) -> Recording:
    start_us = (recording.start_us or 0) + by_us
    return replace(recording, start_us=start_us, notes=(*recording.notes, note))


def _need_start(recording: Recording, option: str) -> None:
    if recording.start_us is None:
        text = f"has no dates that {option} could change"
        raise UsageError(
            text, path=recording.path, hint=f"omit {option}, or say with -R start=TIME when it began"
        )


def _started(reader: Reader, stated: Retiming) -> tuple[Recording, int]:
    """Return a recording without dates that begins when the user says, and how far its times move [us]."""
    recording, start = reader.recording, stated.started()
    assert start is not None
    if recording.start_us is not None:
        shown = iso_time(recording.start_us, utc_offset_s(recording.timezone, recording.start_us))
        hint = "-R start is for files without dates; to correct the clock, use -R shift=SECONDS"
        raise UsageError(f"states its own start, {shown}", path=recording.path, hint=hint)
    known = replace(recording, start_us=start.start_us, timezone=start.timezone or recording.timezone)
    note = STARTED.format(stated.start)
    dated = replace(known, has_offsets=start.had_offset, notes=(*recording.notes, note))
    first = next((chunk for chunk in reader.chunks(FIRST_SAMPLES) if len(chunk)), None)
    if first is None:
        raise UnreadableError("holds no samples", path=recording.path)
    return dated, start.start_us - int(first.clock.times(0, 1)[0])


def _worn(recording: Recording, zone: str) -> tuple[Recording, int]:
    """Return a recording with the times of the zone in which it was worn, and how far they move [us]."""
    _need_start(recording, "-R worn_zone")
    there = recording.timezone
    if there is None:
        hint = "say it with -R configured_zone=ZONE"
        raise UsageError("does not say in which zone its clock was set", path=recording.path, hint=hint)
    found, by_us = _in_zone(recording, zone)
    note = WORN.format(there=there, here=zone, hours=by_us / 3600e6)
    return replace(found, notes=(*found.notes, note)), by_us


def _in_zone(recording: Recording, zone: str) -> tuple[Recording, int]:
    """Return a recording with the same moments as times of another zone, and how far they move [us].

    Its clock runs on with the offset that its own zone had at the start; so do the times of the other zone.
    """
    start_us = recording.start_us or 0
    before_s = utc_offset_s(recording.timezone, start_us) or 0
    after_s = offset_at_s(zone, start_us - before_s * MICROSECONDS)
    by_us = (after_s - before_s) * MICROSECONDS
    if utc_offset_s(zone, start_us + by_us) != after_s:
        # The local time occurs twice, and the zone's name would stand for the first of them.
        hours, minutes = divmod(abs(after_s) // 60, 60)
        zone = f"{'-' if after_s < 0 else '+'}{hours:02d}:{minutes:02d}"
    return replace(recording, start_us=start_us + by_us, timezone=zone, stamped=False), by_us
