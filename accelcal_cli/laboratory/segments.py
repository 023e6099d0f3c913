"""`accelcal evaluate segments`: claims of segments of a recording, held against the rest of it.

A segment of a few hours is calibrated as if it were all there is. What its report claims is then compared
with the error that the calibration leaves on the still windows of the rest of the recording, where the wrist
was in other postures too. With `--sensors`, simulated sensors with known errors are worn on the segments, and
the claim is compared with their true error.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from accelcal_cli.cli import exit_codes, options
from accelcal_cli.cli.help import Command, Named, NameValue
from accelcal_cli.cli.output import aligned, each_recording
from accelcal_cli.collect.cells import CellCollector
from accelcal_cli.collect.table import read_table, windows_of
from accelcal_cli.core.arithmetic import mean
from accelcal_cli.core.calibration import IDENTITY, Calibration
from accelcal_cli.core.errors import DivergedError, UsageError, printable
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.points import Windows
from accelcal_cli.core.recording import FLOAT_LSB_PER_G
from accelcal_cli.core.results import Judgement, Outcome
from accelcal_cli.core.settings import Settings
from accelcal_cli.judge.errors import directions
from accelcal_cli.judge.model_ladder import FEWEST_POSTURES, held_out
from accelcal_cli.output.numbers import formatted
from accelcal_cli.pipeline.jobs import ProgressMaker, no_progress
from accelcal_cli.pipeline.options import chosen_settings, read_options, recording_options
from accelcal_cli.pipeline.procedures import CellProcedure, fitting, local_lsb_per_g, make_method
from accelcal_cli.pipeline.survey import StillWindows, open_marked, survey

# Simulated sensors, with known errors, on the still windows of a real recording.
#
# The postures of a wrist, their lengths and their order are hard to simulate. They are taken from a
# recording, and only its sensor is replaced by one that is drawn, whose true error is known in every
# direction.

Floats = NDArray[np.float64]

DIRECTIONS = 1000
"""Number of evenly spread directions over which a true error is averaged."""

LOOK_AHEAD = 1024
"""Number of windows that are searched together for the end of a bout."""


@dataclass(frozen=True, slots=True)
class Population:
    """Distribution of sensors, and of rests on a wrist.

    Attributes:
        gain_percent, misalignment_percent, offset_mg: largest deviation of the entries on and below the
            diagonal of K, and of the offsets, from the ideal ones, drawn evenly.
        one_misalignment_percent: size of one of the misalignments, with either sign; None: as the others.
        bout_mg, window_mg: standard deviation of |a| from bout to bout, and from window to window within one
            (docs/prior.md has those of wrists).
    """

    gain_percent: float = 3.0
    misalignment_percent: float = 2.0
    offset_mg: float = 50.0
    one_misalignment_percent: float | None = None
    bout_mg: float = 1.8
    window_mg: float = 0.6

    def draw(self, random: np.random.Generator) -> WornSensor:
        """Draw a sensor."""
        gain = np.eye(3) + np.diag(random.uniform(-1, 1, 3)) * self.gain_percent / 100
        below = random.uniform(-1, 1, 3) * self.misalignment_percent / 100
        place, side = int(random.integers(3)), int(random.choice((-1, 1)))
        if self.one_misalignment_percent is not None:
            below[place] = side * self.one_misalignment_percent / 100
        gain[1, 0], gain[2, 0], gain[2, 1] = below
        return WornSensor(gain, random.uniform(-1, 1, 3) * self.offset_mg / 1000)


@dataclass(frozen=True, slots=True, eq=False)
class WornSensor:
    """A simulated sensor, by the coefficients that correct it: a = gain (v + offset_g).

    Attributes:
        gain: (3, 3), lower triangular.
        offset_g: (3,).
    """

    gain: Floats
    offset_g: Floats

    def raw(self, true_g: Floats) -> Floats:
        """Return the measured values (n, 3) of true accelerations [g]."""
        return np.asarray(np.linalg.solve(self.gain, true_g.T).T - self.offset_g)


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """The rests of a recording.

    Attributes:
        windows: m still windows.
        directions: (m, 3) unit vectors of the true acceleration.
        bout: (m,) number of each window's bout, a run of windows of one posture.
    """

    windows: Windows
    directions: Floats
    bout: NDArray[np.int64]

    def worn(self, sensor: WornSensor, people: Population, random: np.random.Generator) -> Windows:
        """Return the windows as a sensor would have measured them, in counts of 1/FLOAT_LSB_PER_G g."""
        bouts = random.standard_normal(int(self.bout.max(initial=-1)) + 1)
        each = random.standard_normal(len(self.bout))
        length = 1 + (people.bout_mg * bouts[self.bout] + people.window_mg * each) / 1000
        raw = sensor.raw(self.directions * length[:, np.newaxis])
        counts = raw * FLOAT_LSB_PER_G * self.windows.samples[:, np.newaxis]
        return replace(self.windows, sums=np.rint(counts).astype(np.int64))


def track(windows: Windows, raw_g: Floats, calibration: Calibration, posture_degrees: float) -> Track:
    """Return the rests of a recording whose calibration is known.

    Args:
        raw_g: (m, 3) mean of each window [g].
        posture_degrees: angle from its first window at which a bout ends.
    """
    corrected = calibration.straight(raw_g) + calibration.offset_g()
    if windows.temperature_sums is not None:
        celsius = windows.temperature_sums / (1000 * windows.samples)
        warmer = celsius - calibration.reference_c()
        corrected = corrected + warmer[:, np.newaxis] * calibration.slope_g_per_c()
    true = corrected @ calibration.gain().T
    unit = true / np.linalg.norm(true, axis=1, keepdims=True)
    return Track(windows, unit, bouts(unit, posture_degrees))


def bouts(directions: Floats, posture_degrees: float) -> NDArray[np.int64]:
    """Return the number of each window's bout, (m,), from unit vectors (m, 3)."""
    nearest = np.cos(np.radians(posture_degrees))
    number = np.zeros(len(directions), np.int64)
    start = bout = 0
    for row in range(0, len(directions), LOOK_AHEAD):
        stop = min(row + LOOK_AHEAD, len(directions))
        number[row:stop] = bout
        begin = row
        while len(away := np.flatnonzero(directions[begin:stop] @ directions[start] < nearest)):
            start = begin = begin + int(away[0])
            bout += 1
            number[start:stop] = bout
    return number


