"""Which recordings of one device may use whose coefficients: decided from their rows alone."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping
from datetime import datetime, timedelta
from typing import Any

from accelcal_cli.core.judgement import Outcome

Row = Mapping[str, Any]

LENDERS = 3
"""So many are tried before a recording keeps its own result."""

GOOD = (Outcome.CALIBRATED, Outcome.REDUCED_MODEL, Outcome.ALREADY_GOOD)
POORER_TIMES = 2.0
POORER_MG = 1.0
"""A calibration is looked at again where its held-out error is at least so many times that of the device's
best recording, and so many mg more; otherwise a study of good recordings would be read twice."""


def pools(rows: Mapping[str, Row], max_damage_percent: float) -> list[list[str]]:
    """Names of the recordings that are calibrated as one, by device and name; each pool has two at least.

    They agree in serial, model, counts per g and range, and are not too damaged.

    Args:
        rows: own results by name.
    """
    alike: dict[tuple[Any, ...], list[str]] = {}
    for serial, device in _devices(rows).items():
        for name, row in device.items():
            if row["outcome"] in GOOD or not _damaged(row, max_damage_percent):
                key = (serial, row["device_model"] or "", row["lsb_per_g"], row["range_g"] or 0.0)
                alike.setdefault(key, []).append(name)
    return [sorted(alike[key]) for key in sorted(alike) if len(alike[key]) > 1]


def _damaged(row: Row, max_percent: float) -> bool:
    """Whether a recording was refused because of what damage took."""
    return bool(row["outcome"] == Outcome.REFUSED and row["lost_percent"] > max_percent)


def lenders(
    rows: Mapping[str, Row],
    max_damage_percent: float,
    *,
    compare: bool,
    settled: Collection[str] = (),
) -> dict[str, list[str]]:
    """For each recording that should borrow, by name, whom it may ask: the nearest in time first.

    Who should borrow does not lend, so that nothing is lent on.

    Args:
        rows: results by name.
        settled: names of those that do not ask, since a result is not their own.
        compare: whether calibrated recordings may borrow, too, if they are poorer than others.
    """
    found: dict[str, list[str]] = {}
    for device in _devices(rows).values():
        asking = {
            name
            for name in device.keys() - set(settled)
            if _asks(name, device, max_damage_percent, compare=compare)
        }
        lending = [name for name in device if name not in asking and device[name]["outcome"] in GOOD]
        for name in sorted(asking):
            near = sorted((_apart_s(device[name], rows[one]), one) for one in _alike(name, lending, device))
            if near:
                found[name] = [one for _, one in near[:LENDERS]]
    return found


def _devices(rows: Mapping[str, Row]) -> dict[str, dict[str, Row]]:
    """Rows by name, by serial; recordings without one belong to no device."""
    found: dict[str, dict[str, Row]] = {}
    for name, row in rows.items():
        if row["device_serial"]:
            found.setdefault(row["device_serial"], {})[name] = row
    return found


def _alike(name: str, others: list[str], rows: Mapping[str, Row]) -> list[str]:
    """Of other recordings of the same serial those whose model is not another one."""
    model = rows[name]["device_model"]
    return [
        one for one in others if one != name and (not model or rows[one]["device_model"] in (model, None, ""))
    ]


def _asks(name: str, device: Mapping[str, Row], max_damage_percent: float, *, compare: bool) -> bool:
    row = device[name]
    if row["outcome"] == Outcome.REFUSED:
        return not _damaged(row, max_damage_percent)
    if not compare or row["outcome"] not in GOOD:
        return False
    others = [device[one] for one in _alike(name, list(device), device)]
    best = min((one["after_mg"] for one in others if one["outcome"] in GOOD), default=row["after_mg"])
    return bool(row["after_mg"] >= POORER_TIMES * best and row["after_mg"] - best >= POORER_MG)


def _apart_s(one: Row, other: Row) -> float:
    """Time between two recordings by the device's clock [s]; 0 where they overlap, endless if not known."""
    spans = [_span(row) for row in (one, other)]
    if spans[0] is None or spans[1] is None:
        return float("inf")
    (start, end), (begin, close) = spans[0], spans[1]
    return max(0.0, (start - close).total_seconds(), (begin - end).total_seconds())


def _span(row: Row) -> tuple[datetime, datetime] | None:
    if row["start_time"] is None:
        return None
    start = datetime.fromisoformat(row["start_time"]).replace(tzinfo=None)
    try:
        return start, start + timedelta(seconds=row["duration_s"])
    except OverflowError:
        return None


def identity(row: Row) -> str:
    """A hash of a result: for the same settings and version a row says all that decides its report."""
    return hashlib.sha256(json.dumps(row, sort_keys=True).encode()).hexdigest()[:16]
