"""What can be wrong with log.bin and between its records, as events for the problem log."""

from __future__ import annotations

from accelcal_cli.core.recording import Problem
from accelcal_cli.readers._gt3x.framing import Damage
from accelcal_cli.readers._gt3x.member import Fault, MemberStream
from accelcal_cli.readers._pages.problems import Event

Kind = tuple[str, str]

CHECKSUM: Kind = ("checksum", "records of log.bin with a wrong checksum, left out")
NO_RECORD: Kind = ("bad_bytes", "bytes of log.bin that are no record, left out")
CUT_OFF: Kind = ("truncated", "bytes of an incomplete record at the end of log.bin, left out")
LENGTH: Kind = ("record_length", "activity records of more or less than one second")
REPEATED: Kind = ("duplicate_record", "activity records that repeat the one before, left out")
AHEAD: Kind = ("clock_gap", "jumps ahead in the times of activity records, with no sleep recorded")
BACK: Kind = ("clock_back", "steps back in the times of activity records")
RESTLESS: Kind = ("idle_unfinished", "idle sleeps whose end is not recorded, left as gaps")


def damage_event(damage: Damage, position: int, sample: int) -> Event:
    """An event for bytes that gave no record."""
    if damage.records:
        kind, count = CHECKSUM, damage.records
    else:
        kind, count = CUT_OFF if damage.cut_off else NO_RECORD, damage.size
    return Event(position, 1, *kind, damage.start_byte, sample, count, lost_bytes=damage.size)


def fault_problem(stream: MemberStream, sample: int) -> Problem | None:
    """What is wrong with a part of the zip file as a whole, once it has been read."""
    name = stream.member.name
    if stream.fault is None:
        return None
    if stream.fault is Fault.WRONG_CHECKSUM:
        text = f"the checksum of {name} in the zip file is wrong: some of its bytes are not what was written"
        return Problem("archive_checksum", text, None, sample)
    missing = (stream.member.unpacked_bytes or 0) - stream.size
    lost_bytes = max(0, missing) if stream.fault is Fault.DAMAGED else 0
    lost = f"{missing} bytes of it are missing" if missing > 0 else "how much is missing is not known"
    text = f"{name} breaks off, as {stream.fault.value}: {lost}"
    return Problem("truncated", text, stream.size, sample, max(1, missing), lost_bytes)