def sphere_error_mg(sensor: WornSensor, calibration: Calibration, local_g: float = 1.0) -> float:
    """Return the mean | |a| - 1 | of rest in all directions [thousandths of local gravity].

    Args:
        calibration: in standard g, at its reference temperature.
        local_g: acceleration at rest.
    """
    raw_g = calibration.straight(local_g * sensor.raw(directions(DIRECTIONS)))
    deviation = np.linalg.norm((raw_g + calibration.offset_g()) @ calibration.gain().T, axis=1) / local_g - 1
    return 1000 * float(np.abs(deviation).mean())


# `accelcal evaluate segments`.

REST = "the rest of the recording"
"""Name of the held-out data in messages."""
HOUR_S = 3600.0
USUAL = Population()


@dataclass(frozen=True, slots=True, eq=False)
class Stillness:
    """The still windows of a recording.

    Attributes:
        hours: (m,) start of each window, from the start of the recording.
        lsb_per_g: counts per local g.
    """

    windows: Windows
    hours: NDArray[np.float64]
    span_h: float
    lsb_per_g: float
    has_temperature: bool


@dataclass(frozen=True, slots=True)
class Segment:
    """One segment's claim and its true error.

    Attributes:
        hours, start_h: length, and start in the recording.
        raw_mg: error on the rest without calibration, None if there is too little of it; for a simulated
            sensor the true error over the whole sphere.
        true_mg: the same with the segment's calibration, None without one.
        claimed_mg, ci95_mg: headline of the report, and its interval; None without one.
        holdout_mg: held-out error within the segment.
        orientations: number of orientations with stillness.
        rest_scatter_mg: mean | |a| - 1 g | that the scatter of rests makes, by the report.
        sensor: number of the simulated sensor; None for the recording's own.
    """

    hours: float
    start_h: float
    outcome: str
    model: str | None
    raw_mg: float | None
    true_mg: float | None
    claimed_mg: float | None
    ci95_mg: tuple[float, float] | None
    holdout_mg: float | None
    orientations: int = 0
    rest_scatter_mg: float | None = None
    sensor: int | None = None

    @property
    def holds(self) -> bool | None:
        """True if the interval holds the true error, or with the scatter of rests is not below it.

        The error on the rest has that scatter, and may be small where the wrist was in few directions.
        """
        if self.ci95_mg is None or self.true_mg is None:
            return None
        low, high = self.ci95_mg
        if self.sensor is None:
            return self.true_mg <= high + (self.rest_scatter_mg or 0)
        return low <= self.true_mg <= high


