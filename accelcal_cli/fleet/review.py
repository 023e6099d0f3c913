"""From a study's table to its devices."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np

from accelcal_cli.fleet.reasons import Kin, kin, reasons
from accelcal_cli.fleet.records import Records
from accelcal_cli.fleet.reference import Referred, at_one_temperature
from accelcal_cli.fleet.rules import DAMAGED_FROM_PERCENT, Rules
from accelcal_cli.fleet.table import read
from accelcal_cli.fleet.trends import Trend, trends
from accelcal_cli.fleet.unit import Unit, Verdict
from accelcal_cli.fleet.use import OWN, Use, mask, uses


@dataclass(frozen=True, slots=True, eq=False)
class Review:
    """All devices of a study.

    Attributes:
        records: as in the table.
        referred: the same with offsets at one temperature a device.
        use: of each recording.
        units: the devices, those to service first.
        kinds: what is usual among devices of a model and format.
    """

    records: Records
    referred: Referred
    use: list[Use]
    units: tuple[Unit, ...]
    kinds: dict[tuple[str, str], Kin]
    rules: Rules


def review(out: Path, rules: Rules, now_s: float) -> Review:
    """Judge the devices of the study in a folder.

    Args:
        now_s: the time [s since 1970].

    Raises:
        UsageError, UnreadableError: see `table.read`.
    """
    return judged(read(out, now_s), rules)


def judged(records: Records, rules: Rules) -> Review:
    """Judge the devices of recordings."""
    found = uses(records)
    referred = at_one_temperature(records, mask(found, Use.USED, Use.UNDATED), rules.reference_c)
    told = trends(referred.records, found, rules)
    units = [_unit(records, referred, found, device, told[device]) for device in range(len(told))]
    kinds = {kind: kin(one for one in units if one.device.kind == kind) for kind in _kinds(units)}
    units = [replace(one, reasons=reasons(one, kinds[one.device.kind], rules)) for one in units]
    order = tuple(Verdict)
    units.sort(key=lambda one: order.index(one.verdict))
    return Review(records, referred, found, tuple(units), kinds, rules)


def _kinds(units: list[Unit]) -> list[tuple[str, str]]:
    return sorted({one.device.kind for one in units})


def _unit(
    records: Records, referred: Referred, found: list[Use], device: int, told: tuple[Trend, ...]
) -> Unit:
    rows = records.rows(device)
    single = [row for row in rows if found[row] is not Use.COPY]
    dated = [row for row in single if np.isfinite(records.days[row])]
    starts = records.text["start_time"]
    lost = [float(value) for value in np.nan_to_num(records.number["lost_percent"][single])]
    warm = float(referred.temperature_c[device])
    return Unit(
        records.devices[device],
        rows,
        tuple(sorted({name for row in rows if (name := records.text["device_firmware"][row])})),
        dict(Counter(found[row] for row in rows)),
        sum(value >= DAMAGED_FROM_PERCENT for value in lost),
        starts[dated[0]] if dated else None,
        starts[dated[-1]] if dated else None,
        _held_out(records, found, single),
        warm if np.isfinite(warm) else None,
        max(lost, default=0.0),
        told,
    )


def _held_out(records: Records, found: list[Use], rows: list[int]) -> float | None:
    errors = [float(records.number["after_mg"][row]) for row in rows if found[row] in OWN]
    known = [error for error in errors if np.isfinite(error)]
    return median(known) if known else None
