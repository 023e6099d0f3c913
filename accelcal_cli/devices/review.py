"""A verdict on each device of a study, with its reasons; the review as JSON and as rows of recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from math import isfinite
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from accelcal_cli.core.version import __version__
from accelcal_cli.devices import table
from accelcal_cli.devices.trends import SIGNIFICANT, Drift, Referred, Rules, Trend, at_one_temperature, trends
from accelcal_cli.output.words import with_error

PERHAPS = 0.05
"""Probability below which a drift is reported although it is not certain; our choice."""
FEWEST_DEVICES = 5
"""Number of devices of one kind from which on one of them can lie outside; our choice."""
LEAST_SPREAD_MG = 0.5
"""Least spread [mg] of held-out errors between devices of one kind; our choice."""
DAMAGED_FROM_PERCENT = 0.1
"""Share of a recording's bytes [%] from which damage counts; our choice."""
REPEATED = 2
"""Number of recordings that make a problem repeated."""

DEVICE = ("serial", "device_model", "format", "device_firmware")
TEMPERATURES = ("reference_c", "one_temperature_c")
RESULT = ("path", "start_time", "outcome")
ERRORS = ("before_mg", "after_mg", "ci95_low_mg", "ci95_high_mg", "lost_percent")
AT_ONE = tuple(f"{parameter.column}_at_one_temperature" for parameter in table.PARAMETERS[table.OFFSETS])


class Verdict(StrEnum):
    """Verdict on a device: what to do with it."""

    SERVICE = "service"
    WATCH = "watch"
    UNKNOWN = "unknown"
    GOOD = "good"


@dataclass(frozen=True, slots=True)
class Reason:
    """Reason to service a device, or to watch it if that is not certain."""

    rule: str
    text: str
    certain: bool


@dataclass(frozen=True, slots=True)
class DeviceReview:
    """A device.

    Attributes:
        key: serial, model and format, which its recordings share.
        rows: rows of its recordings in `Records`.
        firmware: all versions that its recordings name.
        counts: number of recordings by usage.
        damaged: number of recordings that lost bytes to damage.
        begin, end: starts of the first and the last recording that has a date.
        held_out_mg: median held-out error of its own calibrations; None if it has none.
        reference_c: temperature of its offsets; None if no recording has slopes.
        worst_lost_percent: largest share of bytes that one of its recordings lost.
    """

    key: table.DeviceKey
    rows: range
    firmware: tuple[str, ...]
    counts: dict[table.Usage, int]
    damaged: int
    begin: str | None
    end: str | None
    held_out_mg: float | None
    reference_c: float | None
    worst_lost_percent: float
    trends: tuple[Trend, ...]
    reasons: tuple[Reason, ...] = field(default=())

    def counted(self, *wanted: table.Usage) -> int:
        """Return the number of recordings with one of these usages."""
        return sum(self.counts.get(use, 0) for use in wanted)

    @property
    def recordings(self) -> int:
        """Number of its recordings, copies counted once."""
        return sum(self.counts.values()) - self.counted(table.Usage.COPY)

    @property
    def refused(self) -> int:
        """Number of recordings that could not be calibrated by themselves."""
        return self.counted(table.Usage.REFUSED, table.Usage.BORROWED)

    def fastest_drift(self, *kinds: table.Kind) -> Drift | None:
        """Return the fastest drift of some kinds of parameters; None if there are too few recordings."""
        drifts = [one.drift for one in self.trends if one.drift is not None and one.parameter.kind in kinds]
        return max(drifts, key=lambda drift: abs(drift.per_month), default=None)

    @property
    def verdict(self) -> Verdict:
        """Worst verdict that the reasons support."""
        if self.reasons:
            return Verdict.SERVICE if any(one.certain for one in self.reasons) else Verdict.WATCH
        known = bool(self.trends) or self.counted(table.Usage.GOOD) > 0
        return Verdict.GOOD if known else Verdict.UNKNOWN