@dataclass(frozen=True, slots=True)
class Summary:
    """Several segments together; values are None without segments to compute them from.

    Attributes:
        tried: number with stillness in two orientations or more.
        usable: number with a calibration; provisional: with one that is to be used with care.
        true_mg, raw_mg: mean error of these on the rest, with and without calibration.
        above_limit: number with an error on the rest of `max_error_mg` or more.
        worse: number with a larger error on the rest than without calibration.
        holds: share of the intervals that hold the error (`Segment.holds`).
    """

    segments: int
    tried: int
    usable: int
    provisional: int
    raw_mg: float | None
    true_mg: float | None
    claimed_mg: float | None
    above_limit: int
    worse: int
    holds: float | None


def stillness(
    path: Path,
    options: ReadOptions,
    settings: Settings,
    chunk_samples: int,
    progress: ProgressMaker = no_progress,
) -> Stillness:
    """Return all still windows of a recording.

    Raises:
        AccelcalError: it cannot be read.
    """
    with open_marked(path, recording_options(path, options)) as reader:
        recording = reader.recording
        kept = StillWindows()
        shown = progress("finding stillness", recording.total_bytes)
        segmenter = make_method(recording, settings).segmenter
        survey(reader.chunks(chunk_samples), segmenter, (kept,), shown)
        windows = kept.result()
        hours = windows.first_sample / (recording.rate_hz * HOUR_S)
        temperature = settings.temperature and recording.has_temperature
        lsb_per_g = local_lsb_per_g(recording, settings)
        return Stillness(windows, hours, float(hours.max(initial=0)), lsb_per_g, temperature)


def stillness_of_table(path: Path, settings: Settings, span_h: float) -> Stillness:
    """Return the windows of a table in the order of time, spread evenly over `span_h` hours.

    Raises:
        UnreadableError: it is not a table of points.
    """
    table = read_table(path)
    windows = windows_of(table)
    hours = windows.first_sample / max(1, len(table)) * span_h
    temperature = settings.temperature and table.temperature_mc is not None
    lsb_per_g = table.lsb_per_g * float(settings.gravity.local_g())
    return Stillness(windows, hours, span_h, lsb_per_g, temperature)


def segments(still: Stillness, hours: float, number: int, settings: Settings) -> Iterator[Segment]:
    """Judge segments of a length, at most `number` of them, evenly spread and overlapping by half at most.

    Raises:
        UsageError: the settings have a profile without orientation cells.
    """
    for start in starts(still, hours, number, settings):
        which = inside(still, start, hours)
        judgement = collected(still, which, settings).judge(fitting(settings))
        rest = collected(still, ~which, settings).result()
        errors = judgement.calibration and held_out(
            rest, judgement.calibration, settings.gravity, settings.posture_degrees, REST
        )
        raw, true = (errors.before.mean, errors.after.mean) if errors else (None, None)
        yield claimed(judgement, hours, start, raw, true)


def starts(still: Stillness, hours: float, number: int, settings: Settings) -> list[float]:
    """Return the starts of segments [h]; raises UsageError for a profile without orientation cells."""
    if settings.profile != "default":
        raise UsageError("segments are judged with --profile default only", hint="omit --profile")
    room = still.span_h - hours
    if room < 0:
        return []
    count = min(number, max(1, int(2 * room / hours) + 1))
    found: list[float] = np.linspace(0, room, count).tolist()
    return found


def inside(still: Stillness, start_h: float, hours: float) -> NDArray[np.bool_]:
    """Return which windows lie in a segment, (m,)."""
    return np.asarray((still.hours >= start_h) & (still.hours < start_h + hours))


def claimed(
    judgement: Judgement, hours: float, start_h: float, raw: float | None, true: float | None
) -> Segment:
    """Return a segment's claim, with the errors without and with its calibration."""
    calibration, sphere, holdout = judgement.calibration, judgement.sphere, judgement.holdout
    claimed, interval = None, None
    if calibration is not None and sphere is not None:
        claimed, interval = sphere.mean, sphere.ci95
    elif calibration is not None and holdout is not None:
        claimed, interval = holdout.after.mean, holdout.ci95
    return Segment(
        hours=hours,
        start_h=start_h,
        outcome=str(judgement.outcome),
        model=None if calibration is None else calibration.model,
        raw_mg=raw,
        true_mg=true,
        claimed_mg=claimed,
        ci95_mg=interval,
        holdout_mg=None if holdout is None else holdout.after.mean,
        orientations=judgement.coverage.distinct_orientations,
        rest_scatter_mg=judgement.rest_scatter_mg,
    )


