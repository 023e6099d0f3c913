"""A verdict on each device of a study, with its reasons; the review as JSON and as rows of recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from math import isfinite, isnan
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from accelcal_cli.core.errors import Reason, UsageError, printable
from accelcal_cli.core.identity import identity
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.devices import table
from accelcal_cli.devices.trends import (
    SIGNIFICANT,
    Drift,
    Jump,
    Referred,
    Rules,
    Trend,
    at_one_temperature,
    jumps,
    trends,
)
from accelcal_cli.output.sentences import of_device

# Findings on each device of a study: the rules, their findings as codes with values, and the verdict.

PERHAPS = 0.05
"""Probability below which a drift is reported although it is not certain; our choice."""
FEWEST_DEVICES = 5
"""Number of devices of one kind from which on one of them can lie outside; our choice."""
LEAST_SPREAD_MG = 0.5
"""Least spread [mg] of held-out errors between devices of one kind; our choice."""
REPEATED = 2
"""Number of recordings that make a problem repeated."""


class Verdict(StrEnum):
    """Verdict on a device: what to do with it."""

    TWO_SENSORS = "two_sensors"
    """Recordings contradict each other: sort out first which are of which sensor."""
    SERVICE = "service"
    WATCH = "watch"
    UNKNOWN = "unknown"
    """Nothing is wrong, as far as its recordings tell, and they do not tell enough."""
    GOOD = "good"


@dataclass(frozen=True, slots=True)
class Finding:
    """Finding of a rule, and the verdict that it supports."""

    reason: Reason
    verdict: Verdict


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Held-out errors [mg] of some recordings: their number, median, and the median of their low ends."""

    recordings: int
    median_mg: float
    low_mg: float


@dataclass(frozen=True, slots=True)
class DeviceReview:
    """A device.

    Attributes:
        key: serial, model and format, which its recordings share.
        rows: rows of its recordings in `Records`.
        firmware: all versions that its recordings name.
        counts: number of recordings by usage.
        sure: number of recordings whose own uncertainty is small enough to judge the device by.
        blamed: number of recordings that could not be calibrated although enough was recorded.
        damaged: number of recordings that lost bytes to damage.
        begin, end: starts of the first and the last recording that has a date.
        held_out: held-out errors of its own calibrations, of the sure ones if there are any; None without.
        least_high_mg: smallest upper end of the calibration errors of its recordings; None if unknown.
        reference_c: temperature of its offsets; None if no recording has slopes.
        worst_lost_percent: largest share of bytes that one of its recordings lost.
        jumps: recordings that contradict those before them.
    """

    key: table.DeviceKey
    rows: range
    firmware: tuple[str, ...]
    counts: dict[table.Usage, int]
    sure: int
    blamed: int
    damaged: int
    begin: str | None
    end: str | None
    held_out: HeldOut | None
    least_high_mg: float | None
    reference_c: float | None
    worst_lost_percent: float
    trends: tuple[Trend, ...]
    jumps: tuple[Jump, ...] = ()
    findings: tuple[Finding, ...] = field(default=())

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
        return self.counted(*table.NOT_CALIBRATED)

    @property
    def held_out_mg(self) -> float | None:
        """Median held-out error."""
        return None if self.held_out is None else self.held_out.median_mg

    def fastest_drift(self, *kinds: table.Kind) -> Drift | None:
        """Return the fastest drift of some kinds of parameters; None if there are too few recordings."""
        drifts = [one.drift for one in self.trends if one.drift is not None and one.parameter.kind in kinds]
        return max(drifts, key=lambda drift: abs(drift.per_month), default=None)

    @property
    def verdict(self) -> Verdict:
        """Weightiest verdict that the findings support."""
        return self.findings[0].verdict if self.findings else Verdict.GOOD


