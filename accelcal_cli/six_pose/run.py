"""Calibration from known orientations: reads a session, and reports twelve parameters.

The run is that of any recording; its judge finds the poses among the still windows and solves.

A roll with one axis level checks a calibration without any pose (Bragge et al., results). The device is
rolled along a level surface about one of its axes. That axis then measures nothing, whatever the angle, and
the others turn through +-1 g. The output of the level axis is the error that is left: its mean that of the
offset, its standard deviation that of the axes' directions (and of noise and shaking). The rows of a roll
become exact sums of their counts and of the products of these, which give the output under any calibration,
without a third reading, and the same bits however the rows were cut.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import sqrt
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.cells import CellCollector, plausible
from accelcal_cli.core.arithmetic import ONE, three
from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.clock import utc_offset_s
from accelcal_cli.core.declared import as_json, json_or_null
from accelcal_cli.core.errors import DivergedError, Reason, UnreadableError, UsageError, printable
from accelcal_cli.core.input_files import files_of, is_no_part, pattern_of
from accelcal_cli.core.local_time import NO_START
from accelcal_cli.core.paths import is_file, is_folder
from accelcal_cli.core.points import Windows
from accelcal_cli.core.recording import Chunk, PlacedFile, Recording, Validity
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.output import sections
from accelcal_cli.output.sentences import sentence
from accelcal_cli.pipeline.calibrate import Judge, RecordingRun, Survey, Verdict, open_run
from accelcal_cli.pipeline.jobs import STDIN, Job, ProgressMaker, Request, Result, no_progress, resolved_path
from accelcal_cli.pipeline.procedures import CellProcedure, Method, local_lsb_per_g
from accelcal_cli.pipeline.survey import StillWindows
from accelcal_cli.segment import chosen_rule, short_gaps, window_length
from accelcal_cli.segment.segmenter import TimedSegmenter
from accelcal_cli.six_pose.poses import (
    LinePlace,
    ListedPose,
    Origin,
    Session,
    Span,
    find_faces,
    find_listed,
    parse_moment,
    read_list,
    span_of,
)
from accelcal_cli.six_pose.solve import (
    check_range,
    fixed_gain,
    judge_six_pose,
    known_json,
    poses_json,
    six_pose_fit,
)

OPTIMIZER = {"name": "least-squares", "arithmetic": "float", "settings": {}}
AXES = "xyz"
LEAST_TURN_G = 0.3
"""Smallest standard deviation [g] of the two other axes, in the direction where it is least.

