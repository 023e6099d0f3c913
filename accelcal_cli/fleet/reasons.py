"""Why a device should be serviced."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from statistics import median

from accelcal_cli.fleet.parameters import PARAMETERS, with_error
from accelcal_cli.fleet.rules import (
    FEWEST_DEVICES,
    LEAST_SPREAD_MG,
    PERHAPS,
    REPEATED,
    SIGNIFICANT,
    Rules,
)
from accelcal_cli.fleet.unit import Reason, Unit
from accelcal_cli.fleet.use import OWN


@dataclass(frozen=True, slots=True)
class Kin:
    """Devices of one kind (model and format).

    Attributes:
        devices: those with a held-out error.
        held_out_mg: median of theirs; None where there are none.
        spread_mg: 1.4826 times the median distance from it, which is a standard deviation of normal ones.
        recordings, refused, damaged: of all devices of the kind.
    """

    devices: int
    held_out_mg: float | None
    spread_mg: float
    recordings: int
    refused: int
    damaged: int


def kin(units: Iterable[Unit]) -> Kin:
    """What is usual among devices."""
    units = list(units)
    errors = [unit.held_out_mg for unit in units if unit.held_out_mg is not None]
    centre = median(errors) if errors else None
    spread = 0.0 if centre is None else 1.4826 * median(abs(error - centre) for error in errors)
    return Kin(
        len(errors),
        centre,
        spread,
        sum(unit.recordings for unit in units),
        sum(unit.refused for unit in units),
        sum(unit.damaged for unit in units),
    )


def reasons(unit: Unit, others: Kin, rules: Rules) -> tuple[Reason, ...]:
    """All of a device, the certain ones first, of each rule the worst first.

    Args:
        others: its kind, itself included.
    """
    found = [*_drifts(unit, rules), *_levels(unit, rules), *_outlying(unit, others, rules)]
    found += _refused(unit, others, rules)
    found += _damaged(unit, others, rules)
    return tuple(sorted(found, key=lambda one: not one.certain))


def _drifts(unit: Unit, rules: Rules) -> Iterator[Reason]:
    limits = dict(zip(PARAMETERS, rules.drifts().tolist(), strict=True))
    found = [(trend, trend.drift) for trend in unit.trends if trend.drift is not None]
    for trend, drift in sorted(found, key=lambda one: -abs(one[1].per_month) / limits[one[0].parameter]):
        size = abs(drift.per_month)
        if size > limits[trend.parameter] and drift.probability < PERHAPS:
            shown = f"{with_error(drift.per_month, drift.error)} {trend.parameter.unit}"
            text = f"{trend.parameter.label} drifts by {shown} a month"
            doubt = "" if drift.significant else f" (not certain from {trend.number} recordings)"
            yield Reason("drift", text + doubt, drift.significant)


def _levels(device: Unit, rules: Rules) -> Iterator[Reason]:
    limits = dict(zip(PARAMETERS, rules.levels().tolist(), strict=True))
    for trend in sorted(device.trends, key=lambda one: -abs(one.value) / limits[one.parameter]):
        beyond = abs(trend.value) - limits[trend.parameter]
        if beyond > 0:
            unit = trend.parameter.unit
            limit = f"limit {limits[trend.parameter]:g} {unit}"
            text = f"{trend.parameter.label} is {with_error(trend.value, trend.error)} {unit} ({limit})"
            yield Reason("level", text, beyond > SIGNIFICANT * trend.error)


def _outlying(unit: Unit, others: Kin, rules: Rules) -> Iterator[Reason]:
    if unit.held_out_mg is None or others.held_out_mg is None or others.devices < FEWEST_DEVICES:
        return
    spread = max(others.spread_mg, LEAST_SPREAD_MG)
    if unit.held_out_mg > others.held_out_mg + rules.outlying * spread:
        text = f"held-out error {unit.held_out_mg:.1f} mg, of devices of its kind {others.held_out_mg:.1f} mg"
        yield Reason("held out", text, unit.counted(*OWN) >= REPEATED)


def _refused(unit: Unit, others: Kin, rules: Rules) -> Iterator[Reason]:
    rest = (others.refused - unit.refused, others.recordings - unit.recordings)
    if _repeated((unit.refused, unit.recordings), rest, rules.refused_percent):
        text = f"{unit.refused} of {unit.recordings} recordings refused or borrowed{_elsewhere(*rest)}"
        yield Reason("refused", text, True)


def _damaged(unit: Unit, others: Kin, rules: Rules) -> Iterator[Reason]:
    rest = (others.damaged - unit.damaged, others.recordings - unit.recordings)
    if _repeated((unit.damaged, unit.recordings), rest, rules.damaged_percent):
        worst = f"up to {unit.worst_lost_percent:.2g} % lost"
        text = f"damage in {unit.damaged} of {unit.recordings} recordings, {worst}{_elsewhere(*rest)}"
        yield Reason("damaged", text, True)


def _repeated(own: tuple[int, int], rest: tuple[int, int], percent: float) -> bool:
    """Whether it happened twice, to so many percent, and at least twice as often as to the others."""
    (count, number), (elsewhere, others) = own, rest
    often = count >= REPEATED and 100 * count >= percent * number
    return often and (others == 0 or count * others >= 2 * elsewhere * number)


def _elsewhere(count: int, number: int) -> str:
    return f" (other devices: {100 * count / number:.0f} %)" if number else ""
