"""What a user states of a recording's times: when it began, that its clock was wrong, where it was worn.

Times are moved as a whole, by one number of microseconds, so that no row is lost, doubled or moved against
another. The zone of the clock itself is decided in `core/zones.py` (docs/time.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime

from accelcal_cli.core.clock import MICROSECONDS, StartTime, iso_time, offset_at_s, start_of, utc_offset_s
from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.recording import Chunk, Intake, Reader, Recording
from accelcal_cli.core.zones import in_its_zone

NO_START = "no_start_time"
"""Code of the problem of a recording without dates; its times count from 1970."""

FIRST_SAMPLES = 1
ISO_HINT = "write it as 2024-03-04T10:00:00, with an offset such as +01:00 if it is known"
STARTED = "it does not say when it began: {} was given with --start"
SHIFTED = "{:+g} s were added to all times (--shift)"
WORN = "the clock was set in {there} and worn in {here}: times are those of {here}, {hours:+g} h"


@dataclass(frozen=True, slots=True)
class Retiming:
    """What is stated; None or 0 where nothing is.

    Attributes:
        zone: of the device's clock, for files that state none; by_option: how it was given.
        force: that zone counts in any case.
        start: of a recording without dates, ISO 8601.
        shift_us: to be added to all times.
        worn_zone: in which the device was worn, while its clock showed another.
    """

    zone: str | None = None
    by_option: str = "--timezone"
    force: bool = False
    start: str | None = None
    shift_us: int = 0
    worn_zone: str | None = None

    def check(self) -> None:
        """Raise UsageError for an unknown zone, a start that is no time, or half of what is needed."""
        utc_offset_s(self.zone, 0)
        utc_offset_s(self.worn_zone, 0)
        if self.force and self.zone is None:
            raise UsageError("--force-timezone has no zone to use", hint="give it with --timezone")
        if self.by_option != "--timezone" and self.worn_zone is None:
            raise UsageError("--configured-zone is for --worn-zone", hint="give that, too, or use --timezone")
        self.started()

    def started(self) -> StartTime | None:
        """The start; None if none is stated.

        Raises:
            UsageError: it is no time.
        """
        if self.start is None:
            return None
        try:
            start = start_of(datetime.fromisoformat(self.start.strip()))
        except ValueError:
            start = None
        if start is None:
            raise UsageError(f"--start {self.start[:40]!r} is not a date and time", hint=ISO_HINT)
        return start


class RetimedReader(Reader):
    """A reader of another one's chunks, whose times are moved.

    Args:
        recording: what is known of it now.
        by_us: added to all times.
        dated: it is known when it began, whatever the file says.
    """

    def __init__(self, reader: Reader, recording: Recording, by_us: int, *, dated: bool) -> None:
        self.recording = recording
        self._reader, self._by_us, self._dated = reader, by_us, dated

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """See `Reader`."""
        self._reader.threads = self.threads
        return map(self._moved, self._reader.chunks(chunk_samples))

    def intake(self) -> Intake:
        """See `Reader`."""
        return RetimedIntake(self._reader.intake(), self._by_us, dated=self._dated)

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """See `Reader`."""
        return map(self._moved, self._reader.preview(chunk_samples, pieces))

    def close(self) -> None:
        """Release the file."""
        self._reader.close()

    def _moved(self, chunk: Chunk) -> Chunk:
        return moved(chunk, self._by_us, dated=self._dated)


def moved(chunk: Chunk, by_us: int, *, dated: bool) -> Chunk:
    """A chunk whose times are moved, without the problem that there are no dates if there are."""
    problems = chunk.problems
    if dated:
        problems = tuple(problem for problem in problems if problem.code != NO_START)
    return replace(chunk, clock=chunk.clock.shifted(by_us), problems=problems)


class RetimedIntake(Intake):
    """An intake of another one's chunks, whose times are moved as `RetimedReader` moves them."""

    def __init__(self, intake: Intake, by_us: int, *, dated: bool) -> None:
        self._intake, self._by_us, self._dated = intake, by_us, dated

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`."""
        for chunk in self._intake.take(data, last=last):
            yield moved(chunk, self._by_us, dated=self._dated)


def retimed(reader: Reader, stated: Retiming) -> Reader:
    """A reader as its format opened it, with the times that count.

    Raises:
        UnreadableError: no sample can be read.
        UsageError: what is stated contradicts the file, or does not suffice.
    """
    found, by_us = reader.recording, 0
    if stated.start is not None:
        found, by_us = _started(reader, stated)
    if stated.shift_us:
        _need_start(found, "--shift")
        found, by_us = (
            _moved(found, stated.shift_us, SHIFTED.format(stated.shift_us / 1e6)),
            by_us + stated.shift_us,
        )
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
        raise UsageError(text, path=recording.path, hint=f"omit {option}, or say with --start when it began")


def _started(reader: Reader, stated: Retiming) -> tuple[Recording, int]:
    """A recording without dates that began when the user says, and by how much its times move."""
    recording, start = reader.recording, stated.started()
    assert start is not None
    if recording.start_us is not None:
        shown = iso_time(recording.start_us, utc_offset_s(recording.timezone, recording.start_us))
        hint = "omit --start, which is for files without dates; --shift puts right a clock that was wrong"
        raise UsageError(f"says when it began, {shown}", path=recording.path, hint=hint)
    known = replace(recording, start_us=start.start_us, timezone=start.timezone or recording.timezone)
    note = STARTED.format(stated.start)
    told = replace(known, has_offsets=start.had_offset, notes=(*recording.notes, note))
    return told, start.start_us - _first_us(reader)


def _first_us(reader: Reader) -> int:
    for chunk in reader.chunks(FIRST_SAMPLES):
        if len(chunk):
            return int(chunk.clock.times(0, 1)[0])
    raise UnreadableError("holds no samples", path=reader.recording.path)


def _worn(recording: Recording, zone: str) -> tuple[Recording, int]:
    """A recording with the times of the zone in which it was worn, and by how much they move.

    Its clock runs on with the offset that its own zone had at the start; so do the times of the other.
    """
    _need_start(recording, "--worn-zone")
    there = recording.timezone
    if there is None:
        hint = "say it with --configured-zone"
        raise UsageError("does not say in which zone its clock was set", path=recording.path, hint=hint)
    start_us = recording.start_us or 0
    before_s = utc_offset_s(there, start_us) or 0
    after_s = offset_at_s(zone, start_us - before_s * MICROSECONDS)
    by_us = (after_s - before_s) * MICROSECONDS
    note = WORN.format(there=there, here=zone, hours=(after_s - before_s) / 3600)
    found = replace(_moved(recording, by_us, note), stamped=False)
    # of a local time that occurs twice, a name would stand for the first
    named = zone if utc_offset_s(zone, start_us + by_us) == after_s else _fixed(after_s)
    return replace(found, timezone=named), by_us


def _fixed(offset_s: int) -> str:
    hours, minutes = divmod(abs(offset_s) // 60, 60)
    return f"{'-' if offset_s < 0 else '+'}{hours:02d}:{minutes:02d}"