Half a turn gives 0.31 g, whole ones 0.71 g.
"""

MOST_LEVEL_G = 0.25
"""Largest standard deviation [g] of a level axis; no sensor is so skew."""

ROLL_HOW = "write --roll AXIS,START,END, such as z,80,95, or AXIS,FILE where the session is in several files"
_SPLIT = 14

Level = tuple[Fraction, Fraction, Fraction]
Products = tuple[Level, Level, Level]


def six_pose(
    job: Job, request: Request, progress: ProgressMaker = no_progress, source: Path | None = None
) -> Result:
    """Calibrate from one session, unless its report is up to date.

    Args:
        request: its settings are `PoseSettings`, and it is `report_only`.
        source: file with the recording's bytes, if it is not the job's source.

    Raises:
        DivergedError: the poses do not determine the parameters; nothing is written.
        AccelcalError: it cannot be read, or its report cannot be written.
    """
    judge = known_orientations(request)
    with open_run(job, request, progress, source) as run:
        return run.complete(judge)


def session_of(recordings: Sequence[Path], poses: Path | None = None) -> Path:
    """Return the path that stands for the recordings of a session; the list of poses may be among them.

    Raises:
        UsageError: no pattern stands for them, one of them is standard input, or the list of poses would be
            treated as one of them.
        UnreadableError: one of them is missing.
    """
    path = recordings[0]
    if len(recordings) == 1:
        path = resolved_path(path) if path.name in ("", "..") else path
    else:
        path = _pattern(recordings, poses)
    if (
        poses is not None
        and not is_no_part(poses)
        and resolved_path(poses) in map(resolved_path, files_of(path) or ())
    ):
        hint = "call it poses.csv, or keep it elsewhere"
        raise UsageError("the list of poses lies among the files of the session", path=poses, hint=hint)
    return path


def _pattern(recordings: Sequence[Path], poses: Path | None) -> Path:
    """Return the pattern that stands for several recordings."""
    if STDIN in recordings:
        raise UsageError("standard input is one recording", hint="give the names of several, or - alone")
    files = [one for one in dict.fromkeys(recordings) if not is_no_part(one)]
    for one in files:
        if not is_file(one):
            what = "is a folder" if is_folder(one) else "file not found"
            raise UnreadableError(what, path=one, hint="name the files of one session, or their folder alone")
    if poses in files:
        hint = "call it poses.csv, or keep it elsewhere"
        raise UsageError("the list of poses is named as a recording", path=poses, hint=hint)
    return pattern_of(files) if len(files) > 1 else next(iter(files), recordings[0])


def known_orientations(request: Request) -> KnownOrientations:
    """Return the judge of a session; raises UsageError for a list of poses that cannot be read."""
    assert isinstance(request.settings, PoseSettings)
    listed = () if request.poses is None else read_list(request.poses)
    rolls = rolls_of(request.settings.roll)
    return KnownOrientations(request.recording_settings, request.settings, listed, rolls)


def _origins(files: Sequence[PlacedFile], found: Survey) -> tuple[Origin, ...]:
    """Return the recording, or each file of the session, as the origin of times."""
    facts, zone = found.facts, found.recording.timezone
    if not files:
        dated = all(problem.code != NO_START for problem in facts.problems)
        return (Origin(facts.first_us or 0, dated, facts.utc_offset_s),)
    origins = []
    for one in files:
        ahead_s = utc_offset_s(zone, one.first_us - one.moved_us) if one.dated else None
        origin = Origin(
            first_us=one.first_us, dated=one.dated, offset_s=ahead_s, name=one.name, moved_us=one.moved_us,
            first_sample=one.first_sample, end_sample=one.first_sample + one.samples,
            problems=one.problems, lost_bytes=one.lost_bytes,
        )  # fmt: skip
        origins.append(origin)
    return tuple(origins)


@dataclass(frozen=True, slots=True)
class Roll:
    """A place where the device was rolled.

    Attributes:
        axis: number of the axis that was level.
        rest: the text after the axis.
    """

    axis: int
    rest: str

    @property
    def text(self) -> str:
        """The option as it was given."""
        return f"--roll {AXES[self.axis]},{self.rest}"


@dataclass(frozen=True, slots=True)
class RollFigures:
    """Figures of a roll [g].

    Attributes:
        mean_g, sd_g: mean and standard deviation of the level axis.
        length_g: root of the mean square of |a|; 1 if the device rolls evenly.
        turn_g: see LEAST_TURN_G.
    """

    mean_g: float
    sd_g: float
    length_g: float
    turn_g: float

    @property
    def level(self) -> sections.Level:
        """The figures of the level axis for the report."""
        return sections.Level(1000 * self.mean_g, 1000 * self.sd_g)


@dataclass(frozen=True, slots=True)
class RollResult:
    """The result of a roll.

    Attributes:
        file: number of its file.
        ends_us: times of its first and last row, on the device's clock.
        samples: number of rows measured in it.
        before, after: figures of the raw values, and of the calibrated ones, if there is a calibration.
    """

    axis: int
    file: int
    ends_us: tuple[int, int]
    samples: int
    before: RollFigures
    after: RollFigures | None

    def reason(self) -> Reason:
        """Return the note of a verdict on this roll."""
        after = None if self.after is None else self.after.level
        values = {"axis": AXES[self.axis], "before_mg": as_json(self.before.level)}
        return Reason("rolled", values | {"after_mg": json_or_null(after)})

    def section(self, session: Session) -> sections.Roll:
        """Return the entry of the report's `rolls`; values after a calibration are None without one."""
        before, after = self.before, self.after
        return sections.Roll(
            axis=AXES[self.axis],
            **session.place_json(self.file, *self.ends_us),
            samples=self.samples,
            level_mg=sections.LevelPair(before.level, None if after is None else after.level),
            length_g=sections.LengthPair(before.length_g, None if after is None else after.length_g),
        )


