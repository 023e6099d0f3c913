"""The poses of a session, found among its still windows: either listed in a file, or the six faces.

Still windows of one orientation become a state, their mean in fixed-point g; a state whose true acceleration
is known is a pose. A list (`listing.py`) says when the device rested, and its true acceleration then. A
session may be in several files, such as one for each face.

Bragge et al. write z = K a + O for the output of a sensor under an acceleration a. Their K is the inverse of
this package's gain, their O the negative offset; both are in the report.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from math import cos, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import LIMIT, ONE, rounded_quotient, three, to_fixed
from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.errors import DivergedError, FixedPointOverflowError, UsageError
from accelcal_cli.core.points import Windows
from accelcal_cli.core.results import ErrorSummary
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.six_pose.listing import (
    LENGTH_TOLERANCE,
    LinePlace,
    ListedPose,
    Origin,
    Span,
    file_origins,
    span_of,
)

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
