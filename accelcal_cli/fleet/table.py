"""Reading a study's table."""

from __future__ import annotations

from datetime import UTC, datetime
from math import isnan, nan
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.points import MODELS
from accelcal_cli.fleet.records import Device, Floats, Records
from accelcal_cli.study.items import FAILED
from accelcal_cli.study.row import PARAMETERS as COLUMNS

NAME = "study.parquet"
TEXT = (
    "path", "outcome", "message", "model", "format", "device_model", "device_serial", "device_firmware",
    "start_time", "sha256",
)  # fmt: skip
NUMBERS = ("before_mg", "after_mg", "ci95_low_mg", "ci95_high_mg", "reference_c", "lost_percent")
ERRORS = tuple(f"se_{name}" for name in COLUMNS)
WANTED = (*TEXT, *NUMBERS, *COLUMNS, *ERRORS)
LARGEST = 1e9
"""Of any number in a study's table that is looked at."""
LEAST_ERROR = 1e-12
"""Of a parameter; they are known to 2**-29."""
DAY_S = 86_400
EARLIEST_DAY = 10_957.0
"""2000-01-01: before, no such device recorded; it is where clocks begin that were never set."""
AHEAD_DAYS = 2.0
"""A start so much later than now is a wrong clock, not another time zone."""


def read(out: Path, now_s: float) -> Records:
    """The table of the study in a folder.

    Args:
        now_s: the time [s since 1970]; recordings that begin later have no date.

    Raises:
        UsageError: there is no table.
        UnreadableError: it cannot be read, or is none of a study.
    """
    return records(columns(out / NAME), now_s / DAY_S + AHEAD_DAYS)


def columns(path: Path) -> dict[str, Any]:
    """The columns that are wanted: lists of text, arrays of numbers (NaN for none)."""
    _check_there(path)
    try:
        with path.open("rb") as source, pq.ParquetFile(source) as file:
            names = file.schema_arrow.names
            missing = [name for name in WANTED if name not in names]
            if missing:
                raise _not_ours(path, names, missing)
            table = file.read(columns=list(WANTED))
        text = {name: _texts(table[name]) for name in TEXT}
        numbers = {name: _floats(table[name]) for name in (*NUMBERS, *COLUMNS, *ERRORS)}
    except (pa.ArrowException, OSError, ValueError, TypeError) as error:
        said = " ".join(str(error).split())
        raise UnreadableError(f"cannot be read ({said})", path=path, hint="run the study again") from error
    return text | numbers


def _check_there(path: Path) -> None:
    if path.is_file():
        return
    if any(path.parent.glob("study.*-of-*.parquet")):
        raise UsageError(
            "does not exist, only those of shards", path=path, hint="run the study with --collect first"
        )
    hint = "name the folder that was given to `accelcal study` with -d, or run it first"
    raise UsageError("does not exist", path=path, hint=hint)


def _not_ours(path: Path, names: list[str], missing: list[str]) -> UnreadableError:
    if all(name.startswith("se_") or name == "lost_percent" for name in missing) and "path" in names:
        text = "is of an earlier version, without standard errors"
        return UnreadableError(text, path=path, hint="run the study again, with --force")
    return UnreadableError(f"is no table of a study: it has no column {missing[0]}", path=path)


def _texts(column: pa.ChunkedArray) -> list[str | None]:
    found: list[Any] = column.to_pylist()
    if not all(value is None or isinstance(value, str) for value in found):
        raise ValueError(f"a column of text is {column.type}")
    return found


def _floats(column: pa.ChunkedArray) -> Floats:
    """NaN for none. Arrow's own way to numpy loads pandas, which takes a third of a second."""
    return np.array(column.to_pylist(), np.float64)


def records(held: dict[str, Any], latest_day: float) -> Records:
    """Columns as recordings of devices, in their order; see `Records`."""
    named = [row for row, serial in enumerate(held["device_serial"]) if serial]
    days = [day(start, latest_day) for start in held["start_time"]]
    keys = {row: (_device(held, row), days[row]) for row in named}
    order = sorted(named, key=lambda row: (*_sortable(*keys[row]), held["path"][row] or ""))
    devices = tuple(dict.fromkeys(keys[row][0] for row in order))
    number = {device: index for index, device in enumerate(devices)}
    counts = np.bincount([number[keys[row][0]] for row in order], minlength=len(devices))
    pairs = zip(held["outcome"], held["device_serial"], strict=True)
    nameless = [outcome for outcome, serial in pairs if not serial]
    values, errors = _parameters(held, order)
    return Records(
        devices,
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        {name: [held[name][row] for row in order] for name in TEXT},
        {name: _possible(held[name][order]) for name in NUMBERS},
        values,
        errors,
        np.array([days[row] for row in order], np.float64),
        nameless=len(nameless),
        failed=nameless.count(FAILED),
    )


def _device(held: dict[str, Any], row: int) -> Device:
    return Device(held["device_serial"][row], held["device_model"][row] or "", held["format"][row] or "")


def _sortable(device: Device, start: float) -> tuple[str, str, str, bool, float]:
    undated = isnan(start)
    return device.serial, device.model, device.format, undated, 0.0 if undated else start


def _parameters(held: dict[str, Any], order: list[int]) -> tuple[Floats, Floats]:
    """What was fitted, and its standard error where that says something."""
    values = np.stack([held[name][order] for name in COLUMNS], axis=1)
    errors = np.stack([held[name][order] for name in ERRORS], axis=1)
    models = [held["model"][row] for row in order]
    free = np.array([_free(model) for model in models], bool).reshape(values.shape)
    values, errors = np.where(free, _possible(values), nan), _possible(errors)
    return values, np.where(np.isfinite(values) & (errors >= LEAST_ERROR), errors, nan)


def _possible(held: Floats) -> Floats:
    """NaN for what no study writes: a damaged table has no sums of squares that overflow."""
    return np.where(np.abs(held) <= LARGEST, held, nan)


def _free(model: str | None) -> list[bool]:
    known = MODELS.get(model or "")
    return [known is not None and index in known.free for index in range(len(COLUMNS))]


def day(start: str | None, latest_day: float) -> float:
    """Days since 1970 of a start; NaN of none, and of one that no clock shows which was set."""
    try:
        moment = datetime.fromisoformat(start or "")
    except ValueError:
        return nan
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    found = (moment - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds() / DAY_S
    return found if EARLIEST_DAY <= found <= latest_day else nan
