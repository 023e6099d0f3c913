"""What `--prior study` and `--prior device` are worth: the figures of `docs/prior.md`.

    python tools/compare_priors.py [FLEETS [FIRST_SEED]]

draws fleets of devices with short recordings of few postures, calibrates each with the prior of the
population and with what the others say, and prints the mean error over the sphere and how often the interval
holds it. Points are made directly, so that hundreds of recordings take minutes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.points import WEIGHT_ONE, PointSet
from accelcal_cli.core.prior import LearntPrior
from accelcal_cli.core.results import Judgement
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.judge.verdict import judge
from accelcal_cli.output.report import significant
from accelcal_cli.pipeline.procedures import fitting
from accelcal_cli.studies.other_recordings import Learning
from accelcal_cli.studies.summary import PARAMETERS

BEGIN = datetime(2025, 3, 3, 18)
DEVICES, MONTHS = 12, 6
SCATTER_G, NOISE_G = 0.0015, 0.0003
PRIORS = ("population", "study", "device")
Parameters = np.ndarray
"""Nine: K below and on its diagonal, offsets [g]."""


@dataclass(frozen=True)
class Kind:
    """Devices of one model; the last one of a fleet may be unlike the others.

    Attributes:
        spread: standard deviations of scale, misalignment and offset [g].
        walk: of a month's change of the same.
        odd: what is added to the last device's parameters.
        step_g: by how much the last device's offsets step half way.
    """

    name: str
    centre: tuple[float, float, float]
    spread: tuple[float, float, float]
    walk: tuple[float, float, float] = (0.0003, 0.0, 0.0007)
    odd: tuple[float, float, float] = (0.0, 0.0, 0.0)
    step_g: float = 0.0


ALIKE = ((0.008, 0.0, 0.03), (0.003, 0.002, 0.004))
KINDS = (
    Kind("alike, +30 mg", *ALIKE),
    Kind("like all sensors", (0.0, 0.0, 0.0), (0.02, 0.013, 0.035)),
    Kind("one is odd: 5 %, 100 mg", *ALIKE, odd=(0.0, 0.05, 0.1)),
    Kind("one steps by 60 mg", *ALIKE, step_g=0.06),
)


def spread(values: tuple[float, float, float]) -> Parameters:
    """Of nine parameters, from those of the three kinds."""
    return np.repeat(values, 3)


def rest(sensor: Parameters, number: int, random: np.random.RandomState) -> PointSet:
    """Postures on one side of the sphere as the sensor measures them."""
    lean, poses = random.standard_normal(3), []
    while len(poses) < number:
        pose = random.standard_normal(3)
        pose /= np.sqrt(pose @ pose)
        if pose @ lean > -0.3:
            poses.append(pose)
    scatter = 1 + SCATTER_G * random.standard_normal((number, 1))
    raw = measured(sensor, np.array(poses) * scatter) + NOISE_G * random.standard_normal((number, 3))
    ones = np.ones(number, np.int64)
    return PointSet(np.rint(raw * ONE).astype(np.int64), ones * WEIGHT_ONE, ones)


def gain(p: Parameters) -> np.ndarray:
    """K."""
    return np.array([[p[0], 0, 0], [p[3], p[1], 0], [p[4], p[5], p[2]]])


def measured(sensor: Parameters, true: np.ndarray) -> np.ndarray:
    """Raw values of true accelerations, (n, 3)."""
    return true @ np.linalg.inv(gain(sensor)).T - sensor[6:9]


def error_mg(sensor: Parameters, found: Parameters) -> float:
    """Mean | |a| - 1 g | over the sphere, without the scatter of postures."""
    true = np.random.RandomState(1).standard_normal((4000, 3))
    true /= np.sqrt((true * true).sum(axis=1))[:, None]
    a = (measured(sensor, true) + found[6:9]) @ gain(found).T
    return float(1000 * np.abs(np.sqrt((a * a).sum(axis=1)) - 1).mean())


def judged(points: PointSet, learnt: LearntPrior | None) -> Judgement:
    """The verdict; the ladder of models, which only compares, is left out."""
    settings = DEFAULT if learnt is None else replace(DEFAULT, prior=learnt.kind)
    how = fitting(settings, None if learnt is None else learnt.prior)
    return judge(points, replace(how, models=("0",)))


def row(verdict: Judgement, name: str, serial: str, month: int) -> dict[str, Any]:
    """What a study's table would say of a recording."""
    start = BEGIN + timedelta(days=month * 365.25 / 12)
    known = {
        "device_serial": serial,
        "device_model": "M1",
        "lsb_per_g": 256.0,
        "range_g": 8.0,
        "sha256": name,
    }
    known |= {
        "start_time": start.isoformat(),
        "duration_s": 3600.0,
        "outcome": verdict.outcome,
        "change": None,
    }
    known |= {"reference_c": None, "calibration_error_high_mg": verdict.sphere and verdict.sphere.ci95[1]}
    known |= dict.fromkeys([*PARAMETERS, *(f"se_{name}" for name in PARAMETERS)])
    if verdict.calibration is not None and verdict.standard_errors is not None:
        for index, column in enumerate(PARAMETERS[:9]):
            known[column] = verdict.calibration.parameters[index] / ONE
            known[f"se_{column}"] = significant(verdict.standard_errors[index])
    return known


