"""Where in a session a listed line lies: its file, and its times on the device's clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import did_you_mean, printable
from accelcal_cli.six_pose.listing import Listed, Moment

ALWAYS_US = 1 << 62
"""Later than any time, and before it is earlier than any."""

_EPOCH = datetime(1970, 1, 1)
_MICROSECOND = timedelta(microseconds=1)


@dataclass(frozen=True, slots=True)
class Origin:
    """A recording, or a file of a session: what the times of a list refer to.

    Attributes:
        first_us: time of the first sample on the device's clock, as it stands in the recording.
        dated: whether that clock shows a date.
        offset_s: seconds that it is ahead of UTC, None if unknown.
        name: of the file; None where the session is one recording.
        first_sample, end_sample: its samples within the recording; None: to the end.
        moved_us: what was added to the times of its clock, so that files follow one another.
        problems, lost_bytes: how much of the file is damaged.
    """

    first_us: int
    dated: bool
    offset_s: int | None
    name: str | None = None
    first_sample: int = 0
    end_sample: int | None = None
    moved_us: int = 0
    problems: int = 0
    lost_bytes: int = 0

    def holds(self, sample: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which samples are its own."""
        inside: Any = sample >= self.first_sample
        return np.asarray(inside if self.end_sample is None else inside & (sample < self.end_sample))


def named(origins: Sequence[Origin]) -> tuple[Origin, ...]:
    """Those of files; none where the session is one recording."""
    return tuple(origin for origin in origins if origin.name is not None)


@dataclass(frozen=True, slots=True)
class Span:
    """A line of a list, placed.

    Attributes:
        file: number of its file.
        start_us, end_us: on the device's clock, as in the recording.
    """

    file: int
    start_us: int
    end_us: int
    listed: Listed

    @property
    def whole(self) -> bool:
        """Whether it is all of the file."""
        return self.listed.start is None


def span_of(item: Listed, origins: Sequence[Origin]) -> Span:
    """Place a line.

    Raises:
        UsageError: its file is none of the session's, it ends before it starts, or its times cannot be
            compared with the recording's.
    """
    file = _file_of(item, origins)
    if item.start is None or item.end is None:
        return Span(file, -ALWAYS_US, ALWAYS_US, item)
    start, end = (_device_us(moment, item, origins[file]) for moment in (item.start, item.end))
    if end <= start:
        raise item.place.wrong("ends before it starts")
    return Span(file, start, end, item)


def _file_of(item: Listed, origins: Sequence[Origin]) -> int:
    names = [origin.name for origin in origins if origin.name is not None]
    if item.file is None:
        if names:
            raise item.place.wrong("names no file, but the session is in several", "add a column `file`")
        return 0
    if not names:
        hint = "leave out the column `file`, or give the folder of the files instead of a recording"
        raise item.place.wrong("names a file, but the session is one recording", hint)
    if item.file not in names:
        text = f"{printable(item.file[:80])!r} is none of the files of the session"
        raise item.place.wrong(text, did_you_mean(item.file, names) or None)
    return names.index(item.file)


def _device_us(moment: Moment, item: Listed, origin: Origin) -> int:
    if not isinstance(moment, datetime):
        return origin.first_us + round(moment * 1_000_000)
    if not origin.dated:
        raise item.place.wrong("the recording has no date", "write seconds from its start")
    local_us = (moment.replace(tzinfo=None) - _EPOCH) // _MICROSECOND + origin.moved_us
    zone = moment.utcoffset()
    if zone is None:
        return local_us
    if origin.offset_s is None:
        raise item.place.wrong(
            "the time has a zone, but that of the recording is not known", "give --timezone"
        )
    return local_us - zone // _MICROSECOND + origin.offset_s * 1_000_000
