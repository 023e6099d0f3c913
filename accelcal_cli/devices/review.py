"""A verdict on each device of a study, with its reasons; the review as JSON and as rows of recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import isfinite, isnan
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from accelcal_cli.core.identity import identity
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.devices import table
from accelcal_cli.devices.findings import DeviceGroup, DeviceReview, HeldOut, Verdict, device_group, findings
from accelcal_cli.devices.jumps import jumps
from accelcal_cli.devices.trends import Referred, Rules, Trend, at_one_temperature, trends
from accelcal_cli.output.study_words import of_device

DAMAGED_FROM_PERCENT = 0.1
"""Share of a recording's bytes [%] from which damage counts; our choice."""

DEVICE = ("serial", "device_model", "format", "device_firmware")
TEMPERATURES = ("reference_c", "one_temperature_c")
RESULT = ("path", "start_time", "outcome")
ERRORS = ("before_mg", "after_mg", "ci95_low_mg", "ci95_high_mg", "lost_percent")
AT_ONE = tuple(f"{parameter.column}_at_one_temperature" for parameter in table.PARAMETERS[table.OFFSETS])


@dataclass(frozen=True, slots=True, eq=False)
class Review:
    """All devices of a study.

    Attributes:
        records: as in the table.
        referred: the same recordings with offsets at one temperature a device.
        usage: usage of each recording.
        devices: all devices, those to service first.
        kinds: usual values among devices of a model and format.
    """

    records: table.Records
    referred: Referred
    usage: list[table.Usage]
    devices: tuple[DeviceReview, ...]
    kinds: dict[tuple[str, str], DeviceGroup]
    rules: Rules


def review(out: Path, rules: Rules, now_s: float) -> Review:
    """Judge the devices of the study in a folder.

    Args:
        now_s: the time [s since 1970].

    Raises:
        UsageError, UnreadableError: see `table.read`.
    """
    return judged(table.read(out, now_s), rules)


def judged(records: table.Records, rules: Rules) -> Review:
    """Judge the devices of recordings."""
    usage = table.usages(records)
    provisional = np.array([outcome == Outcome.PROVISIONAL for outcome in records.text["outcome"]], bool)
    small = ~(records.number[table.HIGH] > rules.certain_mg)  # also where it is not known
    sure = np.asarray(table.mask(usage, *table.OWN) & small & ~provisional)
    referred = at_one_temperature(records, table.mask(usage, *table.COUNTED), rules.reference_c)
    levels = trends(referred.records, usage, rules)
    known = _Known(records, referred, usage, sure)
    devices = [_reviewed(known, index, one) for index, one in enumerate(levels)]
    kinds = {
        kind: device_group(one for one in devices if one.key.kind == kind)
        for kind in sorted({one.key.kind for one in devices})
    }
    devices = [replace(one, findings=findings(one, kinds[one.key.kind], rules, records)) for one in devices]
    order = tuple(Verdict)
    devices.sort(key=lambda one: order.index(one.verdict))
    return Review(records, referred, usage, tuple(devices), kinds, rules)


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """All recordings of a study, and the known facts about each.

    Attributes:
        sure: (n,) whether it has a calibration of its own that is certain enough to judge its device by.
    """

    records: table.Records
    referred: Referred
    usage: list[table.Usage]
    sure: table.Mask


def _reviewed(known: _Known, index: int, of_device: tuple[Trend, ...]) -> DeviceReview:
    records, rows = known.records, known.records.rows(index)
    uses = {row: known.usage[row] for row in rows}

    def used(*wanted: table.Usage) -> list[int]:
        return [row for row, use in uses.items() if use in wanted]

    single, own = used(*(use for use in table.Usage if use is not table.Usage.COPY)), used(*table.OWN)
    sure = [row for row in own if known.sure[row]]
    starts = [records.text["start_time"][row] for row in single if np.isfinite(records.days[row])] or [None]
    lost = np.nan_to_num(records.number["lost_percent"][single])
    highs = records.number[table.HIGH][own]
    enough = records.number["orientations"][used(*table.NOT_CALIBRATED)] >= DEFAULT.min_postures
    return DeviceReview(
        key=records.devices[index],
        rows=rows,
        firmware=tuple(sorted({*filter(None, records.text["device_firmware"][rows.start : rows.stop])})),
        counts=dict(Counter(uses.values())),
        sure=len(sure),
        blamed=int(np.count_nonzero(enough)),
        damaged=int(np.count_nonzero(lost >= DAMAGED_FROM_PERCENT)),
        begin=starts[0],
        end=starts[-1],
        held_out=_held_out(records, sure or own),
        least_high_mg=float(np.nanmin(highs)) if np.isfinite(highs).any() else None,
        reference_c=_number(known.referred.temperature_c, index),
        worst_lost_percent=float(lost.max(initial=0.0)),
        trends=of_device,
        jumps=jumps(known.referred.records, used(table.Usage.USED)),
    )