def rolls_of(texts: Iterable[str]) -> tuple[Roll, ...]:
    """Parse the values of `--roll`; raises UsageError if one names no axis, or nothing after it."""
    found = []
    for text in texts:
        axis, comma, rest = text.partition(",")
        if axis.strip().lower() not in tuple(AXES) or not comma or not rest.strip():
            raise UsageError(f"--roll {printable(text[:80])!r} names no axis and place", hint=ROLL_HOW)
        found.append(Roll(AXES.index(axis.strip().lower()), rest.strip()))
    return tuple(found)


_LEVEL = (Fraction(0),) * 3


class _Option(LinePlace):
    """The option, in the place of a line."""

    def wrong(self, message: str, hint: str | None = None) -> UsageError:
        """Return an error that names the option."""
        return UsageError(f"{printable(str(self.path))}: {message}", hint=hint)


def span_of_roll(roll: Roll, origins: Sequence[Origin]) -> Span:
    """Return the place of a roll: START,END, or FILE, or FILE,START,END.

    Raises:
        UsageError: see `span_of`; or a time cannot be read.
    """
    place = _Option(Path(roll.text), 0)
    names = [origin.name for origin in origins if origin.name is not None]
    file, times = roll.rest if names else None, roll.rest.split(",")
    if names and roll.rest not in names and len(times) > 2:
        file, times = ",".join(times[:-2]), times[-2:]
    elif names:
        times = []
    if len(times) not in (0, 2):
        raise place.wrong("has no start and end", ROLL_HOW)
    start, end = [parse_moment(one.strip(), place) for one in times] or (None, None)
    return span_of(ListedPose(place, start, end, _LEVEL, file=file), origins)


class RollSums:
    """Exact sums of the counts of rows, and of their products."""

    def __init__(self) -> None:
        self.samples = 0
        self.ends_us = (0, 0)
        self._first = [0, 0, 0]
        self._second = [[0] * 3 for _ in range(3)]

    def add(self, counts: NDArray[Any], time_us: NDArray[np.int64]) -> None:
        """Add rows (n, 3) with times (n,), in halves of 32 bits, so that no sum of products overflows."""
        self.ends_us = (self.ends_us[0] if self.samples else int(time_us[0]), int(time_us[-1]))
        wide = counts.astype(np.int64)
        high, low = wide >> _SPLIT, wide & ((1 << _SPLIT) - 1)
        self.samples += len(wide)
        for i in range(3):
            self._first[i] += int(wide[:, i].sum())
            for j in range(3):
                both = int((high[:, i] * high[:, j]).sum())
                cross = int((high[:, i] * low[:, j]).sum()) + int((low[:, i] * high[:, j]).sum())
                least = int((low[:, i] * low[:, j]).sum())
                self._second[i][j] += (both << 2 * _SPLIT) + (cross << _SPLIT) + least

    def mean_g(self, lsb_per_g: float) -> Level:
        """Return the mean of each axis [g]."""
        return three(Fraction(value, self.samples) / Fraction(lsb_per_g) for value in self._first)

    def products_g2(self, lsb_per_g: float) -> Products:
        """Return the mean products of two axes, less those of the means [g^2]."""
        mean, scale = self.mean_g(lsb_per_g), self.samples * Fraction(lsb_per_g) ** 2
        rows = [[self._second[i][j] / scale - mean[i] * mean[j] for j in range(3)] for i in range(3)]
        return three(map(three, rows))


def within(still: Windows, span: Span, origin: Origin) -> NDArray[np.bool_]:
    """Return which windows a roll reaches into."""
    assert still.start_us is not None and still.end_us is not None
    inside = (still.end_us > span.start_us) & (still.start_us < span.end_us)
    return np.asarray(inside & origin.holds(still.first_sample))


