"""The poses of a session: from its still windows, either listed in a file or the six faces.

Still windows of one orientation become a state, their mean in fixed-point g; a state whose true
acceleration is known is a pose. A list says when the device rested and what it truly measured then.

Bragge et al. write z = K a + O for what a sensor shows of an acceleration a. Their K is the inverse of this
package's gain, their O the negative offset; both are in the report.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from fractions import Fraction
from itertools import pairwise
from math import cos, isfinite, radians, sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import DivergedError, UsageError
from accelcal_cli.core.fixed import ONE, checked, rounded_quotient, to_fixed
from accelcal_cli.core.points import Calibration, Windows
from accelcal_cli.core.results import ErrorSummary
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.core.text_files import read_text

FACES = ("+x", "-x", "+y", "-y", "+z", "-z")
"""The six faces, each named by the axis that shows about +1 g or -1 g on it."""

LISTED = "listed"
"""What a pose is called that is none of the six faces."""

BETWEEN = -1
"""Instead of the index of a face."""

COLUMNS = ("start", "end", "ax", "ay", "az")
LENGTH_TOLERANCE = 0.02
LARGEST_FILE = 1 << 20
LARGEST_NUMBER = 1e9

_EPOCH = datetime(1970, 1, 1)
_MICROSECOND = timedelta(microseconds=1)

Integers3 = tuple[int, int, int]
Floats3 = tuple[float, float, float]
Matrix3 = tuple[Floats3, Floats3, Floats3]


@dataclass(frozen=True, slots=True)
class State:
    """A still stretch.

    Attributes:
        start_us, end_us: on the device's clock [us].
        windows: number of still windows that were averaged.
        raw: mean of the raw values, fixed-point g.
    """

    start_us: int
    end_us: int
    windows: int
    raw: Integers3


@dataclass(frozen=True, slots=True)
class Pose:
    """A state whose true acceleration is known.

    Attributes:
        face: one of FACES, or `listed` for another direction.
        number: states of one orientation have the same number; it is held out as a whole.
        reference: the true acceleration, fixed-point standard g.
    """

    face: str
    number: int
    state: State
    reference: Integers3


@dataclass(frozen=True, slots=True)
class Session:
    """What the stillness of a recording holds.

    Attributes:
        between: still states that lie on no face; they are not fitted.
        short: still states that are too short to count.
        first_us: time of the recording's first sample on the device's clock.
    """

    first_us: int
    poses: tuple[Pose, ...]
    between: tuple[State, ...] = ()
    short: int = 0

    @property
    def missing(self) -> tuple[str, ...]:
        """Faces without a state; none are missed where other orientations are listed."""
        faces = {pose.face for pose in self.poses}
        return () if faces - set(FACES) else tuple(face for face in FACES if face not in faces)

    @property
    def orientations(self) -> int:
        """How many different orientations there are."""
        return len({pose.number for pose in self.poses})


@dataclass(frozen=True, slots=True)
class PoseError:
    """Errors of one state [mg]; those held out are None if the others do not determine a fit.

    Attributes:
        raw, raw_norm: |v - reference| and | |v| - |reference| | of the raw mean v.
        residual, norm: the same of the calibrated mean, by the fit of all states.
        held_out, held_out_norm: the same by a fit of the other orientations.
        tilt_degrees: angle between the held-out estimate and the reference.
        repeat: distance from the mean of all states of this orientation; None for a single one.
    """

    raw: float
    raw_norm: float
    residual: float
    norm: float
    held_out: float | None
    held_out_norm: float | None
    tilt_degrees: float | None
    repeat: float | None


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Standard errors.

    Attributes:
        k, o: of K and O in z = K a + O.
        parameters: of k_xx .. oz, three slopes (0) and k_xy, k_xz, k_yz.
        worst_direction_mg: of |a|, in the worst of 26 directions (faces, edges, corners of a cube).
    """

    k: Matrix3
    o: Floats3
    parameters: tuple[float, ...]
    worst_direction_mg: float


@dataclass(frozen=True, slots=True)
class SixPoseFit:
    """Twelve parameters from known orientations, and how well they are known.

    Attributes:
        k, o: z = K a + O, in raw g per g and raw g.
        precision: their standard errors.
        condition_number: of the matrix [a 1], a in g.
        errors: one for each pose.
        between_norm_mg: mean | |a| - local g | of the states between faces, None without any.
    """

    calibration: Calibration
    k: Matrix3
    o: Floats3
    precision: Uncertainty
    condition_number: float
    errors: tuple[PoseError, ...]
    between_norm_mg: float | None


@dataclass(frozen=True, slots=True)
class VectorErrors:
    """|a - reference| of orientations held out [mg], and the largest spread of repeated ones."""

    before: ErrorSummary
    after: ErrorSummary
    repeat_spread: float | None