def _held_out(records: table.Records, rows: Sequence[int]) -> HeldOut | None:
    """Summarize held-out errors; one without an interval is treated as exact."""
    error, low = (records.number[name] for name in ("after_mg", "ci95_low_mg"))
    pairs = [
        (error[row], error[row] if isnan(low[row]) else low[row]) for row in rows if isfinite(error[row])
    ]
    if not pairs:
        return None
    return HeldOut(len(pairs), *(float(median(values)) for values in zip(*pairs, strict=True)))


def as_json(review: Review, devices: tuple[DeviceReview, ...]) -> dict[str, Any]:
    """Return the review of some devices as JSON; null for unknown values."""
    return {
        **identity("devices"),
        "recordings": len(review.records) + review.records.nameless,
        "without_serial": review.records.nameless,
        "failed_without_serial": review.records.failed,
        "rules": asdict(review.rules),
        "kinds": [
            {"model": model or None, "format": name or None, **asdict(known)}
            for (model, name), known in review.kinds.items()
        ],
        "devices": [_device(review, device) for device in devices],
    }


def _device(review: Review, device: DeviceReview) -> dict[str, Any]:
    return {
        "serial": device.key.serial,
        "model": device.key.model or None,
        "format": device.key.format or None,
        "firmware": list(device.firmware),
        "verdict": str(device.verdict),
        "reasons": [
            one.reason.as_json() | {"verdict": str(one.verdict), "text": of_device(one.reason)}
            for one in device.findings
        ],
        "recordings": device.recordings,
        "sure": device.sure,
        "uses": {str(use): number for use, number in sorted(device.counts.items())},
        "damaged": device.damaged,
        "first": device.begin,
        "last": device.end,
        "held_out_mg": device.held_out_mg,
        "reference_c": device.reference_c,
        "parameters": {
            trend.parameter.name: {
                "unit": trend.parameter.unit,
                "value": trend.value,
                "standard_error": trend.error,
                "recordings": trend.number,
                "drift": None if trend.drift is None else asdict(trend.drift),
            }
            for trend in device.trends
        },
        "history": [row(review, device, position) for position in device.rows],
    }


def row(review: Review, device: DeviceReview, position: int) -> dict[str, Any]:
    """Return one recording of a device: a row of the CSV, in the study's units."""
    records = review.records
    return {
        "serial": device.key.serial,
        "device_model": device.key.model or None,
        "format": device.key.format or None,
        "device_firmware": records.text["device_firmware"][position],
        "verdict": str(device.verdict),
        **{name: records.text[name][position] for name in RESULT},
        "use": str(review.usage[position]),
        "model": records.text["model"][position],
        **{name: _number(records.number[name], position) for name in ERRORS},
        **_parameters(review, position),
        "reason": records.text["reason"][position],
        "message": records.text["message"][position],
        "copy_of": records.copied(position),
    }


def columns() -> list[str]:
    """Return the names of a row's columns, in their order."""
    values = [name for one in table.PARAMETERS for name in (one.column, f"se_{one.column}")]
    moved = [name for one in AT_ONE for name in (one, f"se_{one}")]
    last = ("reason", "message", "copy_of")
    return [*DEVICE, "verdict", *RESULT, "use", "model", *ERRORS, *values, *TEMPERATURES, *moved, *last]


def _parameters(review: Review, position: int) -> dict[str, float | None]:
    """Return the parameters with their standard errors, and the offsets at the device's one temperature."""
    records, moved = review.records, review.referred.records
    columns: dict[str, float | None] = {}
    for index, parameter in enumerate(table.PARAMETERS):
        columns[parameter.column] = _number(records.values[:, index], position)
        columns[f"se_{parameter.column}"] = _number(records.errors[:, index], position)
    columns["reference_c"] = _number(records.number["reference_c"], position)
    device = int(records.first.searchsorted(position, side="right")) - 1
    columns["one_temperature_c"] = _number(review.referred.temperature_c, device)
    for name, index in zip(AT_ONE, range(12)[table.OFFSETS], strict=True):
        columns[name] = _number(moved.values[:, index], position)
        columns[f"se_{name}"] = _number(moved.errors[:, index], position)
    return columns


def _number(numbers: table.Floats, position: int) -> float | None:
    value = float(numbers[position])
    return value if isfinite(value) else None