def sums_of(chunks: Iterable[Chunk], span: Span, origin: Origin) -> RollSums:
    """Return the sums of the rows measured within a span."""
    sums = RollSums()
    for chunk in chunks:
        number = np.arange(chunk.first_sample, chunk.first_sample + len(chunk))
        time_us = chunk.time_us
        inside = origin.holds(number) & (time_us >= span.start_us) & (time_us < span.end_us)
        if chunk.validity is not None:
            inside &= chunk.validity == Validity.MEASURED
        if inside.any():
            sums.add(chunk.counts[inside], time_us[inside])
    return sums


def judge_roll(
    roll: Roll, span: Span, sums: RollSums, lsb_per_g: float, calibration: Calibration | None
) -> RollResult:
    """Return the figures of a roll, before and after the calibration.

    Raises:
        DivergedError: nothing was measured there, or the device did not roll about this axis.
    """
    if not sums.samples:
        raise DivergedError(f"{printable(roll.text)}: nothing was measured there", hint="check the times")
    raw = _figures(roll.axis, sums.mean_g(lsb_per_g), sums.products_g2(lsb_per_g))
    after = None if calibration is None else _calibrated(roll.axis, sums, lsb_per_g, calibration)
    best = after or raw
    if best.turn_g < LEAST_TURN_G or best.sd_g > MOST_LEVEL_G:
        text = f"the device does not roll there by half a turn, with {AXES[roll.axis]} level"
        raise DivergedError(f"{printable(roll.text)}: {text}", hint="check the axis and the times")
    return RollResult(roll.axis, span.file, sums.ends_us, sums.samples, raw, after)


def _calibrated(axis: int, sums: RollSums, lsb_per_g: float, calibration: Calibration) -> RollFigures:
    """Return the figures for a = K (v + o), whose means and products follow from those of v."""
    gain = [[Fraction(value, ONE) for value in row] for row in fixed_gain(calibration)]
    offset = [Fraction(value, ONE) for value in calibration.parameters[6:9]]
    shifted = [value + o for value, o in zip(sums.mean_g(lsb_per_g), offset, strict=True)]
    products = sums.products_g2(lsb_per_g)
    level = three(sum((k * v for k, v in zip(row, shifted, strict=True)), Fraction(0)) for row in gain)
    half = [[_dot(row, [products[i][j] for i in range(3)]) for j in range(3)] for row in gain]
    rows = [[_dot(half[i], gain[j]) for j in range(3)] for i in range(3)]
    return _figures(axis, level, three(map(three, rows)))


def _dot(one: Sequence[Fraction], other: Sequence[Fraction]) -> Fraction:
    return sum((a * b for a, b in zip(one, other, strict=True)), Fraction(0))


def _figures(axis: int, mean: Level, products: Products) -> RollFigures:
    one, two = (other for other in range(3) if other != axis)
    length2 = sum((products[i][i] + mean[i] ** 2 for i in range(3)), Fraction(0))
    half = (products[one][one] + products[two][two]) / 2
    apart2 = ((products[one][one] - products[two][two]) / 2) ** 2 + products[one][two] ** 2
    turn2 = max(0.0, float(half) - sqrt(apart2))
    return RollFigures(float(mean[axis]), sqrt(products[axis][axis]), sqrt(length2), sqrt(turn2))


class SessionProcedure(CellProcedure):
    """Keeps all still windows with their times; the cells say which of them the device measured."""

    def __init__(self, collector: CellCollector) -> None:
        super().__init__(collector)
        self._kept = StillWindows()

    def see_still(self, windows: Windows) -> None:
        """See `CellProcedure`."""
        super().see_still(windows)
        self._kept.see_still(replace(windows, temperature_sums=None))

    def still(self) -> Windows:
        """Return all windows but those of constant values, in which the device only repeated a value."""
        still = self._kept.result()
        if self.collector.counts().constant_used:
            return still
        return still.select(still.spread.max(axis=1, initial=0) > 0)


