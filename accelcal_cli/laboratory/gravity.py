"""`accelcal evaluate gravity`: what a wrong gravity does to a calibration (Table 8 of G).

G: Grammenos, Mascolo, Crowcroft 2018. The points rest at local gravity and are fitted twice, as if rest
measured standard gravity, and knowing the local one, as with `calibrate --latitude`. The paper reports "the
calibration residual error in cost function E" and does not say against which gravity: nine parameters absorb
a wrong one in the scale, so that the residual against the assumed gravity does not show it. Both are reported
here. The second row of the table is that of a gyroscope, which is calibrated with these accelerometers.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from fractions import Fraction
from itertools import starmap
from typing import Any

import click
import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.options import METHOD, Positive, Within, gravity_options
from accelcal_cli.cli.output import aligned, progress_bars
from accelcal_cli.core.arithmetic import mean
from accelcal_cli.core.calibration import Calibration, in_standard_g
from accelcal_cli.core.errors import DivergedError, UsageError, significant
from accelcal_cli.core.gravity import STANDARD_GRAVITY, standard_g
from accelcal_cli.core.gyroscope import Rest, RestRates, Turn, Turns
from accelcal_cli.core.identity import identity
from accelcal_cli.judge.errors import directions
from accelcal_cli.judge.gyroscope import TurningGravity, judge_gyroscope
from accelcal_cli.laboratory.cases import ALL, Case, CasePlan, Method, as_points, make_case, measured, methods
from accelcal_cli.output.numbers import figure
from accelcal_cli.pipeline.options import chosen_gravity
from accelcal_cli.simulate import draw_gyroscope, unit

TABLE_8 = (0.6015, 0.0090)
"""Residuals of the accelerometer with default and with local gravity, without a unit."""

TABLE_8_GRAVITY = 9.81676
"""Local gravity of Table 8 [m/s2]."""

TABLE_8_GYROSCOPE = (0.2015, 0.1276)
"""Residuals of the gyroscope with default and with local gravity, without a unit."""

CASES = 20
"""Largest number of gyroscopes, whose angles differ by less than a thousandth between gravities."""

TURNS, TURN_ROWS, REST_ROWS = 40, 120, 500
"""Number of turns, and rows of a turn (1.2 s) and of a rest (5 s)."""

RATE_HZ, TURNING_DPS, LSB = 100.0, 120.0, 1 << 20
"""Sample rate, standard deviation of the rates of a turn, and counts per g of the accelerometer."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Residuals:
    """Mean errors over the cases after fits that assume one gravity.

    Attributes:
        assumed_m_s2: gravity that the fit assumes.
        against_assumed, against_true: E = mean of (|A|^2 - g^2)^2 over the fitted points [m4/s8].
        norm_error_mg: mean error of |a| over directions of the sphere, without noise [mg].
        fitted: number of fitted cases.
    """

    assumed_m_s2: float
    against_assumed: float
    against_true: float
    norm_error_mg: float
    fitted: int


def gravity_residuals(
    plan: CasePlan, method: Method, cases: int, seed: int, progress: Callable[[int], None]
) -> tuple[Residuals, ...]:
    """Return residuals with standard and with local gravity; `plan.rest_g` is the local one.

    Raises:
        UsageError: nine subsets cannot share the plan's points.
        DivergedError: no case can be fitted.
    """
    plan.check()
    true_g = float(plan.rest_g)
    kept: list[tuple[Fraction, list[Floats]]] = [(Fraction(1), []), (plan.rest_g, [])]
    for index in range(cases):
        case = make_case(plan, seed, index)
        for assumed_g, rows in kept:
            for calibration in _fitted(method, case, assumed_g):
                fitted = _norms(calibration, case.points.xyz_g())
                exact = _norms(calibration, measured(case.truth, true_g * directions()))
                costs = [_gravity_cost(fitted, gravity_g) for gravity_g in (float(assumed_g), true_g)]
                rows.append(np.array([*costs, 1e3 * float(np.abs(exact - true_g).mean())]))
        progress(index + 1)
    if not all(rows for _, rows in kept):
        raise DivergedError("no case could be fitted")
    means = ((_m_s2(assumed_g), *np.mean(rows, axis=0).tolist(), len(rows)) for assumed_g, rows in kept)
    return tuple(starmap(Residuals, means))


