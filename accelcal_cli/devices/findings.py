"""Findings on each device of a study: the rules, their findings as codes with values, and the verdict."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from statistics import median
from typing import Any

from accelcal_cli.core.reasons import Reason
from accelcal_cli.devices import table
from accelcal_cli.devices.jumps import Jump
from accelcal_cli.devices.trends import SIGNIFICANT, Drift, Rules, Trend

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