@dataclass(frozen=True)
class KnownOrientations(Judge):
    """Finds the poses of a session and solves for twelve parameters.

    Attributes:
        poses: settings of the poses.
        listed: the listed poses; none: the six faces are looked for.
        rolls: places where the device was rolled, to check the calibration by.
    """

    revolutions: ClassVar[bool] = True

    poses: PoseSettings
    listed: Sequence[ListedPose]
    rolls: Sequence[Roll] = ()

    def method(self, recording: Recording) -> Method:
        """See `Judge`; keeps all still windows with their times."""
        rest_lsb = local_lsb_per_g(recording, self.settings)
        length = window_length(self.settings, recording.rate_hz)
        rule = chosen_rule(self.settings, recording.lsb_per_g, length)
        procedure = SessionProcedure(CellCollector(rest_lsb, self.settings, temperature=False))
        gaps = short_gaps(self.settings, length, recording.rate_hz)
        return Method(TimedSegmenter(length, rule, recording.rate_hz, gaps), procedure, rest_lsb)

    def optimizer(self) -> dict[str, Any]:
        """See `Judge`."""
        return OPTIMIZER

    def verdict(self, run: RecordingRun, found: Survey) -> Verdict:
        """Find the poses, fit, judge.

        Raises:
            DivergedError: too much is damaged, or the poses do not determine the parameters.
        """
        try:
            return self._verdict(run, found)
        except DivergedError as error:
            error.path = error.path or run.job.source
            raise

    def _verdict(self, run: RecordingRun, found: Survey) -> Verdict:
        if found.damage is not None:
            raise DivergedError(sentence(found.damage.reason))
        origins = _origins(run.reader.files, found)
        spans = [span_of_roll(roll, origins) for roll in self.rolls]
        session = self.find_poses(found, origins, spans)
        fit = six_pose_fit(session, self.poses)
        judgement, vectors = judge_six_pose(session, fit, self.poses)
        if judgement.calibration is not None:
            check_range(judgement.calibration)
        lsb_per_g, rolls = run.reader.recording.lsb_per_g, []
        for roll, span in zip(self.rolls, spans, strict=True):  # for each, the recording is read once more
            sums = sums_of(run.reader.chunks(run.request.chunk_samples), span, origins[span.file])
            rolls.append(judge_roll(roll, span, sums, lsb_per_g, judgement.calibration))
        judgement = replace(judgement, notes=tuple(one.reason() for one in rolls))
        rolled = [one.section(session) for one in rolls]
        known = known_json(session, fit, judgement.outcome, vectors, rolled)
        sections = {"poses": poses_json(session, fit), "known_orientations": known}
        return Verdict(judgement, sections, sum(pose.state.windows for pose in session.poses))

    def find_poses(self, found: Survey, origins: Sequence[Origin], rolls: Sequence[Span] = ()) -> Session:
        """Return the listed poses, or else the six faces.

        Args:
            rolls: places where the device was rolled; a slow roll may look still, but is not a pose.

        Raises:
            UsageError: the list does not fit the recording.
            DivergedError: nothing is still, or no rest under gravity.
        """
        assert isinstance(found.method.procedure, SessionProcedure)
        lsb_per_g, still = found.recording.lsb_per_g, found.method.procedure.still()
        for span in rolls:
            still = still.select(~within(still, span, origins[span.file]))
        rolled_files = [span.file for span in rolls]
        if not len(still):
            counts = found.method.segmenter.counts
            text = f"none of {counts.complete} windows of {self.poses.segment_seconds:g} s is still"
            hint = "rest the device on every face for 10 s without touching it"
            if counts.still:
                text = "every still window holds one constant value: the sensor was off or asleep"
                hint = "turn off its sleep mode"
            raise DivergedError(text, hint=hint)
        if self.listed:
            return find_listed(still, self.listed, origins, lsb_per_g, self.poses, rolled_files)
        near_1_g = plausible(still, found.method.rest_lsb, self.settings)
        if not near_1_g.any():
            hint = "check the unit with --unit and --lsb-per-g"
            raise DivergedError("still windows measure far from 1 g", hint=hint)
        return find_faces(still.select(near_1_g), origins, lsb_per_g, self.poses, rolled_files)