Moment = Fraction | datetime
"""Seconds from the first sample, or a time with or without a zone."""


@dataclass(frozen=True, slots=True)
class Place:
    """A line of a file."""

    path: Path
    line: int

    def wrong(self, message: str, hint: str | None = None) -> UsageError:
        """An error that names the line."""
        return UsageError(message, path=self.path, line=self.line, hint=hint)


@dataclass(frozen=True, slots=True)
class Listed:
    """One line: from when to when, and the direction there in units of local gravity."""

    place: Place
    start: Moment
    end: Moment
    direction: tuple[Fraction, Fraction, Fraction]


def read_list(path: Path) -> tuple[Listed, ...]:
    """Read a list of poses: a header `start,end,ax,ay,az` and a line for each pose.

    Semicolons or tabs may separate (then decimals may have commas). Empty lines and lines that begin
    with # are skipped.

    Raises:
        UsageError: with the line that is wrong.
    """
    lines = list(_lines(path))
    if not lines:
        raise UsageError("lists no poses", path=path, hint=f"write {','.join(COLUMNS)} and a line for each")
    place, header = lines[0]
    delimiter = next((mark for mark in ";\t" if mark in header), ",")
    names = [name.lower() for name in _cells(header, delimiter)]
    if sorted(names) != sorted(COLUMNS):
        raise place.wrong(f"the first line is {header[:80]!r}", f"write {','.join(COLUMNS)}")
    if not lines[1:]:
        raise place.wrong("lists no poses", "write a line for each below this one")
    return tuple(_listed(where, names, _cells(text, delimiter)) for where, text in lines[1:])