@dataclass(frozen=True, slots=True)
class DeviceGroup:
    """Devices of one kind (model and format).

    Attributes:
        devices: number of devices with a held-out error.
        held_out_mg: median of their errors; None if there are none.
        spread_mg: 1.4826 times the median distance from it, which is a standard deviation of normal ones.
        recordings, refused, damaged: numbers of recordings of all devices of the kind.
    """

    devices: int
    held_out_mg: float | None
    spread_mg: float
    recordings: int
    refused: int
    damaged: int


def device_group(devices: Iterable[DeviceReview]) -> DeviceGroup:
    """Return the usual held-out error among devices, and its spread."""
    devices = list(devices)
    errors = [device.held_out_mg for device in devices if device.held_out_mg is not None]
    centre = median(errors) if errors else None
    spread = 0.0 if centre is None else 1.4826 * median(abs(error - centre) for error in errors)
    return DeviceGroup(
        len(errors),
        centre,
        spread,
        sum(device.recordings for device in devices),
        sum(device.refused for device in devices),
        sum(device.damaged for device in devices),
    )


def reasons(device: DeviceReview, others: DeviceGroup, rules: Rules) -> tuple[Reason, ...]:
    """Return all reasons of a device, the certain ones first, of each rule the worst first.

    Args:
        others: the devices of its kind, itself included.
    """
    listed = [*_drifts(device, rules), *_levels(device, rules), *_outlying(device, others, rules)]
    listed += _repeated(device, others, rules)
    return tuple(sorted(listed, key=lambda one: not one.certain))


def _drifts(device: DeviceReview, rules: Rules) -> Iterator[Reason]:
    limits = dict(zip(table.PARAMETERS, rules.drifts().tolist(), strict=True))
    drifts = [(trend, trend.drift) for trend in device.trends if trend.drift is not None]
    for trend, drift in sorted(drifts, key=lambda one: -abs(one[1].per_month) / limits[one[0].parameter]):
        size = abs(drift.per_month)
        if size > limits[trend.parameter] and drift.probability < PERHAPS:
            shown = f"{with_error(drift.per_month, drift.error)} {trend.parameter.unit}"
            text = f"{trend.parameter.label} drifts by {shown} a month"
            doubt = "" if drift.significant else f" (not certain from {trend.number} recordings)"
            yield Reason("drift", text + doubt, drift.significant)


def _levels(device: DeviceReview, rules: Rules) -> Iterator[Reason]:
    limits = dict(zip(table.PARAMETERS, rules.levels().tolist(), strict=True))
    for trend in sorted(device.trends, key=lambda one: -abs(one.value) / limits[one.parameter]):
        beyond = abs(trend.value) - limits[trend.parameter]
        if beyond > 0:
            unit = trend.parameter.unit
            limit = f"limit {limits[trend.parameter]:g} {unit}"
            text = f"{trend.parameter.label} is {with_error(trend.value, trend.error)} {unit} ({limit})"
            yield Reason("level", text, beyond > SIGNIFICANT * trend.error)


def _outlying(device: DeviceReview, others: DeviceGroup, rules: Rules) -> Iterator[Reason]:
    if device.held_out_mg is None or others.held_out_mg is None or others.devices < FEWEST_DEVICES:
        return
    spread = max(others.spread_mg, LEAST_SPREAD_MG)
    if device.held_out_mg > others.held_out_mg + rules.outlying * spread:
        text = f"held-out error {device.held_out_mg:.1f} mg (similar devices: {others.held_out_mg:.1f} mg)"
        yield Reason("held out", text, device.counted(*table.OWN) >= REPEATED)


