"""The poses of a session, found among its still windows: either listed in a file, or the six faces.

Still windows of one orientation become a state, their mean in fixed-point g; a state whose true acceleration
is known is a pose. A list says when the device rested, and its true acceleration then. A
session may be in several files, such as one for each face.

Bragge et al. write z = K a + O for the output of a sensor under an acceleration a. Their K is the inverse of
this package's gain, their O the negative offset; both are in the report.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from fractions import Fraction
from itertools import pairwise
from math import cos, isfinite, radians, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import LIMIT, ONE, rounded_quotient, three, to_fixed
from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.errors import (
    DivergedError,
    FixedPointOverflowError,
    UsageError,
    did_you_mean,
    printable,
)
from accelcal_cli.core.input_files import read_text
from accelcal_cli.core.points import Windows
from accelcal_cli.core.results import ErrorSummary
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.core.vocabulary import ACCELERATION_UNITS

# The list of poses of a session: when, or in which file, the device rested, and its true acceleration
# there.
#
# References are either directions of rest, in units of local gravity, or accelerations of any size,
# as a turntable, a centrifuge or a robot arm makes them (Bragge et al., conclusions), in standard g
# or m/s2. Each line is placed in the session: in its file, at times on the device's clock.

TIMES = ("start", "end")
FILE = "file"
AXES = ("ax", "ay", "az")
UNITS = {"": Fraction(1)} | {
    unit.pose_ending: 1 / unit.per_g for unit in ACCELERATION_UNITS.values() if unit.pose_ending
}
"""Units [g] by the end of the names of the three columns; without one they hold directions of rest."""

HEADERS = "start,end,ax,ay,az"
LENGTH_TOLERANCE = 0.02
LEAST_G, LARGEST_G = 0.1, 32.0
"""Smallest and largest length [g] of an acceleration that need not be that of rest."""

LARGEST_FILE = 1 << 20
LARGEST_NUMBER = 1e9

ALWAYS_US = 1 << 62
"""Time [us] later than any; its negative is earlier than any."""

_EPOCH = datetime(1970, 1, 1)
_MICROSECOND = timedelta(microseconds=1)

Moment = Fraction | datetime
"""Seconds from the first sample, or a time with or without a zone."""

Fractions3 = tuple[Fraction, Fraction, Fraction]


@dataclass(frozen=True, slots=True)
class LinePlace:
    """A line of a file."""

    path: Path
    line: int

    def wrong(self, message: str, hint: str | None = None) -> UsageError:
        """Return an error that names the line."""
        return UsageError(message, path=self.path, line=self.line, hint=hint)


@dataclass(frozen=True, slots=True)
class ListedPose:
    """One line of the list.

    Attributes:
        start, end: times of the rest; both None: the whole file.
        reference: the true acceleration, in units of local gravity if `of_rest`, else in standard g.
        file: name of the file of the session; None if the session is one recording.
    """

    place: LinePlace
    start: Moment | None
    end: Moment | None
    reference: Fractions3
    of_rest: bool = True
    file: str | None = None

    def in_g(self, local_g: Fraction) -> Fractions3:
        """Return the reference in standard g."""
        x, y, z = self.reference
        return (x * local_g, y * local_g, z * local_g) if self.of_rest else (x, y, z)

    @property
    def length(self) -> float:
        """Length of the reference, in its unit."""
        return _length(self.reference)


def read_list(path: Path) -> tuple[ListedPose, ...]:
    """Read a list of poses: a header and a line for each pose.

    The header names the columns `start,end` or `file` or all three, and `ax,ay,az` (a direction of rest) or
    `ax_g,ay_g,az_g` or `ax_ms2,ay_ms2,az_ms2` (any acceleration). Semicolons or tabs may separate (then
    decimals may have commas). Empty lines and lines that begin with # are skipped.

    Raises:
        UsageError: with the line that is wrong.
    """
    lines = list(_lines(path))
    if not lines:
        raise UsageError("lists no poses", path=path, hint=f"write {HEADERS} and a line for each")
    place, header = lines[0]
    delimiter = next((mark for mark in ";\t" if mark in header), ",")
    names = [name.lower() for name in _cells(header, delimiter)]
    end = _unit_of(names)
    if end is None:
        hint = f"write {HEADERS} (`file` may stand for start,end; ax_g,ay_g,az_g for any acceleration)"
        raise place.wrong(f"the first line is {header[:80]!r}", hint)
    if not lines[1:]:
        raise place.wrong("lists no poses", "write a line for each below this one")
    return tuple(_listed(where, names, _cells(text, delimiter), end) for where, text in lines[1:])


def _unit_of(names: Sequence[str]) -> str | None:
    """Return the end of the acceleration columns' names; None if the columns are not those of a list."""
    for end in UNITS:
        axes = [f"{axis}{end}" for axis in AXES]
        if sorted(names) in [sorted([*place, *axes]) for place in (TIMES, (FILE,), (FILE, *TIMES))]:
            return end
    return None