def _fitted(method: Method, case: Case, assumed_g: Fraction) -> list[Calibration]:
    """Return the calibration of a case, none if the fit fails."""
    try:
        fit = method.fit(as_points(case.points.xyz_g() / float(assumed_g)))
    except DivergedError:
        return []
    return [Calibration(method.model.name, in_standard_g(fit.parameters, assumed_g))]


def _m_s2(gravity_g: Fraction) -> float:
    return round(float(gravity_g) * STANDARD_GRAVITY, 6)


def _norms(calibration: Calibration, raw_g: Floats) -> Floats:
    return np.asarray(np.linalg.norm((raw_g + calibration.offset_g()) @ calibration.gain().T, axis=1))


def _gravity_cost(norms_g: Floats, gravity_g: float) -> float:
    """Return E of G eq. 5 [m4/s8] of norms and gravity in standard g."""
    return float(((norms_g**2 - gravity_g**2) ** 2).mean()) * STANDARD_GRAVITY**4


@dataclass(frozen=True, slots=True)
class TurnResidual:
    """Errors after turns, with gyroscopes that were calibrated with one gravity.

    Attributes:
        assumed_m_s2: gravity that the accelerometer's fit assumes.
        holdout_deg: median angle on held-out turns, mean over the cases; None without any.
        fitted: number of fitted cases.
    """

    assumed_m_s2: float
    holdout_deg: float | None
    fitted: int


def turn_residuals(plan: CasePlan, method: Method, cases: int, seed: int) -> tuple[TurnResidual, ...]:
    """Return residuals with standard and with local gravity; `plan.rest_g` is the local one."""
    kept: list[tuple[Fraction, list[float]]] = [(Fraction(1), []), (plan.rest_g, [])]
    for index in range(min(cases, CASES)):
        case = make_case(plan, seed, index)
        turns = _turns(case, plan, RandomState([seed, index]))
        for assumed_g, angles in kept:
            for calibration in _fitted(method, case, assumed_g):
                holdout = judge_gyroscope(turns, calibration, None).holdout
                if holdout is not None:
                    angles.append(holdout.after)
    return tuple(
        TurnResidual(_m_s2(assumed_g), mean(angles) if angles else None, len(angles))
        for assumed_g, angles in kept
    )


def _turns(case: Case, plan: CasePlan, random: RandomState) -> Turns:
    """Simulate turns of a case's accelerometer and of a gyroscope with errors of its own."""
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
    end = TurningGravity(true, start, dps).turned(sensor.scale).direction
    rests = [[_rest(case, plan, one, random) for one in side] for side in (start, end)]
    turns = tuple(
        Turn(before, after, counts.astype(np.int32), 1e6 / RATE_HZ)
        for before, after, counts in zip(*rests, noisy, strict=True)
    )
    rates_at_rest = RestRates(np.array([REST_ROWS]), np.zeros((1, 3), np.int64), None)
    return Turns(turns, rates_at_rest, 0, dps, float(LSB), 1 / RATE_HZ)


def _rest(case: Case, plan: CasePlan, direction: Floats, random: RandomState) -> Rest:
    """Return the accelerometer's measurement at rest, with the noise of the case's points."""
    raw = measured(case.truth, float(plan.rest_g) * direction[np.newaxis])[0]
    raw = raw + plan.noise_g * random.standard_normal(3)
    sums = np.rint(raw * LSB * REST_ROWS).astype(np.int64).tolist()
    return Rest(0, REST_ROWS, tuple(sums), (0, 0, 0), None)


@click.command(
    "gravity",
    cls=Command,
    examples=("evaluate gravity --latitude 52.5", "evaluate gravity --cases 50 --json"),
)
@click.option("--local-gravity", type=Within(9.7, 9.9), metavar="M/S2",
              help=f"Gravity at rest.  [default: {TABLE_8_GRAVITY}, as in the paper]")  # fmt: skip
@gravity_options
@click.option("--cases", type=click.IntRange(1), metavar="N", default=500, show_default=True,
              help="How many sensors to simulate.")  # fmt: skip
@click.option("--points", type=click.IntRange(10, 8192), metavar="N", default=18, show_default=True,
              help="Number of calibration points, shared by nine subsets.")  # fmt: skip
@click.option("--noise-mg", type=Positive(100), default=1.0, show_default=True,
              help="Noise on each axis, standard deviation.")  # fmt: skip