def _repeated(device: DeviceReview, others: DeviceGroup, rules: Rules) -> Iterator[Reason]:
    """Yield what happened twice, in a share of the recordings, and twice as often as to other devices."""
    number, elsewhere = device.recordings, others.recordings - device.recordings
    refused = f"{device.refused} of {number} recordings refused or borrowed"
    damaged = f"damage in {device.damaged} of {number} recordings"
    damaged += f", up to {device.worst_lost_percent:.2g} % lost"
    for rule, count, all_of_kind, percent, text in (
        ("refused", device.refused, others.refused, rules.refused_percent, refused),
        ("damaged", device.damaged, others.damaged, rules.damaged_percent, damaged),
    ):
        rest = all_of_kind - count
        often = count >= REPEATED and 100 * count >= percent * number
        if often and (elsewhere == 0 or count * elsewhere >= 2 * rest * number):
            compared = f" (other devices: {100 * rest / elsewhere:.0f} %)" if elsewhere else ""
            yield Reason(rule, text + compared, True)


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
    referred = at_one_temperature(records, table.mask(usage, *table.COUNTED), rules.reference_c)
    levels = trends(referred.records, usage, rules)
    devices = [_reviewed(records, referred, usage, index, one) for index, one in enumerate(levels)]
    kinds = {
        kind: device_group(one for one in devices if one.key.kind == kind)
        for kind in sorted({one.key.kind for one in devices})
    }
    devices = [replace(one, reasons=reasons(one, kinds[one.key.kind], rules)) for one in devices]
    order = tuple(Verdict)
    devices.sort(key=lambda one: order.index(one.verdict))
    return Review(records, referred, usage, tuple(devices), kinds, rules)


def _reviewed(
    records: table.Records,
    referred: Referred,
    usage: list[table.Usage],
    index: int,
    of_device: tuple[Trend, ...],
) -> DeviceReview:
    rows = records.rows(index)
    single = [row for row in rows if usage[row] is not table.Usage.COPY]
    dated = [row for row in single if np.isfinite(records.days[row])]
    starts = records.text["start_time"]
    lost = np.nan_to_num(records.number["lost_percent"][single])
    temperature_c = float(referred.temperature_c[index])
    errors = records.number["after_mg"][[row for row in single if usage[row] in table.OWN]]
    known_errors: list[float] = errors[np.isfinite(errors)].tolist()
    return DeviceReview(
        records.devices[index],
        rows,
        tuple(sorted({name for row in rows if (name := records.text["device_firmware"][row])})),
        dict(Counter(usage[row] for row in rows)),
        int(np.count_nonzero(lost >= DAMAGED_FROM_PERCENT)),
        starts[dated[0]] if dated else None,
        starts[dated[-1]] if dated else None,
        median(known_errors) if known_errors else None,
        temperature_c if np.isfinite(temperature_c) else None,
        float(lost.max(initial=0.0)),
        of_device,
    )


def as_json(review: Review, devices: tuple[DeviceReview, ...]) -> dict[str, Any]:
    """Return the review of some devices as JSON; null for unknown values."""
    kinds = [
        {"model": model or None, "format": name or None, **asdict(known)}
        for (model, name), known in review.kinds.items()
    ]
    return {
        "accelcal_version": __version__,
        "recordings": len(review.records) + review.records.nameless,
        "without_serial": review.records.nameless,
        "failed_without_serial": review.records.failed,
        "rules": asdict(review.rules),
        "kinds": kinds,
        "devices": [_device(review, device) for device in devices],
    }


def _device(review: Review, device: DeviceReview) -> dict[str, Any]:
    return {
        "serial": device.key.serial,
        "model": device.key.model or None,
        "format": device.key.format or None,
        "firmware": list(device.firmware),
        "verdict": str(device.verdict),
        "reasons": [asdict(one) for one in device.reasons],
        "recordings": device.recordings,
        "uses": {str(use): number for use, number in sorted(device.counts.items())},
        "damaged": device.damaged,
        "first": device.begin,
        "last": device.end,
        "held_out_mg": device.held_out_mg,
        "reference_c": device.reference_c,
        "parameters": {trend.parameter.name: _trend(trend) for trend in device.trends},
        "history": [row(review, device, position) for position in device.rows],
    }


def _trend(trend: Trend) -> dict[str, Any]:
    return {
        "unit": trend.parameter.unit,
        "value": trend.value,
        "standard_error": trend.error,
        "recordings": trend.number,
        "drift": None if trend.drift is None else asdict(trend.drift),
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
        "message": records.text["message"][position],
    }


def columns() -> list[str]:
    """Return the names of a row's columns, in their order."""
    values = [name for one in table.PARAMETERS for name in (one.column, f"se_{one.column}")]
    moved = [name for one in AT_ONE for name in (one, f"se_{one}")]
    return [*DEVICE, "verdict", *RESULT, "use", "model", *ERRORS, *values, *TEMPERATURES, *moved, "message"]


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
