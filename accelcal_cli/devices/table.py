"""A study's table as arrays, device by device; the twelve parameters, and which recordings count for them."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from enum import StrEnum
from math import isnan, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import OutputError, UnreadableError, UsageError, counted, printable
from accelcal_cli.core.paths import is_file, is_folder, matching
from accelcal_cli.core.points import MODELS
from accelcal_cli.core.results import Outcome
from accelcal_cli.output import decisions
from accelcal_cli.output.files import NAME, read_columns
from accelcal_cli.output.registry import (
    RegistryEntry,
    entry_of,
    is_registry,
    merged,
    read_registry,
    write_registry,
)
from accelcal_cli.pipeline.jobs import QUALITY_SUFFIX, REPORT_SUFFIX, refuse_misnamed
from accelcal_cli.studies.columns import ERROR_COLUMNS
from accelcal_cli.studies.columns import PARAMETERS as COLUMNS
from accelcal_cli.studies.records import FAILED

if TYPE_CHECKING:
    import pyarrow as pa

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

TEXT = (
    "path", "outcome", "reason", "message", "model", "format", "device_model", "device_serial",
    "device_firmware", "start_time", "sha256",
)  # fmt: skip
HIGH = ERROR_COLUMNS[2]
"""Column of the upper end of a recording's calibration error."""
NUMBERS = (
    "before_mg", "after_mg", "ci95_low_mg", "ci95_high_mg", "reference_c", "lost_percent", "duration_s",
    "orientations", HIGH,
)  # fmt: skip
ERRORS = tuple(f"se_{name}" for name in COLUMNS)
WANTED = (*TEXT, *NUMBERS, *COLUMNS, *ERRORS)
LARGEST = 1e9
"""Bound on the size of all numbers that are read from a study's table."""
LEAST_ERROR = 1e-12
"""Least standard error of a parameter; parameters are known to 2**-29."""
DAY_S = 86_400
EARLIEST_DAY = 10_957.0
"""Day from which on starts are believed, 2000-01-01: clocks that were never set begin there."""
AHEAD_DAYS = 2.0
"""Days by which a start may be later than now: more is a wrong clock, not another time zone."""


class Kind(StrEnum):
    """Kind of a parameter."""

    SCALE = "scale"
    MISALIGNMENT = "misalignment"
    OFFSET = "offset"
    SLOPE = "slope"


UNITS = {Kind.SCALE: "%", Kind.MISALIGNMENT: "%", Kind.OFFSET: "mg", Kind.SLOPE: "mg/C"}
FACTORS = {Kind.SCALE: 100.0, Kind.MISALIGNMENT: 100.0, Kind.OFFSET: 1000.0, Kind.SLOPE: 1000.0}


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter.

    Attributes:
        name: its kind and its axis (of K: row and column).
        column: its column in a study's table; `se_` and this name is that of its standard error.
        ideal: value of a sensor without error, in the table's unit.
        factor: factor from the table's unit to `unit`.
    """

    name: str
    kind: Kind
    column: str
    ideal: float
    unit: str
    factor: float

    @property
    def label(self) -> str:
        """Name for people."""
        return self.name.replace("_", " ")


AXES = ("x", "y", "z", "yx", "zx", "zy", "x", "y", "z", "x", "y", "z")
PARAMETERS = tuple(
    Parameter(f"{kind}_{axes}", kind, column, float(kind is Kind.SCALE), UNITS[kind], FACTORS[kind])
    for kind, axes, column in zip((kind for kind in Kind for _ in range(3)), AXES, COLUMNS, strict=True)
)
"""The parameters, in the order of the core's PARAMETER_NAMES."""

SCALES, OFFSETS, SLOPES = slice(0, 3), slice(6, 9), slice(9, 12)
IDEAL = np.array([parameter.ideal for parameter in PARAMETERS])
FACTOR = np.array([parameter.factor for parameter in PARAMETERS])


@dataclass(frozen=True, slots=True, order=True)
class DeviceKey:
    """Device and format, which recordings must share to be compared: one sensor, read in one way.

    Attributes:
        serial: as in the table.
        model, format: empty where the table has none.
    """

    serial: str
    model: str
    format: str

    @property
    def kind(self) -> tuple[str, str]:
        """Model and format: devices of one kind are compared with each other."""
        return self.model, self.format