@click.option("--optimizer", "label", default="fixed32", type=METHOD, show_default=True,
              metavar="NAME[:paper]",
              help="Optimizer, with the paper's settings for NAME:paper.")  # fmt: skip
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), metavar="N", default=1, show_default=True,
              help="Seed for all random numbers.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
def command(label: str, as_json: bool, **values: Any) -> None:
    """Calibrate sensors at rest in local gravity, assuming standard and then local gravity.

    Table 8 of Grammenos, Mascolo, Crowcroft 2018 (section 5.2): the residual of the cost function.
    """
    rest_g = standard_g(values["local_gravity"] or TABLE_8_GRAVITY)
    if values["latitude"] is not None or values["altitude_m"] is not None:
        if values["local_gravity"] is not None and values["latitude"] is not None:
            raise UsageError("--local-gravity and --latitude cannot be combined", hint="give one of them")
        rest_g = chosen_gravity(values).local_g()
    plan = CasePlan(values["points"], values["noise_mg"] / 1e3, rest_g=rest_g)
    if label == ALL:
        raise UsageError("gravity is evaluated with one optimizer", hint="name it with --optimizer")
    (method,) = methods((label,))
    with progress_bars("gravity", quiet=values["quiet"], unit="cases") as bars:
        progress = bars("fitting", values["cases"])
        residuals = gravity_residuals(plan, method, values["cases"], values["seed"], progress)
    turned = turn_residuals(plan, method, values["cases"], values["seed"])
    if as_json:
        exit_codes.show(json.dumps(_record(plan, values, label, residuals, turned)))
    else:
        exit_codes.show(_text(plan, values, residuals, turned))


def _record(
    plan: CasePlan,
    values: dict[str, Any],
    label: str,
    residuals: tuple[Residuals, ...],
    turned: tuple[TurnResidual, ...],
) -> dict[str, Any]:
    fits = [
        {name: significant(value, 7 if name == "assumed_m_s2" else 4) for name, value in asdict(row).items()}
        for row in residuals
    ]
    angles = [
        {**asdict(row), "holdout_deg": row.holdout_deg and significant(row.holdout_deg)} for row in turned
    ]
    return {
        **identity("gravity"),
        "local_m_s2": _m_s2(plan.rest_g),
        **{name: values[name] for name in ("cases", "points", "noise_mg", "seed")},
        "method": label,
        "published": dict(zip(("default", "local"), TABLE_8, strict=True)),
        "fits": fits,
        "gyroscope": {
            "published": dict(zip(("default", "local"), TABLE_8_GYROSCOPE, strict=True)),
            "fits": angles,
        },
    }


def _text(
    plan: CasePlan, values: dict[str, Any], residuals: tuple[Residuals, ...], turned: tuple[TurnResidual, ...]
) -> str:
    rest = float(plan.rest_g) * STANDARD_GRAVITY
    known = [
        [f"{paper:.4f}" if round(rest, 6) == TABLE_8_GRAVITY else "-" for paper in papers]
        for papers in (TABLE_8, TABLE_8_GYROSCOPE)
    ]
    names = ("gravity assumed", "E, assumed g", "E, true g", "| |a| - g | mg", "paper's E", "failed")
    rows = []
    for row, paper in zip(residuals, known[0], strict=True):
        shown = figure(row.against_assumed), figure(row.against_true), figure(row.norm_error_mg)
        rows.append((f"{row.assumed_m_s2:.5f} m/s2", *shown, paper, str(values["cases"] - row.fitted)))
    turns = [
        (f"{row.assumed_m_s2:.5f} m/s2", figure(row.holdout_deg), paper)
        for row, paper in zip(turned, known[1], strict=True)
    ]
    return "\n".join(
        [
            f"{values['cases']} cases (seed {values['seed']}) of {plan.number} points, noise "
            f"{values['noise_mg']:g} mg; rest measures {rest:.5f} m/s2.",
            "E: mean of (|A|^2 - g^2)^2 over the fitted points, m4/s8; "
            "the paper does not say against which g.",
            aligned(names, rows),
            f"A gyroscope, calibrated with the first {turned[0].fitted} of these accelerometers:",
            aligned(("gravity assumed", "degrees off after a turn, held out", "paper's E"), turns),
        ]
    )
