"""What a wrong gravity does to the calibration of a gyroscope: the second row of Table 8 of G.

G: Grammenos, Mascolo, Crowcroft 2018.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.gravity import STANDARD_GRAVITY
from accelcal_cli.core.points import Calibration, in_standard_g
from accelcal_cli.core.rotations import Rest, RestRates, Turn, Turns
from accelcal_cli.evaluate.cases import Case, Method, Plan, as_points, make_case, measured
from accelcal_cli.judge.errors import mean
from accelcal_cli.judge.gyroscope import judge_gyroscope
from accelcal_cli.judge.turning import Gravity
from accelcal_cli.simulate import draw_gyroscope, unit

TABLE_8 = (0.2015, 0.1276)
"""Residuals with default and with local gravity, gyroscope, without a unit."""

CASES = 20
"""So many sensors at most: the angles differ by less than a thousandth from one gravity to the other."""

TURNS, TURN_ROWS, REST_ROWS = 40, 120, 500
RATE_HZ, TURNING_DPS, LSB = 100.0, 120.0, 1 << 20
"""Turns of 1.2 s, rests of 5 s; accelerations are sums of 1/2^20 g."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TurnResidual:
    """What is left after turns, by a gyroscope that was calibrated with one gravity.

    Attributes:
        assumed_m_s2: gravity that the accelerometer's fit assumes.
        holdout_deg: median angle on turns that took no part, mean over the cases; None without any.
        fitted: number of cases.
    """

    assumed_m_s2: float
    holdout_deg: float | None
    fitted: int


def turn_residuals(plan: Plan, method: Method, cases: int, seed: int) -> tuple[TurnResidual, ...]:
    """Residuals with standard and with local gravity; `plan.rest_g` is the local one."""
    kept: list[tuple[Fraction, list[float]]] = [(Fraction(1), []), (plan.rest_g, [])]
    for index in range(min(cases, CASES)):
        case = make_case(plan, seed, index)
        turns = _turns(case, plan, RandomState([seed, index]))
        for assumed_g, angles in kept:
            angles.extend(_left(method, case, assumed_g, turns))
    return tuple(_residual(assumed_g, angles) for assumed_g, angles in kept)


def _residual(assumed_g: Fraction, angles: list[float]) -> TurnResidual:
    assumed_m_s2 = round(float(assumed_g) * STANDARD_GRAVITY, 6)
    return TurnResidual(assumed_m_s2, mean(angles) if angles else None, len(angles))


def _left(method: Method, case: Case, assumed_g: Fraction, turns: Turns) -> list[float]:
    """The angle, none where a fit fails."""
    try:
        fit = method.fit(as_points(case.points.xyz_g() / float(assumed_g)))
    except DivergedError:
        return []
    calibration = Calibration(method.model.name, in_standard_g(fit.parameters, assumed_g))
    found = judge_gyroscope(turns, calibration, None)
    return [] if found.holdout is None else [found.holdout.after]


def _turns(case: Case, plan: Plan, random: RandomState) -> Turns:
    """Turns of a case's accelerometer and of a gyroscope with errors of its own."""
    sensor = draw_gyroscope(random.randint(1 << 30), 1.0, np.zeros(3))
    dps = (1 / sensor.lsb_per_dps,) * 3
    shape = np.sin(np.linspace(0, np.pi, TURN_ROWS))[:, np.newaxis]
    quiet = Rest(0, REST_ROWS, (0, 0, 0), (0, 0, 0), None)
    true, noisy = [], []
    for _ in range(TURNS):
        rates = random.standard_normal(3) * TURNING_DPS * shape
        true.append(Turn(quiet, quiet, np.rint(rates / dps[0]).astype(np.int32), 1e6 / RATE_HZ))
        noisy.append(
            true[-1].counts + np.rint(random.standard_normal(rates.shape) * sensor.noise_dps / dps[0])
        )
    start = unit(random.standard_normal((TURNS, 3)))
    end = Gravity(true, start, dps).turned(sensor.scale).direction
    rests = [[_rest(case, plan, one, random) for one in side] for side in (start, end)]
    turns = tuple(
        Turn(before, after, counts.astype(np.int32), 1e6 / RATE_HZ)
        for before, after, counts in zip(*rests, noisy, strict=True)
    )
    rates_at_rest = RestRates(np.array([REST_ROWS]), np.zeros((1, 3), np.int64), None)
    return Turns(turns, rates_at_rest, 0, dps, float(LSB), 1 / RATE_HZ)


def _rest(case: Case, plan: Plan, direction: Floats, random: RandomState) -> Rest:
    """What the accelerometer measures at rest, with the noise of the case's points."""
    raw = measured(case.truth, float(plan.rest_g) * direction[np.newaxis])[0]
    raw = raw + plan.noise_g * random.standard_normal(3)
    sums = np.rint(raw * LSB * REST_ROWS).astype(np.int64).tolist()
    return Rest(0, REST_ROWS, tuple(sums), (0, 0, 0), None)