@dataclass(frozen=True)
class Scored:
    """A recording with a prior: true error of the fit, whether its interval holds it, and the outcome."""

    error_mg: float
    low_mg: float
    high_mg: float
    calibrated: bool
    last: bool


def fleet(kind: Kind, seed: int) -> dict[str, list[Scored]]:
    """All recordings of a fleet, by prior, in one order."""
    random = np.random.RandomState(seed)
    sensors, points = {}, {}
    for device in range(DEVICES):
        sensor = (
            np.repeat([1.0, 0, 0], 3) + spread(kind.centre) + spread(kind.spread) * random.standard_normal(9)
        )
        last = device == DEVICES - 1
        sensor = sensor + last * spread(kind.odd)
        for month in range(MONTHS):
            if last and month == MONTHS // 2:
                sensor = sensor + spread((0.0, 0.0, kind.step_g))
            sensors[device, month] = sensor
            points[device, month] = rest(sensor, 5 + month % 3 * 3, random)
            sensor = sensor + spread(kind.walk) * random.standard_normal(9)
    first = {key: judged(held, None) for key, held in points.items()}
    rows = {f"{key[0]}-{key[1]}": row(first[key], f"{key}", str(key[0]), key[1]) for key in points}
    learning = Learning(rows, DEFAULT.max_error_mg)

    def again(prior: str) -> Callable[[tuple[int, int]], Judgement]:
        def one(key: tuple[int, int]) -> Judgement:
            learnt = None if prior == PRIORS[0] else learning.prior(f"{key[0]}-{key[1]}", prior)
            verdict = first[key] if learnt is None else judged(points[key], learnt)
            lost = first[key].calibration is not None and verdict.calibration is None
            return first[key] if verdict.unlike or lost else verdict

        return one

    return {prior: [scored(again(prior)(key), sensors[key], key) for key in points] for prior in PRIORS}


def scored(verdict: Judgement, sensor: Parameters, key: tuple[int, int]) -> Scored:
    """A verdict held against the truth; of a refusal what was refused."""
    assert verdict.candidate is not None and verdict.sphere is not None
    kept = verdict.calibration or verdict.candidate
    found = np.array(kept.parameters[:9]) / ONE
    low, high = verdict.sphere.ci95
    return Scored(error_mg(sensor, found), low, high, verdict.calibration is not None, key[0] == DEVICES - 1)


HEAD = ("recordings of", "prior", "number", "calibrated", "error mg", "high end mg", "holds %", "above %")
WIDTHS = (26, 11, 7, 11, 9, 12, 8, 8)


def show(cells: tuple[object, ...]) -> None:
    """Print a line of the table."""
    first, second, *numbers = cells
    figures = (f"{cell:>{width}}" for cell, width in zip(numbers, WIDTHS[2:], strict=True))
    print(f"{first:<{WIDTHS[0]}}{second:<{WIDTHS[1]}}{''.join(figures)}", flush=True)


def main(fleets: int, seed: int) -> None:
    """Print the table; where one device is unlike the others, of that one alone."""
    show(HEAD)
    for kind in KINDS:
        found = [fleet(kind, seed + number) for number in range(fleets)]
        unlike = bool(any(kind.odd) or kind.step_g)
        for prior in PRIORS:
            mine = [one for held in found for one in held[prior] if one.last or not unlike]
            holds = [one.low_mg <= one.error_mg <= one.high_mg for one in mine]
            above = [one.error_mg > one.high_mg for one in mine]
            error_mg, high_mg = (
                np.mean([getattr(one, name) for one in mine]) for name in ("error_mg", "high_mg")
            )
            shares = (f"{100 * np.mean(which):.1f}" for which in (holds, above))
            number = sum(one.calibrated for one in mine)
            show((kind.name, prior, len(mine), number, f"{error_mg:.2f}", f"{high_mg:.1f}", *shares))


if __name__ == "__main__":
    numbers = [int(word) for word in sys.argv[1:]]
    main(*(*numbers, *(4, 1)[len(numbers) :]))