@dataclass(frozen=True, slots=True)
class DeviceGroup:
    """Devices of one kind (model and format).

    Attributes:
        devices: number of devices with a held-out error that is sure.
        held_out_mg: median of their errors; None if there are none.
        spread_mg: 1.4826 times the median distance from it, which is a standard deviation of normal ones.
        recordings, refused, damaged: numbers of recordings of all devices of the kind; those refused are the
            ones in which enough was recorded.
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
    errors = [one.held_out.median_mg for one in devices if one.held_out is not None and one.sure]
    centre = median(errors) if errors else None
    spread = 0.0 if centre is None else 1.4826 * median(abs(error - centre) for error in errors)
    return DeviceGroup(
        len(errors),
        centre,
        spread,
        sum(device.recordings for device in devices),
        sum(device.blamed for device in devices),
        sum(device.damaged for device in devices),
    )


def findings(
    device: DeviceReview, others: DeviceGroup, rules: Rules, records: table.Records
) -> tuple[Finding, ...]:
    """Return what is found of a device, the weightiest first, by each rule the worst first.

    Args:
        others: the devices of its kind, itself included.
    """
    order = tuple(Verdict)
    listed = [*_jumps(device, records), *_drifts(device, rules), *_levels(device, rules)]
    listed += [*_outlying(device, others, rules), *_repeated(device, others, rules)]
    return tuple(sorted(listed or _unknown(device), key=lambda one: order.index(one.verdict)))


def _found(code: str, *, certain: bool, **values: Any) -> Finding:
    verdict = Verdict.SERVICE if certain else Verdict.WATCH
    return Finding(Reason(code, {**values, "certain": certain}), verdict)


def _jumps(device: DeviceReview, records: table.Records) -> Iterator[Finding]:
    """Yield the jump that shows two sensors, or else the largest one that is not part of a drift."""
    both = [one for one in device.jumps if one.near or one.returns]
    drifting = {one.parameter for one in device.trends if one.drift is not None and one.drift.significant}
    steps = [one for one in device.jumps if one.parameter not in drifting]
    for jump in sorted(both or steps, key=lambda one: -abs(one.change) / one.error)[:1]:
        pair = (jump.before, jump.after)
        values = {
            "parameter": jump.parameter.name, "unit": jump.parameter.unit, "change": jump.change,
            "error": jump.error, "paths": [records.text["path"][row] for row in pair],
            "starts": [records.text["start_time"][row] for row in pair], "returns": jump.returns,
        }  # fmt: skip
        if both:
            yield Finding(Reason("two_sensors", values), Verdict.TWO_SENSORS)
        else:
            yield Finding(Reason("device_step", values), Verdict.SERVICE)


def _drifts(device: DeviceReview, rules: Rules) -> Iterator[Finding]:
    """Yield drifts; where there are jumps, no line that is not certain is drawn through them."""
    limits = dict(zip(table.PARAMETERS, rules.drifts().tolist(), strict=True))
    drifts = [(trend, trend.drift) for trend in device.trends if trend.drift is not None]
    for trend, drift in sorted(drifts, key=lambda one: -abs(one[1].per_month) / limits[one[0].parameter]):
        large = abs(drift.per_month) > limits[trend.parameter]
        if large and (drift.significant or (drift.probability < PERHAPS and not device.jumps)):
            yield _found(
                "device_drift", certain=drift.significant, parameter=trend.parameter.name,
                unit=trend.parameter.unit,
                per_month=drift.per_month, error=drift.error, recordings=trend.number,
                limit=limits[trend.parameter],
            )  # fmt: skip


def _levels(device: DeviceReview, rules: Rules) -> Iterator[Finding]:
    limits = dict(zip(table.PARAMETERS, rules.levels().tolist(), strict=True))
    for trend in sorted(device.trends, key=lambda one: -abs(one.value) / limits[one.parameter]):
        beyond = abs(trend.value) - limits[trend.parameter]
        if beyond > 0:
            yield _found(
                "device_level", certain=beyond > SIGNIFICANT * trend.error, parameter=trend.parameter.name,
                unit=trend.parameter.unit, value=trend.value, error=trend.error,
                limit=limits[trend.parameter],
            )  # fmt: skip


def _outlying(device: DeviceReview, others: DeviceGroup, rules: Rules) -> Iterator[Finding]:
    """Yield an error beyond that of the other devices by more than the recordings' own intervals."""
    held_out = device.held_out
    if held_out is None or not device.sure or others.held_out_mg is None or others.devices < FEWEST_DEVICES:
        return
    spread = max(others.spread_mg, LEAST_SPREAD_MG)
    if held_out.low_mg > others.held_out_mg + rules.outlying * spread:
        yield _found(
            "device_held_out", certain=held_out.recordings >= REPEATED, held_out_mg=held_out.median_mg,
            low_mg=held_out.low_mg, usual_mg=others.held_out_mg, recordings=held_out.recordings,
        )  # fmt: skip