@dataclass(frozen=True, slots=True, eq=False)
class Records:
    """The recordings of all devices that are known, n of them: by device, start and path.

    Attributes:
        devices: d of them; the recordings of device j are rows first[j] to first[j + 1].
        text: columns of text, by name.
        number: columns of numbers (n,), NaN for none.
        values, errors: (n, 12) parameters and their standard errors, in the table's units; NaN where
            the recording's model did not fit them.
        days: (n,) start of the recording [days since 1970]; NaN where it is not known.
        nameless: number of recordings that name no device; they are not among the n.
        failed: number of these that could not be read at all.
        excluded: number of recordings that people excluded, which are not among the n either.
    """

    devices: tuple[DeviceKey, ...]
    first: Indices
    text: dict[str, list[str | None]]
    number: dict[str, Floats]
    values: Floats
    errors: Floats
    days: Floats
    nameless: int = 0
    failed: int = 0
    excluded: int = 0

    def __len__(self) -> int:
        return len(self.days)

    def rows(self, device: int) -> range:
        """Return the rows of a device."""
        return range(int(self.first[device]), int(self.first[device + 1]))

    def copied(self, row: int) -> str | None:
        """Return the path of the device's first recording with the same bytes; None if this is the first."""
        device = int(self.first.searchsorted(row, side="right")) - 1
        hashes, hash_ = self.text["sha256"], self.text["sha256"][row]
        first = next(one for one in self.rows(device) if one == row or (hash_ and hashes[one] == hash_))
        return None if first == row else self.text["path"][first]

    def device_of(self) -> Indices:
        """Return the number of each row's device, (n,)."""
        return np.repeat(np.arange(len(self.devices)), np.diff(self.first))


def read(out: Path, now_s: float, *, keep_teaching: bool = False) -> Records:
    """Read the table of the study in a folder.

    Args:
        now_s: the time [s since 1970]; recordings that begin later have no date.
        keep_teaching: recordings that people excluded count too.

    Raises:
        UsageError: there is no table.
        UnreadableError: it cannot be read, or is not the table of a study.
    """
    path = out / NAME
    _check_there(path)
    rows = [] if keep_teaching else read_columns(path, decisions.READ).to_pylist()
    gone = decisions.excluded(out, rows)
    return replace(records(columns(path, gone), now_s / DAY_S + AHEAD_DAYS), excluded=len(gone))


def columns(path: Path, gone: Collection[str]) -> dict[str, Any]:
    """Read the requested columns: lists of text, arrays of numbers (NaN for none).

    Args:
        gone: paths of recordings that are left out.
    """
    table = read_columns(path, WANTED)
    table = table.filter([one not in gone for one in table["path"].to_pylist()]) if gone else table
    try:
        found: dict[str, Any] = {name: _values(table[name], "text", str) for name in TEXT}
        for name in (*NUMBERS, *COLUMNS, *ERRORS):
            found[name] = np.array(_values(table[name], "numbers", int, float), np.float64)  # NaN for None
        return found
    except ValueError as error:
        raise UnreadableError(f"cannot be read ({error})", path=path, hint="run the study again") from error


def _check_there(path: Path) -> None:
    if is_file(path):
        return
    if matching(path.parent, "study.*-of-*.parquet"):
        raise UsageError(
            "does not exist; only shards have been run", path=path, hint="run the study with --collect first"
        )
    folder, reports = path.parent, "*.calibration.json"
    hint = "give the folder that was given to `accelcal study` with -d"
    if is_file(folder):
        raise UsageError("is a file, not the output folder of a study", path=folder, hint=hint)
    if not is_folder(folder):
        raise UsageError("does not exist", path=folder, hint="check the path")
    hint += ", or run the study first"
    if matching(folder, reports):
        hint += f"; for pages of single reports: accelcal report {shlex.quote(printable(folder))}/{reports}"
    raise UsageError(f"is not the output folder of a study: no {path.name}", path=folder, hint=hint)


def _values(column: pa.ChunkedArray, what: str, *kinds: type) -> list[Any]:
    """Return the values of a column; raises ValueError for another type."""
    values: list[Any] = column.to_pylist()  # without pandas (a third of a second), which Arrow would load
    if not all(value is None or isinstance(value, kinds) for value in values):
        raise ValueError(f"a column of {what} is {column.type}")
    return values


