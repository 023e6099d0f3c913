"""Listed poses and a recording's still windows brought together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import pairwise
from math import cos, radians

import numpy as np

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.fixed import to_fixed
from accelcal_cli.core.poses import FACES, Pose, Session, TimedWindows
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.poses._states import state, unit
from accelcal_cli.poses.listed import Listed, Moment

LISTED = "listed"
"""What a pose is called that is none of the six faces."""

_EPOCH = datetime(1970, 1, 1)
_MICROSECOND = timedelta(microseconds=1)


@dataclass(frozen=True, slots=True)
class Origin:
    """What the times of a list refer to.

    Attributes:
        first_us: time of the first sample on the device's clock.
        dated: whether that clock shows a date.
        offset_s: seconds that it is ahead of UTC, None where unknown.
    """

    first_us: int
    dated: bool
    offset_s: int | None


@dataclass(frozen=True, slots=True)
class Span:
    """A listed pose on the device's clock [us]."""

    start_us: int
    end_us: int
    listed: Listed


def find_listed(
    still: TimedWindows, listed: Sequence[Listed], origin: Origin, lsb_per_g: float, settings: PoseSettings
) -> Session:
    """One state a line, of the still windows that lie within its times (to half a sample).

    Raises:
        UsageError: two lines overlap, or a line's times cannot be compared with the recording's.
        DivergedError: no window within a line's times is still.
    """
    spans = _in_order([_span(item, origin) for item in listed])
    numbers = _numbers([item.listed for item in spans], settings.posture_degrees)
    local_g = settings.gravity.local_g()
    poses = []
    for span, number in zip(spans, numbers, strict=True):
        found = state(still, _within(still, span, settings), lsb_per_g)
        x, y, z = (to_fixed(value * local_g) for value in span.listed.direction)
        poses.append(Pose(_face(span.listed), number, found, (x, y, z)))
    return Session(origin.first_us, tuple(poses))


def _span(item: Listed, origin: Origin) -> Span:
    start, end = (_device_us(moment, item, origin) for moment in (item.start, item.end))
    if end <= start:
        raise item.place.wrong("ends before it starts")
    return Span(start, end, item)


def _device_us(moment: Moment, item: Listed, origin: Origin) -> int:
    """A moment on the device's clock."""
    if not isinstance(moment, datetime):
        return origin.first_us + round(moment * 1_000_000)
    if not origin.dated:
        raise item.place.wrong("the recording has no date", "write seconds from its start")
    local_us = (moment.replace(tzinfo=None) - _EPOCH) // _MICROSECOND
    zone = moment.utcoffset()
    if zone is None:
        return local_us
    if origin.offset_s is None:
        raise item.place.wrong(
            "the time has a zone, but that of the recording is not known", "give --timezone"
        )
    return local_us - zone // _MICROSECOND + origin.offset_s * 1_000_000


def _in_order(spans: Sequence[Span]) -> list[Span]:
    """Spans by time; raises UsageError where two overlap."""
    ordered = sorted(spans, key=lambda span: (span.start_us, span.end_us))
    for before, after in pairwise(ordered):
        if after.start_us < before.end_us:
            raise after.listed.place.wrong(f"overlaps line {before.listed.place.line}")
    return ordered


def _within(still: TimedWindows, span: Span, settings: PoseSettings) -> list[int]:
    slack_us = (still.end_us - still.start_us) // np.maximum(2 * still.windows.samples, 1)
    inside = (still.start_us + slack_us >= span.start_us) & (still.end_us - slack_us <= span.end_us)
    at: list[int] = np.flatnonzero(inside).tolist()
    if not at:
        raise DivergedError(
            f"no still window of {settings.segment_seconds:g} s lies within these times",
            path=span.listed.place.path,
            line=span.listed.place.line,
            hint="check the times, or give shorter windows with --segment-seconds",
        )
    return at


def _numbers(listed: Sequence[Listed], degrees: float) -> list[int]:
    """Each reference joins the first one within so many degrees."""
    directions = unit(np.array([[float(value) for value in item.direction] for item in listed]))
    leaders: list[int] = []
    numbers = []
    for index, direction in enumerate(directions):
        cosines = [float((directions[leader] * direction).sum()) for leader in leaders]
        near = next((n for n, cosine in enumerate(cosines) if cosine >= cos(radians(degrees))), len(leaders))
        leaders += [index] if near == len(leaders) else []
        numbers.append(near)
    return numbers


def _face(item: Listed) -> str:
    """The face a reference points to exactly, or LISTED."""
    turned = [axis for axis, value in enumerate(item.direction) if value]
    if len(turned) != 1:
        return LISTED
    return FACES[2 * turned[0] + (item.direction[turned[0]] < 0)]