def _repeated(device: DeviceReview, others: DeviceGroup, rules: Rules) -> Iterator[Finding]:
    """Yield what happened twice, in a share of the recordings, and twice as often as to other devices."""
    number, elsewhere = device.recordings, others.recordings - device.recordings
    for code, count, all_of_kind, percent, more in (
        ("device_refused", device.blamed, others.refused, rules.refused_percent, {}),
        ("device_damaged", device.damaged, others.damaged, rules.damaged_percent,
         {"lost_percent": device.worst_lost_percent}),
    ):  # fmt: skip
        rest = all_of_kind - count
        often = count >= REPEATED and 100 * count >= percent * number
        if often and (elsewhere == 0 or count * elsewhere >= 2 * rest * number):
            usual = 100 * rest / elsewhere if elsewhere else None
            values = {"number": count, "recordings": number, "elsewhere_percent": usual, **more}
            yield Finding(Reason(code, values), Verdict.SERVICE)


def _unknown(device: DeviceReview) -> Iterator[Finding]:
    """Yield that no recording is sure enough to judge the device by, and how near the best of them comes."""
    if not device.sure:
        values = {
            "recordings": device.recordings, "refused": device.refused,
            "shared": device.counted(table.Usage.SHARED), "least_high_mg": device.least_high_mg,
        }  # fmt: skip
        yield Finding(Reason("device_not_known", values), Verdict.UNKNOWN)


# A verdict on each device of a study, with its reasons; the review as JSON and as rows of recordings.

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


def review(out: Path, rules: Rules, now_s: float, *, keep_teaching: bool = False) -> Review:
    """Judge the devices of the study in a folder.

    Args:
        now_s: the time [s since 1970].
        keep_teaching: recordings that people excluded count too.

    Raises:
        UsageError, UnreadableError: see `table.read`.
    """
    return judged(table.read(out, now_s, keep_teaching=keep_teaching), rules)


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

    single = [row for row, use in uses.items() if use is not table.Usage.COPY]
    own = used(*table.OWN)
    sure = [row for row in own if known.sure[row]]
    starts = [records.text["start_time"][row] for row in single if np.isfinite(records.days[row])] or [None]
    lost = np.nan_to_num(records.number["lost_percent"][single])
    highs = records.number[table.HIGH][own]
    enough = records.number["orientations"][used(*table.NOT_CALIBRATED)] >= DEFAULT.min_postures
    return DeviceReview(
        key=records.devices[index],
        rows=rows,
        firmware=tuple(sorted({*filter(None, (records.text["device_firmware"][row] for row in rows))})),
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


def chosen(reviewed: Review, serial: str | None, out: Path) -> tuple[DeviceReview, ...]:
    """Return the devices of a serial number, all for None; raises UsageError if there is none."""
    if serial is None:
        return reviewed.devices
    devices = tuple(device for device in reviewed.devices if device.key.serial == serial)
    if not devices:
        some = [printable(device.key.serial) for device in reviewed.devices[:5]]
        hint = f"there are {', '.join(some)}{', ...' if len(reviewed.devices) > 5 else ''}" if some else None
        raise UsageError(f"no recording of device {printable(serial)}", path=out, hint=hint)
    return devices


def as_json(review: Review, devices: tuple[DeviceReview, ...]) -> dict[str, Any]:
    """Return the review of some devices as JSON; null for unknown values."""
    return {
        **identity("devices"),
        "recordings": len(review.records) + review.records.nameless,
        "without_serial": review.records.nameless,
        "failed_without_serial": review.records.failed,
        "excluded": review.records.excluded,
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