def records(table: dict[str, Any], latest_day: float) -> Records:
    """Sort columns of a table into recordings of devices; see `Records`."""
    days = [day(start, latest_day) for start in table["start_time"]]
    keys = _keys(table)
    starts = [(isnan(begin), 0.0 if isnan(begin) else begin) for begin in days]
    order = sorted(keys, key=lambda row: (keys[row], starts[row], table["path"][row] or ""))
    devices = tuple(dict.fromkeys(keys[row] for row in order))
    number = {device: index for index, device in enumerate(devices)}
    counts = np.bincount([number[keys[row]] for row in order], minlength=len(devices))
    nameless = [outcome for row, outcome in enumerate(table["outcome"]) if row not in keys]
    values, errors = _parameters(table, order)
    return Records(
        devices,
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        {name: [table[name][row] for row in order] for name in TEXT},
        {name: _possible(table[name][order]) for name in NUMBERS},
        values,
        errors,
        np.array([days[row] for row in order], np.float64),
        nameless=len(nameless),
        failed=nameless.count(FAILED),
    )


def _keys(table: dict[str, Any]) -> dict[int, DeviceKey]:
    """Return the device of each row that names one."""
    rows = enumerate(zip(table["device_serial"], table["device_model"], table["format"], strict=True))
    return {row: DeviceKey(serial, model or "", name or "") for row, (serial, model, name) in rows if serial}


def _parameters(table: dict[str, Any], order: list[int]) -> tuple[Floats, Floats]:
    values = np.stack([table[name][order] for name in COLUMNS], axis=1)
    errors = np.stack([table[name][order] for name in ERRORS], axis=1)
    models = [table["model"][row] for row in order]
    masks = {name: [index in known.free for index in range(len(COLUMNS))] for name, known in MODELS.items()}
    none = [False] * len(COLUMNS)
    free = np.array([masks.get(model or "", none) for model in models], bool).reshape(values.shape)
    values, errors = np.where(free, _possible(values), nan), _possible(errors)
    return values, np.where(np.isfinite(values) & (errors >= LEAST_ERROR), errors, nan)


def _possible(numbers: Floats) -> Floats:
    """Replace numbers that no study writes by NaN, so that no sum of squares overflows."""
    return np.where(np.abs(numbers) <= LARGEST, numbers, nan)