def _lines(path: Path) -> Iterator[tuple[LinePlace, str]]:
    text = read_text(path, "the list of poses", LARGEST_FILE, "utf-8-sig")
    for number, line in enumerate(text.split("\n"), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield LinePlace(path, number), line.strip()


def _cells(line: str, delimiter: str) -> list[str]:
    return [cell.strip().strip('"').strip() for cell in line.split(delimiter)]


def _listed(place: LinePlace, names: Sequence[str], cells: Sequence[str], end: str) -> ListedPose:
    if len(cells) != len(names):
        raise place.wrong(f"has {len(cells)} values, the header {len(names)}")
    values = dict(zip(names, cells, strict=True))
    x, y, z = (_number(values[f"{axis}{end}"], place) * UNITS[end] for axis in AXES)
    length = _length((x, y, z))
    if not end and abs(length - 1) > LENGTH_TOLERANCE:
        hint = "ax, ay, az are in g: at rest their length is 1 (call them ax_g, ay_g, az_g if it is not)"
        raise place.wrong(f"the reference has the length {length:.4g}", hint)
    if end and not LEAST_G <= length <= LARGEST_G:
        hint = f"possible are {LEAST_G:g} to {LARGEST_G:g} g"
        raise place.wrong(f"the reference has the length {length:.4g} g", hint)
    times = [values.get(name, "") for name in TIMES]
    # A file without times is one pose.
    is_whole = FILE in values and not any(times)
    start, stop = (None if is_whole else parse_moment(text, place) for text in times)
    if FILE in values and not values[FILE]:
        raise place.wrong("names no file")
    return ListedPose(place, start, stop, (x, y, z), not end, values.get(FILE))


def _length(vector: Fractions3) -> float:
    x, y, z = vector
    return sqrt(x * x + y * y + z * z)


def _number(text: str, place: LinePlace) -> Fraction:
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        raise place.wrong(f"{text[:80]!r} is not a number") from None
    if not isfinite(value) or abs(value) > LARGEST_NUMBER:
        raise place.wrong(f"{text[:80]!r} is not a usable number")
    return Fraction(repr(value))


def parse_moment(text: str, place: LinePlace) -> Moment:
    """Parse a number of seconds, or else an ISO time.

    Raises:
        UsageError: it is neither.
    """
    try:
        float(text.replace(",", "."))
    except ValueError:
        pass
    else:
        return _number(text, place)
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        wanted = "a number of seconds nor a time such as 2024-03-04T12:34:56"
        raise place.wrong(f"{printable(text[:80])!r} is neither {wanted}") from None


@dataclass(frozen=True, slots=True)
class Origin:
    """A recording, or a file of a session, to which the times of a list refer.

    Attributes:
        first_us: time of the first sample on the device's clock, as it stands in the recording.
        dated: True if that clock shows a date.
        offset_s: seconds that it is ahead of UTC, None if unknown.
        name: name of the file; None if the session is one recording.
        first_sample, end_sample: its samples within the recording; None: to the end.
        moved_us: added to the times of its clock, so that files follow one another.
        problems, lost_bytes: extent of the damage to the file.
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
        """Return which samples are its own."""
        inside: Any = sample >= self.first_sample
        return np.asarray(inside if self.end_sample is None else inside & (sample < self.end_sample))


def file_origins(origins: Sequence[Origin]) -> tuple[Origin, ...]:
    """Return the origins that are files; none if the session is one recording."""
    return tuple(origin for origin in origins if origin.name is not None)


@dataclass(frozen=True, slots=True)
class Span:
    """The place of a line of a list.

    Attributes:
        file: number of its file.
        start_us, end_us: times on the device's clock, as in the recording.
    """

    file: int
    start_us: int
    end_us: int
    listed: ListedPose

    @property
    def whole(self) -> bool:
        """True for the whole file."""
        return self.listed.start is None


def span_of(item: ListedPose, origins: Sequence[Origin]) -> Span:
    """Return the place of a line.

    Raises:
        UsageError: its file is not in the session, it ends before it starts, or its times cannot be
            compared with the recording's.
    """
    file = _file_of(item, origins)
    if item.start is None or item.end is None:
        return Span(file, -ALWAYS_US, ALWAYS_US, item)
    start, end = (_device_us(moment, item, origins[file]) for moment in (item.start, item.end))
    if end <= start:
        raise item.place.wrong("ends before it starts")
    return Span(file, start, end, item)


def _file_of(item: ListedPose, origins: Sequence[Origin]) -> int:
    names = [origin.name for origin in origins if origin.name is not None]
    if item.file is None:
        if names:
            raise item.place.wrong("names no file, but the session is in several", "add a column `file`")
        return 0
    if not names:
        hint = "leave out the column `file`, or give the folder of the files instead of a recording"
        raise item.place.wrong("names a file, but the session is one recording", hint)
    if item.file not in names:
        text = f"{printable(item.file[:80])!r} is not a file of the session"
        raise item.place.wrong(text, did_you_mean(item.file, names) or None)
    return names.index(item.file)


def _device_us(moment: Moment, item: ListedPose, origin: Origin) -> int:
    if not isinstance(moment, datetime):
        return origin.first_us + round(moment * 1_000_000)
    if not origin.dated:
        raise item.place.wrong("the recording has no date", "write seconds from its start")
    local_us = (moment.replace(tzinfo=None) - _EPOCH) // _MICROSECOND + origin.moved_us
    zone = moment.utcoffset()
    if zone is None:
        return local_us
    if origin.offset_s is None:
        text = "the time has a zone, but that of the recording is not known"
        raise item.place.wrong(text, "give --timezone")
    return local_us - zone // _MICROSECOND + origin.offset_s * 1_000_000


# The poses of a session, found among its still windows.

FACES = ("+x", "-x", "+y", "-y", "+z", "-z")
"""The six faces, each named by the axis that shows about +1 g or -1 g on it."""

LISTED = "listed"
"""Name of a pose other than the six faces."""

BETWEEN = -1
"""Index for a direction that is near no face."""

LARGEST_MEAN_G = 64
SHOWN = 3

Integers3 = tuple[int, int, int]
Floats3 = tuple[float, float, float]
Matrix3 = tuple[Floats3, Floats3, Floats3]


@dataclass(frozen=True, slots=True)
class StillState:
    """A still stretch.

    Attributes:
        start_us, end_us: on the device's clock [us].
        windows: number of still windows that were averaged.
        raw: mean of the raw values, fixed-point g.
        file: number of its file in the session.
    """

    start_us: int
    end_us: int
    windows: int
    raw: Integers3
    file: int = 0


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
    state: StillState
    reference: Integers3


@dataclass(frozen=True, slots=True)
class Session:
    """The poses of a recording, and its other still states.

    Attributes:
        between: still states that lie on no face; they are not fitted.
        short: number of still states that are too short to count.
        first_us: time of the recording's first sample on the device's clock.
        files: the files of the session; empty if it is one recording.
    """

    first_us: int
    poses: tuple[Pose, ...]
    between: tuple[StillState, ...] = ()
    short: int = 0
    files: tuple[Origin, ...] = ()

    @property
    def missing(self) -> tuple[str, ...]:
        """Faces without a state; none if other orientations are listed."""
        faces = {pose.face for pose in self.poses}
        return () if faces - set(FACES) else tuple(face for face in FACES if face not in faces)

    @property
    def orientations(self) -> int:
        """Number of different orientations."""
        return len({pose.number for pose in self.poses})

    def seconds(self, time_us: int, file: int) -> float:
        """Return a time in seconds from the first sample, of its file if there are several."""
        first_us = self.files[file].first_us if self.files else self.first_us
        return (time_us - first_us) / 1e6

    def name(self, file: int) -> str | None:
        """Return the name of a file; None if the session is one recording."""
        return self.files[file].name if self.files else None

    def place_json(self, file: int, start_us: int, end_us: int) -> dict[str, Any]:
        """Return a stretch for the report: its file, if there are several, and seconds from its start."""
        name, times = self.name(file), {"start_s": start_us, "end_s": end_us}
        place = {key: round(self.seconds(time_us, file), 6) for key, time_us in times.items()}
        return place if name is None else {"file": name} | place


@dataclass(frozen=True, slots=True)
class PoseError:
    """Errors of one state [mg]; held-out ones are None if the other orientations do not determine a fit.

    Attributes:
        raw, raw_norm: |v - reference| and | |v| - |reference| | of the raw mean v.
        residual, norm: like these, for the mean calibrated by the fit of all states.
        held_out, held_out_norm: like these, for the mean calibrated by a fit of the other orientations.
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
        k, o: those of K and O in z = K a + O.
        parameters: those of k_xx .. oz, three slopes (0) and k_xy, k_xz, k_yz.
        worst_direction_mg: that of |a|, in the worst of 26 directions (faces, edges, corners of a cube).
    """

    k: Matrix3
    o: Floats3
    parameters: tuple[float, ...]
    worst_direction_mg: float


@dataclass(frozen=True, slots=True)
class SixPoseFit:
    """Twelve parameters from known orientations, and their errors.

    Attributes:
        k, o: z = K a + O, in raw g per g and raw g.
        precision: their standard errors; None if there are as many poses as unknowns, without residuals.
        condition_number: of the matrix [a 1], a in g.
        errors: one for each pose.
        between_norm_mg: mean | |a| - local g | of the states between faces, None without any.
        checked: True if enough orientations could be left out to judge the fit by.
    """

    calibration: Calibration
    k: Matrix3
    o: Floats3
    precision: Uncertainty | None
    condition_number: float
    errors: tuple[PoseError, ...]
    between_norm_mg: float | None
    checked: bool = True


@dataclass(frozen=True, slots=True)
class VectorErrors:
    """|a - reference| of orientations held out [mg]."""

    before: ErrorSummary
    after: ErrorSummary


def state(
    still: Windows, indices: list[int], lsb_per_g: float, file: int = 0, *, any_size: bool = False
) -> StillState:
    """Return the state of the windows with these indices, which ascend.

    Args:
        file: number of the file of the session that they are in.
        any_size: its acceleration need not be that of rest.

    Raises:
        FixedPointOverflowError: its mean lies beyond 4 g, or of any size beyond 64 g.
    """
    samples = int(still.samples[indices].sum())
    sums = still.sums[indices].sum(axis=0).tolist()
    raw = _mean(sums, samples, Fraction(lsb_per_g))
    largest = LARGEST_MEAN_G if any_size else LIMIT // ONE
    if max(map(abs, raw)) >= largest * ONE:
        text = f"the mean of a still state leaves the range of +-{largest} g"
        raise FixedPointOverflowError(text, hint="check the unit and --lsb-per-g")
    start_us, end_us = _times(still)
    return StillState(int(start_us[indices[0]]), int(end_us[indices[-1]]), len(indices), raw, file)


def _times(still: Windows) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    assert still.start_us is not None and still.end_us is not None
    return still.start_us, still.end_us


def _mean(sums: list[int], samples: int, lsb_per_g: Fraction) -> Integers3:
    scale, divisor = ONE * lsb_per_g.denominator, samples * lsb_per_g.numerator
    return three(rounded_quotient(axis * scale, divisor) for axis in sums)


def unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vectors (m, 3) at unit length; zeros stay zeros."""
    lengths = np.sqrt((vectors * vectors).sum(axis=1, keepdims=True))
    return np.asarray(vectors / np.where(lengths == 0, 1, lengths))


def find_listed(
    still: Windows,
    listed: Sequence[ListedPose],
    origins: Sequence[Origin],
    lsb_per_g: float,
    settings: PoseSettings,
    rolled_files: Collection[int] = (),
) -> Session:
    """Return one state a line: of the still windows within its times, or of the longest rest in its file.

    Windows may reach beyond the times by half a sample.

    Args:
        origins: the files of the session.
        rolled_files: numbers of the files that need not be listed.

    Raises:
        UsageError: two lines overlap, a line's times cannot be compared with the recording's, or the lines
            are not of the session's files.
        DivergedError: no window within a line's times is still.
    """
    spans = in_order([span_of(item, origins) for item in listed])
    named = {span.file for span in spans} | set(rolled_files)
    left = [origin.name for number, origin in enumerate(origins) if number not in named]
    if left and left[0] is not None:
        some = ", ".join(str(name) for name in left[:SHOWN]) + (", ..." if len(left) > SHOWN else "")
        hint = "write a line for each file of the session, or take it out of the folder"
        raise UsageError(f"does not list {some}", path=spans[0].listed.place.path, hint=hint)
    numbers = _numbers([item.listed for item in spans], settings.posture_degrees)
    local_g = settings.gravity.local_g()
    poses = []
    for span, number in zip(spans, numbers, strict=True):
        item = span.listed
        windows = _within(still, span, origins[span.file], settings)
        rest = state(still, windows, lsb_per_g, span.file, any_size=not item.of_rest)
        x, y, z = (to_fixed(value) for value in item.in_g(local_g))
        poses.append(Pose(_face(item), number, rest, (x, y, z)))
    return Session(origins[0].first_us, tuple(poses), files=file_origins(origins))


def in_order(spans: Sequence[Span]) -> list[Span]:
    """Sort spans by file and time; raises UsageError if two overlap."""
    ordered = sorted(spans, key=lambda span: (span.file, span.start_us, span.end_us))
    for before, after in pairwise(ordered):
        if after.file == before.file and after.start_us < before.end_us:
            raise after.listed.place.wrong(f"overlaps line {before.listed.place.line}")
    return ordered


def _within(still: Windows, span: Span, origin: Origin, settings: PoseSettings) -> list[int]:
    """Return the indices of the windows of a line's rest."""
    start_us, end_us = _times(still)
    slack_us = (end_us - start_us) // np.maximum(2 * still.samples, 1)
    inside = (start_us + slack_us >= span.start_us) & (end_us - slack_us <= span.end_us)
    indices: list[int] = np.flatnonzero(inside & origin.holds(still.first_sample)).tolist()
    place = span.listed.place
    if not indices:
        where = "lies within these times"
        hint = "check the times, or give shorter windows with --segment-seconds"
        if span.whole:
            where, hint = f"is in {origin.name}", "rest the device for 10 s without touching it"
        text = f"no still window of {settings.segment_seconds:g} s {where}"
        raise DivergedError(text, path=place.path, line=place.line, hint=hint)
    return _longest(still, indices, settings, place) if span.whole else indices


def _longest(still: Windows, indices: list[int], settings: PoseSettings, place: LinePlace) -> list[int]:
    """Return the longest state of a file, without its first and last window, if there are others."""
    some = still.select(np.array(indices))
    alike = np.zeros(len(some), np.int64)
    directions = unit(some.sums / some.samples[:, np.newaxis])
    run = max(runs(some, directions, alike, settings.state_degrees), key=len)
    start_us, end_us = _times(some)
    if int(end_us[run[-1]] - start_us[run[0]]) < settings.min_state_seconds * 1e6:
        text = f"the longest rest of its file is shorter than {settings.min_state_seconds:g} s"
        raise DivergedError(text, path=place.path, line=place.line, hint="rest the device for 10 s")
    return [indices[index] for index in _inner(run)]


def _inner(run: list[int]) -> list[int]:
    return run[1:-1] if len(run) > 2 else run


def _numbers(listed: Sequence[ListedPose], degrees: float) -> list[int]:
    """Number the orientations: a reference joins the first one within `degrees` and as near in length."""
    directions = unit(np.array([[float(value) for value in item.reference] for item in listed]))
    apart_g = 2 * sin(radians(degrees) / 2)
    leaders: list[int] = []
    numbers = []
    for index, direction in enumerate(directions):
        cosines = [
            float((directions[leader] * direction).sum())
            if abs(listed[leader].length - listed[index].length) <= apart_g
            else -1.0
            for leader in leaders
        ]
        near = next((n for n, cosine in enumerate(cosines) if cosine >= cos(radians(degrees))), len(leaders))
        leaders += [index] if near == len(leaders) else []
        numbers.append(near)
    return numbers


def _face(item: ListedPose) -> str:
    """Return the face that a reference points to exactly, at about 1 g; else LISTED."""
    turned = [axis for axis, value in enumerate(item.reference) if value]
    if len(turned) != 1 or abs(item.length - 1) > LENGTH_TOLERANCE:
        return LISTED
    return FACES[2 * turned[0] + (item.reference[turned[0]] < 0)]


def find_faces(
    still: Windows,
    origins: Sequence[Origin],
    lsb_per_g: float,
    settings: PoseSettings,
    rolled_files: Collection[int] = (),
) -> Session:
    """Return the states of a session, each on the face whose axis shows most of gravity.

    A state is a run of adjacent still windows on one face that keep within a few degrees of their mean:
    taking the device up ends it, putting it down again begins another, and so does another file. Its first
    and last window may hold the beginning of a movement and are left out if there are others.

    Args:
        origins: the files of the session.
        rolled_files: numbers of the files that need not hold a pose.

    Raises:
        DivergedError: another file holds none.
    """
    directions = unit(still.sums / still.samples[:, np.newaxis])
    faces = faces_of(directions, settings.face_degrees)
    firsts = np.array([origin.first_sample for origin in origins[1:]], np.int64)
    files = np.searchsorted(firsts, still.first_sample, side="right")
    local_g = to_fixed(settings.gravity.local_g())
    shortest_us = settings.min_state_seconds * 1e6
    start_us, end_us = _times(still)
    poses, between, short = [], [], 0
    for run in runs(still, directions, faces + len(FACES) * 2 * files, settings.state_degrees):
        rest = state(still, _inner(run), lsb_per_g, int(files[run[0]]))
        face = int(faces[run[0]])
        if int(end_us[run[-1]] - start_us[run[0]]) < shortest_us:
            short += 1
        elif face == BETWEEN:
            between.append(rest)
        else:
            poses.append(Pose(FACES[face], face, rest, reference(face, local_g)))
    known = {pose.state.file for pose in poses} | set(rolled_files)
    for number, origin in enumerate(origins):
        if origin.name is not None and number not in known:
            within = f"within {settings.face_degrees:g} degrees of a face"
            text = f"{origin.name}: no rest of {settings.min_state_seconds:g} s lies {within}"
            hint = "rest the device on a face in each file, or take this one out"
            raise DivergedError(text, hint=hint)
    return Session(origins[0].first_us, tuple(poses), tuple(between), short, file_origins(origins))


def faces_of(directions: NDArray[np.float64], degrees: float) -> NDArray[np.int64]:
    """Return the face (index of FACES) that each unit vector (m, 3) is near, or BETWEEN."""
    axis = np.abs(directions).argmax(axis=1)
    largest = directions[np.arange(len(directions)), axis]
    face = 2 * axis + (largest < 0)
    return np.where(np.abs(largest) >= cos(radians(degrees)), face, BETWEEN)


def runs(
    still: Windows, directions: NDArray[np.float64], faces: NDArray[np.int64], degrees: float
) -> list[list[int]]:
    """Return the indices of the windows of each state."""
    near = cos(radians(degrees))
    end = still.first_sample + still.samples
    states: list[list[int]] = []
    total = np.zeros(3)
    for index, direction in enumerate(directions):
        before = index - 1
        adjacent = index > 0 and still.first_sample[index] == end[before]
        if (
            adjacent
            and faces[index] == faces[before]
            and (total * direction).sum() / np.sqrt((total * total).sum()) >= near
        ):
            states[-1].append(index)
            total = total + direction
        else:
            states.append([index])
            total = direction
    return states


def reference(face: int, local_g: int) -> Integers3:
    """Return the true acceleration on a face (index of FACES), fixed-point g."""
    up = -local_g if face % 2 else local_g
    return three(up if axis == face // 2 else 0 for axis in range(3))
