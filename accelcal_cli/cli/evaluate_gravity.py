"""`accelcal evaluate gravity`."""

from __future__ import annotations

import json
from dataclasses import asdict
from fractions import Fraction
from typing import Any

import click

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.options import METHOD, Positive, Within, gravity_options
from accelcal_cli.cli.output import aligned, figure, progress_bars
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.gravity import STANDARD_GRAVITY, standard_g
from accelcal_cli.core.version import __version__
from accelcal_cli.evaluate.cases import ALL, Plan, methods
from accelcal_cli.evaluate.gyroscope import TABLE_8 as TABLE_8_GYROSCOPE
from accelcal_cli.evaluate.gyroscope import TurnResidual, turn_residuals
from accelcal_cli.evaluate.simulation import TABLE_8, TABLE_8_GRAVITY, Residuals, gravity_residuals
from accelcal_cli.output.report import significant
from accelcal_cli.pipeline.given import gravity


@click.command("gravity")
@click.option("--local-gravity", type=Within(9.7, 9.9), metavar="M/S2",
              help=f"Gravity at rest.  [default: {TABLE_8_GRAVITY}, as in the paper]")  # fmt: skip
@gravity_options
@click.option("--cases", type=click.IntRange(1), default=500, show_default=True,
              help="How many sensors to simulate.")  # fmt: skip
@click.option("--points", type=click.IntRange(10, 8192), default=18, show_default=True,
              help="Number of calibration points, shared by nine subsets.")  # fmt: skip
@click.option("--noise-mg", type=Positive(100), default=1.0, show_default=True,
              help="Noise on each axis, standard deviation.")  # fmt: skip
@click.option("--optimizer", "label", default="fixed32", type=METHOD, show_default=True,
              metavar="NAME[:paper]",
              help="Optimizer, with the paper's settings for NAME:paper.")  # fmt: skip
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=1, show_default=True,
              help="Seed for all random numbers.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
def command(label: str, as_json: bool, **values: Any) -> None:
    """Calibrate sensors at rest in local gravity, assuming standard and then local gravity.

    Table 8 of Grammenos, Mascolo, Crowcroft 2018 (section 5.2): the residual of the cost function.
    """
    plan = Plan(values["points"], values["noise_mg"] / 1e3, rest_g=_rest_g(values))
    if label == ALL:
        raise UsageError("gravity is evaluated with one optimizer", hint="name it with --optimizer")
    (method,) = methods((label,))
    with progress_bars("gravity", quiet=values["quiet"], unit="cases") as bars:
        progress = bars("fitting", values["cases"])
        residuals = gravity_residuals(plan, method, values["cases"], values["seed"], progress)
    turned = turn_residuals(plan, method, values["cases"], values["seed"])
    if as_json:
        record = _record(plan, values, label, residuals) | {"gyroscope": _gyroscope_record(turned)}
        exit_codes.show(json.dumps(record))
    else:
        exit_codes.show(f"{_text(plan, values, residuals)}\n{_gyroscope_text(plan, turned)}")


def _rest_g(values: dict[str, Any]) -> Fraction:
    if values["local_gravity"] is not None and values["latitude"] is not None:
        raise UsageError("--local-gravity and --latitude cannot be combined", hint="give one of them")
    if values["latitude"] is not None or values["altitude_m"] is not None:
        return gravity(values).local_g()
    return standard_g(values["local_gravity"] or TABLE_8_GRAVITY)


def _record(
    plan: Plan, values: dict[str, Any], label: str, residuals: tuple[Residuals, ...]
) -> dict[str, Any]:
    fits = [
        {name: significant(value, 7 if name == "assumed_m_s2" else 4) for name, value in asdict(row).items()}
        for row in residuals
    ]
    return {
        "accelcal_version": __version__,
        "local_m_s2": round(float(plan.rest_g) * STANDARD_GRAVITY, 6),
        **{name: values[name] for name in ("cases", "points", "noise_mg", "seed")},
        "method": label,
        "published": dict(zip(("default", "local"), TABLE_8, strict=True)),
        "fits": fits,
    }


def _text(plan: Plan, values: dict[str, Any], residuals: tuple[Residuals, ...]) -> str:
    rest = float(plan.rest_g) * STANDARD_GRAVITY
    head = (
        f"{values['cases']} cases (seed {values['seed']}) of {plan.number} points, noise "
        f"{values['noise_mg']:g} mg; rest measures {rest:.5f} m/s2."
    )
    names = ("gravity assumed", "E, assumed g", "E, true g", "| |a| - g | mg", "paper's E", "failed")
    rows = []
    for row, paper in zip(residuals, TABLE_8, strict=True):
        shown = figure(row.against_assumed), figure(row.against_true), figure(row.norm_error_mg)
        known = f"{paper:.4f}" if round(rest, 6) == TABLE_8_GRAVITY else "-"
        rows.append((f"{row.assumed_m_s2:.5f} m/s2", *shown, known, str(values["cases"] - row.fitted)))
    about = (
        "E: mean of (|A|^2 - g^2)^2 over the fitted points, m4/s8; the paper does not say against which g."
    )
    return "\n".join([head, about, aligned(names, rows)])


def _gyroscope_record(turned: tuple[TurnResidual, ...]) -> dict[str, Any]:
    fits = [
        {**asdict(row), "holdout_deg": row.holdout_deg and significant(row.holdout_deg)} for row in turned
    ]
    return {"published": dict(zip(("default", "local"), TABLE_8_GYROSCOPE, strict=True)), "fits": fits}


def _gyroscope_text(plan: Plan, turned: tuple[TurnResidual, ...]) -> str:
    known = round(float(plan.rest_g) * STANDARD_GRAVITY, 6) == TABLE_8_GRAVITY
    rows = [
        (f"{row.assumed_m_s2:.5f} m/s2", figure(row.holdout_deg), f"{paper:.4f}" if known else "-")
        for row, paper in zip(turned, TABLE_8_GYROSCOPE, strict=True)
    ]
    head = f"A gyroscope, calibrated with the first {turned[0].fitted} of these accelerometers:"
    names = ("gravity assumed", "degrees off after a turn, held out", "paper's E")
    return "\n".join([head, aligned(names, rows)])