def day(start: str | None, latest_day: float) -> float:
    """Return a start in days since 1970; NaN if there is none, or the clock cannot have been set."""
    try:
        moment = datetime.fromisoformat(start or "")
    except ValueError:
        return nan
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    days = (moment - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds() / DAY_S
    return days if EARLIEST_DAY <= days <= latest_day else nan


class Usage(StrEnum):
    """Use of a recording's coefficients."""

    USED = "used"
    UNDATED = "undated"
    """Counted, but not for the drift: the recording has no start, or an impossible one."""
    COPY = "copy"
    """The same file as another recording of the device."""
    REFUSED = "refused"
    BORROWED = "borrowed"
    GOOD = "already good"
    """Nothing was fitted, since nothing improves on the raw data."""
    SHARED = "shared"
    """The very coefficients of another recording: they were found once."""
    NO_ERRORS = "no errors"
    """The coefficients have no standard errors."""
    OTHER_MODEL = "other model"
    """The offsets include the scale errors, and most other recordings' do not, or the reverse."""


COUNTED = (Usage.USED, Usage.UNDATED)
"""Usages of recordings whose coefficients count."""

NOT_OWN: dict[str, Usage] = {
    Outcome.REFUSED: Usage.REFUSED,
    Outcome.BORROWED: Usage.BORROWED,
    Outcome.ALREADY_GOOD: Usage.GOOD,
}

NOT_CALIBRATED = (Usage.REFUSED, Usage.BORROWED)
"""Usages of recordings that could not be calibrated by themselves."""

OWN = (Usage.USED, Usage.UNDATED, Usage.OTHER_MODEL, Usage.NO_ERRORS, Usage.GOOD)
"""Usages of recordings whose held-out error is that of their own calibration."""


@dataclass(frozen=True, slots=True)
class _Evidence:
    """Facts that decide on the usage of recordings, by row, looked up once.

    Attributes:
        file: the recording's hash; its row where it has none.
        values: its parameters as bytes.
        fitted, scaled: any parameter was fitted; all scales were fitted.
        weighed: there are standard errors.
    """

    records: Records
    file: list[str]
    values: list[bytes]
    fitted: Mask
    scaled: Mask
    weighed: Mask
    dated: Mask


def usages(records: Records) -> list[Usage]:
    """Return the usage of each recording."""
    known = np.isfinite(records.values)
    evidence = _Evidence(
        records,
        [name or str(row) for row, name in enumerate(records.text["sha256"])],
        [row.tobytes() for row in records.values],
        np.any(known, axis=1),
        np.all(known[:, SCALES], axis=1),
        np.any(np.isfinite(records.errors), axis=1),
        np.isfinite(records.days),
    )
    return [
        use for device in range(len(records.devices)) for use in _of_device(evidence, records.rows(device))
    ]


def _of_device(evidence: _Evidence, rows: range) -> list[Usage]:
    pairs = {(evidence.values[row], evidence.file[row]) for row in rows}
    sharing = Counter(values for values, _ in pairs)
    files: set[str] = set()
    usage = []
    for row in rows:
        copy = evidence.file[row] in files
        files.add(evidence.file[row])
        usage.append(Usage.COPY if copy else _single(evidence, row, shared=sharing[evidence.values[row]] > 1))
    # those that fitted no scale are set aside, or those that did, whichever are fewer
    scaled = [evidence.scaled[row] for row, use in zip(rows, usage, strict=True) if use in COUNTED]
    usual = 2 * sum(scaled) >= len(scaled)
    return [
        Usage.OTHER_MODEL if use in COUNTED and evidence.scaled[row] != usual else use
        for row, use in zip(rows, usage, strict=True)
    ]


def _single(evidence: _Evidence, row: int, *, shared: bool) -> Usage:
    own = NOT_OWN.get(evidence.records.text["outcome"][row] or "")
    if own is not None:
        return own
    if not evidence.fitted[row]:
        return Usage.REFUSED if evidence.records.text["model"][row] is None else Usage.GOOD
    if shared:
        return Usage.SHARED
    if not evidence.weighed[row]:
        return Usage.NO_ERRORS
    return Usage.USED if evidence.dated[row] else Usage.UNDATED


def mask(usage: list[Usage], *wanted: Usage) -> Mask:
    """Return which recordings have one of these usages, (n,)."""
    return np.array([use in wanted for use in usage], bool)


# Good calibrations of a study, or of another registry, added to a registry of devices.


def added(out: Path, path: Path, *, keep_teaching: bool = False) -> str:
    """Add the good calibrations of a study's folder, or of a registry, to a registry; return what was done.

    Recordings that people excluded are not added, and removed if they are there.

    Args:
        keep_teaching: recordings that people excluded count too.

    Raises:
        UsageError: the folder has no table, or the registry's name is that of another kind of file.
        OutputError: there is a file that is not a registry, or it cannot be written.
        UnreadableError: the study or a registry cannot be read.
    """
    refuse_misnamed(path, ".json")
    if is_file(path) and not is_registry(path):
        raise OutputError(
            "is there, and is not a registry of devices", path=path, hint="give the name of a new file"
        )
    held = read_registry(path) if is_file(path) else []
    more, gone = (read_registry(out), set()) if is_registry(out) else _of_study(out, keep_teaching)
    entries = merged(one for one in (*held, *more) if one.order()[1] not in gone)
    write_registry(path, entries)
    devices = len({one.order()[0] for one in entries})
    before, now = ({one.order()[:2] for one in some} for some in (held, entries))
    calibrations = counted(len(entries), "good calibration")
    removed = f"; {len(before - now)} removed, which people excluded" if before - now else ""
    news = f"{len(now - before)} of them new{removed}"
    return f"{printable(path)}: {calibrations} of {counted(devices, 'device')}, {news}"


def _of_study(out: Path, keep_teaching: bool) -> tuple[list[RegistryEntry], set[str]]:
    """Return the entries of the reports in a study's table, and the hashes of those that people excluded."""
    _check_there(out / NAME)
    rows = read_columns(out / NAME, ("report", *decisions.READ)).to_pylist()
    gone = {} if keep_teaching else decisions.excluded(out, rows)
    kept = [row for row in rows if row["path"] not in gone]
    entries = []
    for report in (out / row["report"] for row in kept if isinstance(row["report"], str)):
        quality = report.with_name(report.name.removesuffix(REPORT_SUFFIX) + QUALITY_SUFFIX)
        if (entry := entry_of(report, quality)) is not None:
            entries.append(entry)
    return entries, {row["sha256"] for row in rows if row["path"] in gone} - {row["sha256"] for row in kept}