def collected(still: Stillness, which: NDArray[np.bool_], settings: Settings) -> CellProcedure:
    """Return a procedure that has taken in some windows."""
    collector = CellCollector(still.lsb_per_g, settings, temperature=still.has_temperature)
    collector.add(still.windows.select(which))
    return CellProcedure(collector)


@dataclass(frozen=True, slots=True)
class Simulation:
    """Number of sensors to simulate, and the population and seed that they are drawn from."""

    sensors: int
    seed: int = 1
    population: Population = USUAL


def simulated(
    still: Stillness, places: Sequence[tuple[float, float]], settings: Settings, simulation: Simulation
) -> Iterator[Segment]:
    """Judge simulated sensors, evenly spread over the segments.

    Args:
        places: length and start of each segment [h].

    Raises:
        DivergedError: the recording has no calibration that would show its true directions.
    """
    if not places:
        return
    rests, local_g = rests_of(still, settings), float(settings.gravity.local_g())
    for number in range(simulation.sensors):
        hours, start_h = places[number * len(places) // simulation.sensors]
        random = np.random.default_rng((simulation.seed, number))
        sensor = simulation.population.draw(random)
        worn = rests.worn(sensor, simulation.population, random)
        again = replace(still, windows=worn, lsb_per_g=FLOAT_LSB_PER_G)
        judgement = collected(again, inside(still, start_h, hours), settings).judge(fitting(settings))
        raw, true = sphere_error_mg(sensor, Calibration("0", IDENTITY), local_g), None
        if (best := judgement.calibration) is not None:
            true = sphere_error_mg(sensor, best, local_g)
        yield replace(claimed(judgement, hours, start_h, raw, true), sensor=number)


def rests_of(still: Stillness, settings: Settings) -> Track:
    """Return the rests of a recording by the calibration of all of them; raises DivergedError without one."""
    every = np.ones(len(still.windows), np.bool_)
    verdict = collected(still, every, settings).judge(fitting(settings))
    calibration = verdict.calibration
    if calibration is None or verdict.outcome is Outcome.PROVISIONAL:
        raise DivergedError(
            "all of its rests give no calibration, so that their true directions are not known",
            hint="take a recording that `accelcal calibrate` calibrates",
        )
    local_g = float(settings.gravity.local_g())
    raw_g = still.windows.sums * (local_g / (still.lsb_per_g * still.windows.samples[:, np.newaxis]))
    return track(still.windows, raw_g, calibration, settings.posture_degrees)


def summary(found: list[Segment], limit_mg: float) -> Summary:
    """Sum up segments."""
    known = [(item, item.raw_mg, item.true_mg) for item in found]
    usable = [(item, raw, true) for item, raw, true in known if raw is not None and true is not None]
    outcomes = [item.outcome for item, *_ in usable]
    return Summary(
        segments=len(found),
        tried=sum(item.orientations >= FEWEST_POSTURES for item in found),
        usable=len(usable),
        provisional=outcomes.count(Outcome.PROVISIONAL),
        raw_mg=_mean([raw for _, raw, _ in usable]),
        true_mg=_mean([true for *_, true in usable]),
        claimed_mg=_mean([item.claimed_mg for item, *_ in usable]),
        above_limit=sum(true >= limit_mg for *_, true in usable),
        worse=sum(true > raw for _, raw, true in usable),
        holds=_mean([item.holds for item, *_ in usable]),
    )


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return mean(known) if known else None


FIGURES = {
    "segments": "d", "tried": "d", "usable": "d", "provisional": "d", "raw_mg": ".2f", "true_mg": ".2f",
    "claimed_mg": ".2f", "above_limit": "d", "worse": "d", "holds": ".3f",
}  # fmt: skip
"""Columns of the table and how their values are shown."""

ERRORS = {
    "gain_percent": ("Their gains differ by up to this", 20),
    "misalignment_percent": ("Their misalignments are up to this", 20),
    "offset_mg": ("Their offsets are up to this", 500),
    "one_misalignment_percent": ("One misalignment of each is this", 20),
}
"""Errors of the simulated sensors, with the largest that can be asked for."""


def known_errors() -> dict[str, Named]:
    """Return the errors of the simulated sensors that can be set, by name."""
    usual = {
        name: "as the others" if value is None else f"{value:g}" for name, value in asdict(USUAL).items()
    }
    return {
        name: Named("N", f"{text}.  [default: {usual[name]}]", options.Within(0, largest))
        for name, (text, largest) in ERRORS.items()
    }


table_hours_option = click.option(
    "--table-hours", type=options.Positive(100_000), metavar="HOURS",
    help="The files are tables of still windows in the order of time, and span HOURS.",
)  # fmt: skip


@click.command(
    "segments",
    cls=Command,
    examples=(
        "evaluate segments recording.cwa --hours 6,12,24",
        "evaluate segments points.csv --table-hours 168",
    ),
)
@click.argument("recordings", nargs=-1, required=True, type=options.FILE)
@click.option("--hours", type=options.Listed(float, 0.1, 10_000), default="3,6,12,24,48,72",
              show_default=True, help="Lengths of the segments.")  # fmt: skip
@click.option("--number", type=click.IntRange(1, 10_000), metavar="N", default=24, show_default=True,
              help="Largest number of segments of each length.")  # fmt: skip
@table_hours_option
@click.option("--sensors", type=click.IntRange(1, 100_000), metavar="N",
              help="Replay each recording's still windows through N simulated sensors with known "
                   "errors.")  # fmt: skip
@click.option("--seed", type=click.IntRange(0), metavar="N", default=1, show_default=True,
              help="Seed of these sensors.")  # fmt: skip
@click.option("--errors", type=NameValue(known_errors), multiple=True,
              help="Set an error of these sensors (--help-all lists them).")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print each segment as a JSON object on a line.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@options.laboratory_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Calibrate segments of each RECORDING, and compare their error estimates with the rest of it.

    For each length: how many segments there are, and how many have at least two orientations, a calibration,
    and a provisional one. Then, for segments with a calibration: the mean error on the rest of the recording
    without and with it, the mean that their reports claim, how many are above the limit or worse than raw
    data, and the share whose error is below the upper end of the 95 % interval plus the scatter of rests,
    which the error on the rest includes.

    With --sensors, what the sensor measured in its still windows is replaced by what simulated ones would
    have measured, each in one of the segments. The errors are then the true ones over all directions, without
    any scatter.
    """

    def work(path: Path, bars: ProgressMaker) -> tuple[str, list[Segment]]:
        chosen = chosen_settings(values)
        if values["table_hours"] is not None:
            still = stillness_of_table(path, chosen, values["table_hours"])
        else:
            still = stillness(path, read_options(values), chosen, values["chunk_samples"], bars)
        return printable(path), list(_found(still, chosen, values))

    found, code = each_recording(recordings, work, quiet=values["quiet"])
    if found:
        exit_codes.show(_shown(dict(found), chosen_settings(values), as_json=values["as_json"]))
    return code


def _found(still: Stillness, chosen: Settings, values: dict[str, Any]) -> Iterator[Segment]:
    """Judge the recording's segments, or simulated sensors in them."""
    errors = dict(values["errors"])
    if values["sensors"] is None:
        if errors:
            raise UsageError("--errors are of simulated sensors", hint="add --sensors, or omit them")
        for hours in values["hours"]:
            yield from segments(still, hours, values["number"], chosen)
        return
    places = [
        (hours, start)
        for hours in values["hours"]
        for start in starts(still, hours, values["number"], chosen)
    ]
    simulation = Simulation(values["sensors"], values["seed"], replace(USUAL, **errors))
    yield from simulated(still, places, chosen, simulation)


def _shown(results: dict[str, list[Segment]], chosen: Settings, *, as_json: bool) -> str:
    if as_json:
        return "\n".join(
            json.dumps({"recording": path, **asdict(item), "holds": item.holds})
            for path, found in results.items()
            for item in found
        )
    tables = [f"{path}\n{_table(found, chosen.max_error_mg)}" for path, found in results.items()]
    if len(results) > 1:
        every = [item for found in results.values() for item in found]
        tables.append(f"all recordings\n{_table(every, chosen.max_error_mg)}")
    return "\n\n".join(tables)


def _table(found: list[Segment], limit_mg: float) -> str:
    """Return a table with a row for each length, and one for all."""
    lengths = dict.fromkeys(item.hours for item in found)
    groups = {f"{hours:g}": [item for item in found if item.hours == hours] for hours in lengths}
    rows = []
    for name, group in {**groups, "all": found}.items():
        row = asdict(summary(group, limit_mg))
        rows.append([name, *(formatted(row[key], form) for key, form in FIGURES.items())])
    return aligned(["hours", *(key.replace("_", " ") for key in FIGURES)], rows)
