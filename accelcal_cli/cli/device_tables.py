"""The devices of a study as aligned text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import isfinite

from accelcal_cli.cli.tables import aligned, number
from accelcal_cli.core.names import printable
from accelcal_cli.fleet.parameters import OFFSETS, PARAMETERS, Kind, with_error
from accelcal_cli.fleet.review import Review
from accelcal_cli.fleet.trends import Drift, Trend
from accelcal_cli.fleet.unit import Unit
from accelcal_cli.fleet.use import Use

HEAD = ("device", "recordings", "used", "refused", "first", "last", "held out mg", "mg/month", "%/month")
DETAIL = ("parameter", "value", "+-", "a month", "+-", "scatter", "recordings", "certain")
HISTORY = ("start", "outcome", "use", "model", "held out mg", "x mg", "+-", "y mg", "+-", "z mg", "+-")
PERCENT = (Kind.SCALE, Kind.MISALIGNMENT)


def overview(units: Sequence[Unit]) -> str:
    """A line for each device, with the verdict and its first reason."""
    names = _names(units)
    lines = aligned(HEAD, [_line(name, unit) for name, unit in zip(names, units, strict=True)]).splitlines()
    said = ["verdict", "-------", *(_verdict(unit) for unit in units)]
    width = max(map(len, lines))
    return "\n".join(f"{line.ljust(width)}  {text}" for line, text in zip(lines, said, strict=True))


def _names(units: Sequence[Unit]) -> list[str]:
    """Serials; with model and format where several devices have the same."""
    often = Counter(unit.device.serial for unit in units)
    return [printable(_name(unit, alone=often[unit.device.serial] == 1)) for unit in units]


def _name(unit: Unit, *, alone: bool) -> str:
    device = unit.device
    return device.serial if alone else f"{device.serial} ({device.model or '-'}, {device.format or '-'})"


def _line(name: str, unit: Unit) -> list[str]:
    return [
        name,
        str(unit.recordings),
        str(unit.counted(Use.USED, Use.UNDATED)),
        str(unit.refused),
        _date(unit.begin),
        _date(unit.end),
        number(unit.held_out_mg, ".2f"),
        _fastest(unit, (Kind.OFFSET,)),
        _fastest(unit, PERCENT),
    ]


def _date(start: str | None) -> str:
    return "-" if start is None else start[:10]


def _fastest(unit: Unit, kinds: tuple[Kind, ...]) -> str:
    """The fastest drift of some kinds of parameters, with its standard error."""
    drifts = [one.drift for one in unit.trends if one.drift is not None and one.parameter.kind in kinds]
    if not drifts:
        return "undated" if unit.counted(Use.UNDATED) and not unit.counted(Use.USED) else "not enough"
    fastest = max(drifts, key=lambda drift: abs(drift.per_month))
    return with_error(fastest.per_month, fastest.error)


def _verdict(unit: Unit) -> str:
    if not unit.reasons:
        return str(unit.verdict)
    more = f"; and {len(unit.reasons) - 1} more" if len(unit.reasons) > 1 else ""
    return f"{unit.verdict}: {unit.reasons[0].text}{more}"


def detail(review: Review, unit: Unit) -> str:
    """All of one device: its verdict, its parameters, its recordings."""
    device = unit.device
    about = [device.model, device.format, *unit.firmware]
    name = f"{device.serial} ({', '.join(filter(None, about)) or 'of unknown model'}): {unit.verdict}"
    reasons = [f"  {'' if one.certain else 'perhaps: '}{one.text}" for one in unit.reasons]
    warm = [] if unit.reference_c is None else [f"offsets at {unit.reference_c:.1f} C"]
    return "\n".join([printable(name), *reasons, "", *warm, *_parameters(unit), _history(review, unit)])


def _parameters(unit: Unit) -> list[str]:
    if not unit.trends:
        return []
    return [aligned(DETAIL, [_trend(trend) for trend in unit.trends]), ""]


def _trend(trend: Trend) -> list[str]:
    digits = ".4f" if trend.parameter.kind is not Kind.OFFSET else ".3f"
    value = [f"{trend.parameter.label} {trend.parameter.unit}", f"{trend.value:+{digits}}"]
    return [*value, f"{trend.error:{digits}}", *_drift(trend.drift, digits, trend.number)]


def _drift(drift: Drift | None, digits: str, recordings: int) -> list[str]:
    if drift is None:
        return ["not enough", "-", "-", str(recordings), "-"]
    certain = "yes" if drift.significant else "no"
    shown = [f"{drift.per_month:+{digits}}", f"{drift.error:{digits}}", f"{drift.scatter:.1f}"]
    return [*shown, str(recordings), certain]


def _history(review: Review, unit: Unit) -> str:
    """A line for each recording, its path last."""
    lines = aligned(HISTORY, [_recording(review, at) for at in unit.rows]).splitlines()
    paths = ["path", "----", *(printable(review.records.text["path"][at] or "-") for at in unit.rows)]
    width = max(map(len, lines))
    return "\n".join(f"{line.ljust(width)}  {path}" for line, path in zip(lines, paths, strict=True))


def _recording(review: Review, at: int) -> list[str]:
    text, moved = review.records.text, review.referred.records
    cells = [_date(text["start_time"][at]), text["outcome"][at] or "-", str(review.use[at])]
    cells += [text["model"][at] or "-", _finite(float(review.records.number["after_mg"][at]), ".2f")]
    for index in range(len(PARAMETERS))[OFFSETS]:
        cells.append(_finite(1000 * float(moved.values[at, index]), "+.2f"))
        cells.append(_finite(1000 * float(moved.errors[at, index]), ".2f"))
    return cells


def _finite(value: float, form: str) -> str:
    return number(value if isfinite(value) else None, form)