def _lines(path: Path) -> Iterator[tuple[Place, str]]:
    text = read_text(path, "the list of poses", LARGEST_FILE, "utf-8-sig")
    for number, line in enumerate(text.split("\n"), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield Place(path, number), line.strip()


def _cells(line: str, delimiter: str) -> list[str]:
    cells = [cell.strip().strip('"').strip() for cell in line.split(delimiter)]
    return cells if delimiter == "," else [cell.replace(",", ".") for cell in cells]


def _listed(place: Place, names: Sequence[str], cells: Sequence[str]) -> Listed:
    if len(cells) != len(names):
        raise place.wrong(f"has {len(cells)} values, the header {len(names)}")
    values = dict(zip(names, cells, strict=True))
    x, y, z = (_number(values[name], place) for name in ("ax", "ay", "az"))
    length = sqrt(x * x + y * y + z * z)
    if abs(length - 1) > LENGTH_TOLERANCE:
        hint = "ax, ay, az are in g: at rest their length is 1"
        raise place.wrong(f"the reference has the length {length:.4g}", hint)
    return Listed(place, _moment(values["start"], place), _moment(values["end"], place), (x, y, z))


def _number(text: str, place: Place) -> Fraction:
    try:
        value = float(text)
    except ValueError:
        raise place.wrong(f"{text[:80]!r} is not a number") from None
    if not isfinite(value) or abs(value) > LARGEST_NUMBER:
        raise place.wrong(f"{text[:80]!r} is not a usable number")
    return Fraction(repr(value))


def _moment(text: str, place: Place) -> Moment:
    """A number of seconds, or else an ISO time."""
    try:
        float(text)
    except ValueError:
        pass
    else:
        return _number(text, place)
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        wanted = "a number of seconds nor a time such as 2024-03-04T12:34:56"
        raise place.wrong(f"{text[:80]!r} is neither {wanted}") from None


def state(still: Windows, indices: list[int], lsb_per_g: float) -> State:
    """The state of the windows with these indices, which ascend.

    Raises:
        FixedPointOverflowError: its mean lies beyond 4 g.
    """
    samples = int(still.samples[indices].sum())
    sums = still.sums[indices].sum(axis=0).tolist()
    raw = _mean(sums, samples, Fraction(lsb_per_g))
    checked(np.array(raw, np.int64), "the mean of a still state")
    start_us, end_us = _times(still)
    return State(int(start_us[indices[0]]), int(end_us[indices[-1]]), len(indices), raw)


def _times(still: Windows) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    assert still.start_us is not None and still.end_us is not None
    return still.start_us, still.end_us


def _mean(sums: list[int], samples: int, lsb_per_g: Fraction) -> Integers3:
    x, y, z = (
        rounded_quotient(axis * ONE * lsb_per_g.denominator, samples * lsb_per_g.numerator) for axis in sums
    )
    return x, y, z


def unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors (m, 3) at unit length; zeros stay zeros."""
    lengths = np.sqrt((vectors * vectors).sum(axis=1, keepdims=True))
    return np.asarray(vectors / np.where(lengths == 0, 1, lengths))


@dataclass(frozen=True, slots=True)
class Origin:
    """What the times of a list refer to.

    Attributes:
        first_us: time of the first sample on the device's clock.
        dated: whether that clock shows a date.
        offset_s: seconds that it is ahead of UTC, None if unknown.
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
    still: Windows, listed: Sequence[Listed], origin: Origin, lsb_per_g: float, settings: PoseSettings
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
        rest = state(still, _within(still, span, settings), lsb_per_g)
        x, y, z = (to_fixed(value * local_g) for value in span.listed.direction)
        poses.append(Pose(_face(span.listed), number, rest, (x, y, z)))
    return Session(origin.first_us, tuple(poses))


def _span(item: Listed, origin: Origin) -> Span:
    start, end = (_device_us(moment, item, origin) for moment in (item.start, item.end))
    if end <= start:
        raise item.place.wrong("ends before it starts")
    return Span(start, end, item)


def _device_us(moment: Moment, item: Listed, origin: Origin) -> int:
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
    """Spans by time; raises UsageError if two overlap."""
    ordered = sorted(spans, key=lambda span: (span.start_us, span.end_us))
    for before, after in pairwise(ordered):
        if after.start_us < before.end_us:
            raise after.listed.place.wrong(f"overlaps line {before.listed.place.line}")
    return ordered


def _within(still: Windows, span: Span, settings: PoseSettings) -> list[int]:
    start_us, end_us = _times(still)
    slack_us = (end_us - start_us) // np.maximum(2 * still.samples, 1)
    inside = (start_us + slack_us >= span.start_us) & (end_us - slack_us <= span.end_us)
    indices: list[int] = np.flatnonzero(inside).tolist()
    if not indices:
        raise DivergedError(
            f"no still window of {settings.segment_seconds:g} s lies within these times",
            path=span.listed.place.path,
            line=span.listed.place.line,
            hint="check the times, or give shorter windows with --segment-seconds",
        )
    return indices


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


def find_faces(still: Windows, first_us: int, lsb_per_g: float, settings: PoseSettings) -> Session:
    """The states of a session, each on the face whose axis it shows most of.

    A state is a run of adjacent still windows on one face that keep within a few degrees of their
    mean: taking the device up ends it, putting it down again begins another. Its first and last
    window may hold the beginning of a movement and are left out where there are others.
    """
    directions = unit(still.sums / still.samples[:, np.newaxis])
    faces = faces_of(directions, settings.face_degrees)
    local_g = to_fixed(settings.gravity.local_g())
    shortest_us = settings.min_state_seconds * 1e6
    start_us, end_us = _times(still)
    poses, between, short = [], [], 0
    for run in runs(still, directions, faces, settings.state_degrees):
        rest = state(still, run[1:-1] if len(run) > 2 else run, lsb_per_g)
        face = int(faces[run[0]])
        if int(end_us[run[-1]] - start_us[run[0]]) < shortest_us:
            short += 1
        elif face == BETWEEN:
            between.append(rest)
        else:
            poses.append(Pose(FACES[face], face, rest, reference(face, local_g)))
    return Session(first_us, tuple(poses), tuple(between), short)


def faces_of(directions: NDArray[np.float64], degrees: float) -> NDArray[np.int64]:
    """The face (index of FACES) that each unit vector (m, 3) is near, or BETWEEN."""
    axis = np.abs(directions).argmax(axis=1)
    largest = directions[np.arange(len(directions)), axis]
    face = 2 * axis + (largest < 0)
    return np.where(np.abs(largest) >= cos(radians(degrees)), face, BETWEEN)


def runs(
    still: Windows, directions: NDArray[np.float64], faces: NDArray[np.int64], degrees: float
) -> list[list[int]]:
    """Indices of the windows of each state."""
    near = cos(radians(degrees))
    end = still.first_sample + still.samples
    states: list[list[int]] = []
    total = np.zeros(3)
    for index, direction in enumerate(directions):
        before = index - 1
        adjacent = index > 0 and still.first_sample[index] == end[before]
        if adjacent and faces[index] == faces[before] and _cosine(total, direction) >= near:
            states[-1].append(index)
            total = total + direction
        else:
            states.append([index])
            total = direction
    return states


def _cosine(total: NDArray[np.float64], direction: NDArray[np.float64]) -> float:
    return float((total * direction).sum() / np.sqrt((total * total).sum()))


def reference(face: int, local_g: int) -> Integers3:
    """What the device truly measures on a face (index of FACES), fixed-point g."""
    up = -local_g if face % 2 else local_g
    x, y, z = (up if axis == face // 2 else 0 for axis in range(3))
    return x, y, z
