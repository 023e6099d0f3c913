"""How often `calibration_error_mg.ci95` holds the true error: the figures of docs/prior.md.

    python -m tests.laboratory.coverage [SENSORS [KIND...]]

simulates sensors in the still windows of several kinds of wear, with rests that scatter as on wrists and with
rests that hardly do, and prints for each kind how often the interval holds the true error of the
coefficients. Windows are made directly, so that a hundred sensors take seconds.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace

import numpy as np

from accelcal_cli.core.calibration import IDENTITY, Calibration
from accelcal_cli.core.points import Windows
from accelcal_cli.core.recording import FLOAT_LSB_PER_G
from accelcal_cli.core.results import Judgement, Outcome
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.judge.model_ladder import Fitting
from accelcal_cli.laboratory.segments import (
    Population,
    Stillness,
    Track,
    WornSensor,
    collected,
    sphere_error_mg,
)
from accelcal_cli.pipeline.procedures import fitting
from accelcal_cli.simulate import unit

Directions = tuple[tuple[float, float, float], ...]

WRIST: Directions = (
    *((0, 0.1, -1), (-0.9, 0.2, -0.4), (0.3, -0.9, 0.3), (0.1, 0.4, 0.9)),
    *((0.8, 0.5, -0.2), (-0.3, 0.9, -0.1), (0.1, -0.2, 0.97), (-0.97, 0.1, 0.2)),
)
BED: Directions = ((0.1, 0.3, 0.95), (0.1, 0.95, 0.25), (0.1, -0.9, 0.4), (-0.5, 0.3, 0.8), (-0.6, 0.6, 0.5))
WAIST: Directions = (
    *((0.05, 0.99, 0.1), (0.05, 0.95, 0.3), (0, 0.9, -0.35), (0.1, 0.1, 0.99)),
    *((0.95, 0.1, 0.2), (-0.95, 0.1, 0.2), (0, 0.1, -0.99)),
)
ANKLE: Directions = (
    *((-0.98, 0.1, 0.1), (-0.9, 0.1, 0.4), (-0.75, 0.2, 0.6)),
    *((-0.1, 0.1, 0.98), (-0.1, 0.95, 0.2), (-0.1, -0.95, 0.3)),
)
POCKET: Directions = ((0.1, -0.97, 0.2), (0.1, 0.25, 0.96), (0.6, -0.1, 0.75))
FACES: Directions = ((0, 0, 1), (0, 0, -1), (0, 1, 0), (0, -1, 0), (1, 0, 0), (-1, 0, 0))

USUAL = Population()
FAR = Population(gain_percent=5, offset_mg=100)


@dataclass(frozen=True)
class Kind:
    """A kind of wear.

    Attributes:
        around: directions of rest; each bout is near one of them, or anywhere.
        spread: standard deviation of each component of a bout about it.
        anywhere: share of bouts in any direction.
        bouts: least and largest number of bouts, drawn evenly in its logarithm.
        faces: least and largest number of the directions that are used; 0: all.
        step_g: of the counts. slope_mg: standard deviation of the offsets' change per degree C.
        on_the_edge: all scales and offsets of a sensor are as far off as the population's are at most.
    """

    around: Directions = WRIST
    spread: float = 0.3
    anywhere: float = 0.4
    bouts: tuple[int, int] = (20, 300)
    faces: tuple[int, int] = (0, 0)
    step_g: float = 0.0
    slope_mg: float = 0.0
    people: Population = USUAL
    on_the_edge: bool = False


SHORT = Kind(anywhere=0.2, bouts=(4, 25))
IN_BED = Kind(BED, 0.15, 0.0)
KINDS = {
    "wrist, days": Kind(),
    "wrist, an hour": SHORT,
    "8 bits, 64 counts per g": Kind(step_g=1 / 64),
    "8 bits, 16 counts per g": Kind(step_g=1 / 16),
    "8 bits, 64 counts per g, bed-bound": replace(IN_BED, step_g=1 / 64),
    "temperature, no thermometer": Kind(slope_mg=0.7),
    "bed-bound": IN_BED,
    "waist": Kind(WAIST, 0.12, 0.0),
    "ankle": Kind(ANKLE, 0.12, 0.0),
    "pocket": Kind(POCKET, 0.15, 0.0),
    "on a table": Kind(FACES, 0.05, 0.0, bouts=(4, 25), faces=(3, 6)),
    "up to 5 % and 100 mg": Kind(people=FAR),
    "up to 5 % and 100 mg, an hour": replace(SHORT, people=FAR),
    "up to 5 % and 100 mg, bed-bound": replace(IN_BED, people=FAR),
    "5 % and 100 mg": Kind(people=FAR, on_the_edge=True),
    "5 % and 100 mg, an hour": replace(SHORT, people=FAR, on_the_edge=True),
    "5 % and 100 mg, bed-bound": replace(IN_BED, people=FAR, on_the_edge=True),
}


@dataclass(frozen=True)
class Case:
    """A simulated sensor: its verdict, and the true error of the candidate and of raw values [mg]."""

    verdict: Judgement
    true_mg: float
    raw_mg: float

    @property
    def usable(self) -> bool:
        return self.verdict.outcome is not Outcome.REFUSED

    @property
    def interval(self) -> tuple[float, float]:
        assert self.verdict.sphere is not None
        return self.verdict.sphere.ci95

    @property
    def fitted(self) -> bool:
        return self.usable and self.verdict.outcome is not Outcome.ALREADY_GOOD


def how() -> Fitting:
    """Return the default fitting; the ladder of models, which only compares, is left out."""
    return replace(fitting(DEFAULT), models=("0",))


def drawn(kind: Kind, random: np.random.Generator) -> WornSensor:
    people = kind.people
    if not kind.on_the_edge:
        return people.draw(random)
    gain = np.diag(1 + random.choice((-1, 1), 3) * people.gain_percent / 100)
    gain[1, 0], gain[2, 0], gain[2, 1] = random.uniform(-1, 1, 3) * people.misalignment_percent / 100
    return WornSensor(gain, random.choice((-1, 1), 3) * people.offset_mg / 1000)


def track(kind: Kind, random: np.random.Generator) -> Track:
    """Return rests in bouts of windows of 10 s, on a body that wears the device askew by some degrees."""
    number = int(np.exp(random.uniform(*np.log(kind.bouts))))
    around = unit(np.array(kind.around, float))
    askew, _ = np.linalg.qr(np.eye(3) + 0.1 * random.standard_normal((3, 3)))
    if kind.faces[1]:
        around = around[random.permutation(len(around))[: random.integers(kind.faces[0], kind.faces[1] + 1)]]
    else:
        around = around @ (askew * np.sign(np.diag(askew))).T
    bouts = unit(
        around[random.integers(len(around), size=number)] + kind.spread * random.standard_normal((number, 3))
    )
    free = random.random(number) < kind.anywhere
    bouts[free] = unit(random.standard_normal((free.sum(), 3)))
    lengths = np.clip(np.rint(8 * np.exp(random.standard_normal(number))), 1, 200).astype(int)
    bout = np.repeat(np.arange(number), lengths)
    directions = unit(bouts[bout] + 0.004 * random.standard_normal((len(bout), 3)))
    samples, places = np.full(len(bout), 1000, np.int64), np.arange(len(bout)) * 1000
    sums, spread = np.zeros((len(bout), 3), np.int64), np.ones((len(bout), 3), np.int64)
    return Track(Windows(samples, places, sums, spread), directions, bout)


def case(kind: Kind, seed: int, *, quiet: bool) -> Case:
    """Simulate one sensor; the true error is that at the mean temperature of its rests."""
    random = np.random.default_rng((77, seed))
    sensor, rests = drawn(kind, random), track(kind, random)
    people = replace(kind.people, bout_mg=0.1, window_mg=0.1) if quiet else kind.people
    raw_g = rests.worn(sensor, people, random).sums / (FLOAT_LSB_PER_G * 1000.0)
    if kind.slope_mg:
        phase = np.linspace(0, 6 * random.uniform(0.5, 3), len(raw_g)) + random.uniform(0, 6)
        warmer = 3.5 * np.sin(phase) + random.standard_normal(int(rests.bout[-1]) + 1)[rests.bout]
        slope = kind.slope_mg / 1000 * random.standard_normal(3)
        raw_g -= warmer[:, np.newaxis] * slope
        sensor = replace(sensor, offset_g=sensor.offset_g + warmer.mean() * slope)
    if kind.step_g:
        noisy = raw_g[:, np.newaxis] + 0.003 * random.standard_normal((len(raw_g), 40, 3))
        raw_g = (np.rint(noisy / kind.step_g) * kind.step_g).mean(axis=1)
    worn = replace(rests.windows, sums=np.rint(raw_g * FLOAT_LSB_PER_G * 1000).astype(np.int64))
    still = Stillness(worn, np.zeros(len(raw_g)), 0.0, float(FLOAT_LSB_PER_G), has_temperature=False)
    verdict = collected(still, np.ones(len(raw_g), np.bool_), DEFAULT).judge(how())
    found = verdict.candidate
    raw = sphere_error_mg(sensor, Calibration("0", IDENTITY))
    true = raw if found is None else sphere_error_mg(sensor, found)
    return Case(verdict, true, raw)


def cases(kind: Kind, number: int, *, quiet: bool) -> list[Case]:
    """Return the sensors for which there is a fit."""
    found = (case(kind, seed, quiet=quiet) for seed in range(number))
    return [one for one in found if one.verdict.candidate is not None]


def shares(found: list[Case]) -> tuple[float, float, float]:
    """Return the shares of the intervals of fits that hold the true error, lie below it, and above it."""
    fits = [one for one in found if one.fitted]
    below = sum(one.true_mg > one.interval[1] for one in fits) / max(1, len(fits))
    above = sum(one.true_mg < one.interval[0] for one in fits) / max(1, len(fits))
    return 1 - below - above, below, above


def row(name: str, found: list[Case]) -> str:
    """Return a row of the table."""
    holds, below, above = shares(found)
    outcomes = [str(one.verdict.outcome) for one in found]
    counts = [outcomes.count(name) for name in ("calibrated", "provisional", "already_good", "refused")]
    fits = [one for one in found if one.fitted]
    good = [one for one in found if one.true_mg < 5]
    claims = [one.verdict.sphere.mean for one in fits if one.verdict.sphere is not None]
    errors = [
        f"{np.mean(values):.2f}"
        for values in ([one.raw_mg for one in fits], [one.true_mg for one in fits], claims)
    ]
    provisional = [one for one in fits if one.verdict.outcome is Outcome.PROVISIONAL]
    better = sum(one.true_mg < one.raw_mg for one in provisional)
    cells = [
        name,
        *map(str, counts),
        *errors,
        f"{100 * holds:.0f} %",
        f"{100 * below:.0f} %",
        f"{100 * above:.0f} %",
    ]
    cells += [f"{sum(one.usable for one in good)} of {len(good)}", f"{better} of {len(provisional)}"]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    number, names = int((sys.argv[1:] or ["100"])[0]), sys.argv[2:] or list(KINDS)
    for name in names:
        for quiet in (False, True):
            shown = f"{name}, {'quiet' if quiet else 'scatter'}"
            print(row(shown, cases(KINDS[name], number, quiet=quiet)), flush=True)


if __name__ == "__main__":
    main()
