"""Points of still windows from a table: one of `calibrate --windows`, or means of another tool.

The former are read as the windows that they were and give the same points. The latter, without weights and
postures of their own, are collected like a recording's windows, in orientation cells. With them, cells are
kept apart by posture, and a point weighs as much as its rows together.
"""

from __future__ import annotations

import re
import warnings
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.cells import (
    HARMLESS_SPACE,
    MAX_POINTS,
    CellCollector,
    CellSums,
    plausible,
    points_of,
    shared_weights,
    to_points,
    width_for,
)
from accelcal_cli.core.arithmetic import ONE, rounded_quotient
from accelcal_cli.core.errors import UnreadableError, unread
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.core.points import WEIGHT_ONE, PointSet, Saturated, Windows
from accelcal_cli.core.recording import FLOAT_LSB_PER_G
from accelcal_cli.core.settings import Settings

if TYPE_CHECKING:  # pandas takes longer to load than all of accelcal
    import pandas as pd

LARGEST_G, LARGEST_C = 100.0, 1000.0
"""Bounds of a mean [g] and of a temperature [degrees C]."""

LARGEST_SPREAD_G = 2 * LARGEST_G
MOST_SAMPLES = float(1 << 30)
LARGEST_SUM = float(1 << 44)
"""Bound of a window's sum of counts: half a million such sums add up in 64 bits; ten minutes in decimals need
2**40."""

PARQUET_MAGIC = b"PAR1"
ALIASES = {
    "x": ("x", "meanx", "mean_x", "x_mean"),
    "y": ("y", "meany", "mean_y", "y_mean"),
    "z": ("z", "meanz", "mean_z", "z_mean"),
    "temperature_c": ("temperature_c", "temperature", "temp"),
    "weight": ("weight",),
    "posture": ("posture",),
    "samples": ("samples",),
    "counts_per_g": ("counts_per_g",),
    **{f"spread_{axis}": (f"spread_{axis}",) for axis in "xyz"},
}
"""Column names, in lower case; GGIR calls its means meanx, meany, meanz."""

WINDOWS = {"samples", "counts_per_g", "spread_x", "spread_y", "spread_z"}
"""Columns of a table of `calibrate --windows`; its column `posture` is not used."""

WIDEST_SPREAD = 1 << 20
"""Spread [counts] assumed for a window behind another tool's mean, so that it does not count as constant."""

DECIMAL_COMMA = re.compile(r"\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*")
IN_G = re.compile(r"\s*[\[(]g[\])]$")
"""The unit that a column's name may end with."""

SAMPLES_FROM, MANY_ROWS = 2000, 100_000
"""Rows without a weight from which on they may be raw samples, and from which on they surely are."""

REPEATED, COUNT_G = 10, 0.002
"""Raw samples are counts, each of which many rows have; they are further apart than means rounded to mg."""

MOVED, MOVED_SHARE = 0.25, 0.001
"""Raw samples include movement: |a| this far from its median, as a share of it, in this share of rows."""

_HINT = "give a CSV file with a header line and columns x, y, z in g, or a Parquet file with these"
_CORRECT = "correct or remove this line"

Key = tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class PointTable:
    """n still windows of a table.

    Attributes:
        counts: (n, 3) int64, sums over the samples; another tool's mean counts as one sample.
        temperature_mc: (n,) int64, sums of thousandths of a degree C, or None.
        weight: (n,) float64 above zero, or None.
        posture: (n,) int64, number of the posture that the table names, or None.
        samples: (n,) int64, samples of each window; None for another tool's means.
        spread: (n, 3) int64, max - min of the counts; None for another tool's means.
        lsb_per_g: counts per standard g.
    """

    counts: NDArray[np.int64]
    temperature_mc: NDArray[np.int64] | None = None
    weight: NDArray[np.float64] | None = None
    posture: NDArray[np.int64] | None = None
    samples: NDArray[np.int64] | None = None
    spread: NDArray[np.int64] | None = None
    lsb_per_g: float = FLOAT_LSB_PER_G

    def __len__(self) -> int:
        return len(self.counts)

    def select(self, which: NDArray[np.bool_]) -> PointTable:
        """Return the rows of a mask."""
        fields: dict[str, Any] = {name: getattr(self, name) for name in self.__dataclass_fields__}
        rows: dict[str, Any] = {n: part[which] for n, part in fields.items() if isinstance(part, np.ndarray)}
        return replace(self, **rows)


def read_table(path: Path) -> PointTable:
    """Read columns x, y, z [g], and temperature_c, weight and posture, or those of WINDOWS, if there are any.

    Raises:
        UnreadableError: the file is no such table, or a value is missing or not a finite number.
    """
    return table_of(_frame(path), path)


def table_of(frame: pd.DataFrame, path: Path) -> PointTable:
    """Read a data frame; errors name `path`, and the frame's index as lines.

    Raises:
        UnreadableError: see `read_table`.
    """
    names = _names(path, list(frame.columns))
    g = np.stack([_numbers(path, frame, names[axis], LARGEST_G) for axis in "xyz"], axis=1)
    if names.keys() >= WINDOWS:
        return _windows(path, frame, names, g)
    temperature_mc, weight, posture = None, None, None
    if "temperature_c" in names:
        celsius = _numbers(path, frame, names["temperature_c"], LARGEST_C)
        temperature_mc = np.rint(celsius * 1000).astype(np.int64)
    if "weight" in names:
        weight = _numbers(path, frame, names["weight"], np.finfo(np.float64).max)
        _refuse_rows(path, frame, weight <= 0, f"{names['weight']} above zero")
    if "posture" in names:
        _refuse_rows(path, frame, frame[names["posture"]].to_numpy(str) == "", names["posture"])
        posture = np.unique(frame[names["posture"]].to_numpy(str), return_inverse=True)[1].astype(np.int64)
    return PointTable(np.rint(g * FLOAT_LSB_PER_G).astype(np.int64), temperature_mc, weight, posture)


def _windows(path: Path, frame: pd.DataFrame, names: dict[str, str], g: NDArray[np.float64]) -> PointTable:
    """Read the windows of `calibrate --windows` as the integers that they were made of."""
    samples = _numbers(path, frame, names["samples"], MOST_SAMPLES)
    scale = _numbers(path, frame, names["counts_per_g"], FLOAT_LSB_PER_G * LARGEST_G)
    _refuse_rows(path, frame, (samples < 1) | (samples % 1 != 0), "whole number of samples")
    _refuse_rows(
        path, frame, (scale <= 0) | (scale != scale[:1].sum()), "counts_per_g like that of the first row"
    )
    spread_g = [_numbers(path, frame, names[f"spread_{axis}"], LARGEST_SPREAD_G) for axis in "xyz"]
    temperature_mc = None
    if "temperature_c" in names and (frame[names["temperature_c"]] != "").any():
        celsius = _numbers(path, frame, names["temperature_c"], LARGEST_C)
        temperature_mc = np.rint(celsius * 1000 * samples).astype(np.int64)
    sums = g * (samples * scale)[:, np.newaxis]
    _refuse_rows(path, frame, np.abs(sums).max(axis=1, initial=0) > LARGEST_SUM, "possible number of samples")
    return PointTable(
        np.rint(sums).astype(np.int64),
        temperature_mc,
        samples=samples.astype(np.int64),
        spread=np.rint(np.stack(spread_g, axis=1) * scale[:, np.newaxis]).astype(np.int64),
        lsb_per_g=float(scale[0]) if len(frame) else FLOAT_LSB_PER_G,
    )


def _frame(path: Path) -> pd.DataFrame:
    """Read all cells as text or numbers; empty cells are empty text.

    The index is the number of the line, or of the row of a Parquet file, from 1.
    """
    import pandas as pd

    try:
        if probe_file(path, ReadOptions()).head.startswith(PARQUET_MAGIC):
            return _parquet(path)
        options: dict[str, Any] = {"dtype": str, "keep_default_na": False, "skip_blank_lines": False}
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # a line that would be cut off
            header = probe_file(path, ReadOptions()).head.split(b"\n", 1)[0].strip()
            mark = next((one for one in ";\t|, " if one.encode() in header), ",")
            options["sep"] = r"\s+" if mark == " " else mark
            frame = pd.read_csv(path, index_col=False, encoding="utf-8-sig", **options)
        if mark != ",":
            frame = frame.map(_with_point)
        return frame.set_index(frame.index + 2)
    except pd.errors.ParserWarning as error:
        text = "a line has more fields than the header line"
        raise UnreadableError(text, path=path, hint="give each column a name") from error
    except OSError as error:
        raise unread(error, path) from error
    except (EOFError, zlib.error) as error:
        raise UnreadableError(f"cannot be read ({error})", path=path) from error
    except UnicodeDecodeError as error:
        raise UnreadableError("is not a CSV or Parquet table", path=path, hint=_HINT) from error
    except (ValueError, pd.errors.ParserError) as error:
        text = f"is not a table of points ({str(error).strip()})"
        raise UnreadableError(text, path=path, hint=_HINT) from error


def _parquet(path: Path) -> pd.DataFrame:
    """Read the columns that are used; one that is empty throughout is left out."""
    import pyarrow.parquet as pq

    names = pq.read_schema(path).names
    if {"time", "validity"} <= set(names):
        hint = "write these with calibrate --windows"
        raise UnreadableError("holds a recording, not its still windows", path=path, hint=hint)
    wanted = {alias for aliases in ALIASES.values() for alias in aliases}
    columns = [name for name in names if name.strip().lower() in wanted]
    with pq.ParquetFile(path, pre_buffer=False) as file:
        frame = file.read(columns, use_threads=False).to_pandas(use_threads=False)
    frame = frame.dropna(axis=1, how="all").reset_index(drop=True)
    texts = [name for name in frame if name.strip().lower() in ALIASES["posture"]]
    frame[texts] = frame[texts].astype(object).where(frame[texts].notna(), "").astype(str)
    return frame.set_index(frame.index + 1)


def _with_point(cell: Any) -> Any:
    """Replace the decimal comma of a number; other cells are returned unchanged."""
    return cell.replace(",", ".") if isinstance(cell, str) and DECIMAL_COMMA.fullmatch(cell) else cell


def _names(path: Path, columns: list[str]) -> dict[str, str]:
    lower = {IN_G.sub("", str(name).strip(" #").lower()): name for name in columns}
    named = {
        key: next(lower[name] for name in names if name in lower)
        for key, names in ALIASES.items()
        if any(name in lower for name in names)
    }
    twice = [name for name in named.values() if f"{name}.1" in columns]
    if twice:
        raise UnreadableError(f"has two columns named {twice[0]}", path=path, line=1, hint=_HINT)
    missing = [axis for axis in "xyz" if axis not in named]
    if missing:
        raise UnreadableError(f"has no column {', '.join(missing)}", path=path, line=1, hint=_HINT)
    return named


def _numbers(path: Path, frame: pd.DataFrame, name: str, largest: float) -> NDArray[np.float64]:
    import pandas as pd

    cells = frame[name] if pd.api.types.is_numeric_dtype(frame[name]) else frame[name].astype(str).str.strip()
    values = pd.to_numeric(cells, errors="coerce").to_numpy(np.float64)
    bad = ~(np.abs(values) <= largest)
    if bad.any():
        row = int(bad.argmax())
        shown = str(frame[name].iloc[row])[:40]
        text = f"{name} is {shown!r}, not a number within +-{largest:g}"
        raise UnreadableError(text, path=path, line=int(frame.index[row]), hint=_CORRECT)
    return np.asarray(values)


def _refuse_rows(path: Path, frame: pd.DataFrame, bad: NDArray[np.bool_], what: str) -> None:
    if bad.any():
        line = int(frame.index[int(bad.argmax())])
        raise UnreadableError(f"has no {what}", path=path, line=line, hint=_CORRECT)


@dataclass(frozen=True, slots=True, eq=False)
class TablePoints:
    """The points of a table.

    Attributes:
        points: the points to fit, cells of orientation.
        label: (n,) number of each point's posture in the table, from 0, or None.
        rows: each plausible row as a point of its own, for errors over windows.
        implausible: number of rows whose length is not near 1 g.
        saturated: axes that measure nothing beyond a value.
    """

    points: PointSet
    label: NDArray[np.int64] | None
    rows: PointSet
    implausible: int
    saturated: Saturated = ()


def points_of_table(table: PointTable, settings: Settings, path: Path | None = None) -> TablePoints:
    """Return the points of a table's rows, in units of local gravity; errors name `path`.

    Raises:
        UnreadableError: its postures hold too many directions.
    """
    lsb_per_g = table.lsb_per_g * float(settings.gravity.local_g())
    near = plausible(windows_of(table), lsb_per_g, settings)
    kept = table.select(near)
    temperature = settings.temperature and table.temperature_mc is not None
    if table.weight is None and table.posture is None:
        collector = CellCollector(lsb_per_g, settings, temperature=temperature)
        collector.add(windows_of(kept))
        points, label, saturated = collector.points(), None, collector.saturated()
    else:
        points, label = _kept_apart(kept, lsb_per_g, settings, path, temperature=temperature)
        saturated = ()
    return TablePoints(points, label, _rows(kept, lsb_per_g, points), int((~near).sum()), saturated)


def holds_samples(table: PointTable) -> bool:
    """Return True if rows without weights are raw samples rather than means of still windows.

    Means differ in their last digits and are all near the same length.
    """
    if len(table) < SAMPLES_FROM or table.samples is not None or table.weight is not None:
        return False
    if len(table) >= MANY_ROWS:
        return True
    length = np.sqrt((table.counts.astype(np.float64) ** 2).sum(axis=1))
    moved = np.abs(length - np.median(length)) > MOVED * np.median(length)
    values = max((np.unique(column) for column in table.counts.T), key=len)
    apart = np.median(np.diff(values)) if len(values) > 1 else 0.0
    counts = len(values) * REPEATED < len(table) and apart > COUNT_G * table.lsb_per_g
    return bool(counts or moved.mean() > MOVED_SHARE)


def windows_of(table: PointTable) -> Windows:
    """Convert rows to still windows; another tool's mean is a window of one sample."""
    number = len(table)
    samples = np.ones(number, np.int64) if table.samples is None else table.samples
    spread = np.full((number, 3), WIDEST_SPREAD) if table.spread is None else table.spread
    return Windows(samples, np.arange(number), table.counts, spread, table.temperature_mc)


def _kept_apart(
    table: PointTable, lsb_per_g: float, settings: Settings, path: Path | None, *, temperature: bool
) -> tuple[PointSet, NDArray[np.int64] | None]:
    """Return a point for each cell of a posture, and the postures; cells widen if there are too many."""
    keys = _keys(table, lsb_per_g, settings.cells_per_g, temperature=temperature)
    weigh = shared_weights if table.weight is None else _table_weights
    shares = np.ones(len(table), np.int64)
    if table.weight is not None:  # as integers, the largest WEIGHT_ONE
        relative = np.rint(table.weight / table.weight.max(initial=0) * WEIGHT_ONE)
        shares = np.maximum(1, relative.astype(np.int64))
    cells = _cells(table, shares, keys)
    if (width := width_for(cells)).space > HARMLESS_SPACE:
        text = f"holds {len(cells)} combinations of orientation, direction and temperature"
        hint = "leave out the column `posture`, or average rows that are alike"
        raise UnreadableError(f"{text}, and a fit takes at most {MAX_POINTS} points", path=path, hint=hint)
    found, points = points_of(cells, width, weigh, lsb_per_g, temperature=temperature)
    if table.posture is None:
        return points, None
    _, label = np.unique([key[0] for key in found], return_inverse=True)
    return points, label.astype(np.int64)


def _keys(table: PointTable, lsb_per_g: float, cells_per_g: int, *, temperature: bool) -> NDArray[np.int64]:
    """Return posture, cell and degree C of each row, (n, 5)."""
    keys = np.zeros((len(table), 5), np.int64)
    scale = Fraction(lsb_per_g).limit_denominator(1000) / Fraction(cells_per_g)
    if table.posture is not None:
        keys[:, 0] = table.posture
    keys[:, 1:4] = table.counts * scale.denominator // scale.numerator
    if temperature and table.temperature_mc is not None:
        keys[:, 4] = table.temperature_mc // 1000
    return keys


def _cells(table: PointTable, shares: NDArray[np.int64], keys: NDArray[np.int64]) -> dict[Key, CellSums]:
    unique, inverse, number = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    total = np.zeros((len(unique), 5), np.int64)
    milli = np.zeros(len(table), np.int64) if table.temperature_mc is None else table.temperature_mc
    columns = np.column_stack([np.ones_like(shares), table.counts, milli])
    np.add.at(total, inverse.reshape(-1), columns * shares[:, np.newaxis])
    return {
        tuple(key): CellSums(count, samples, (x, y, z), heat)
        for key, count, (samples, x, y, z, heat) in zip(
            unique.tolist(), number.tolist(), total.tolist(), strict=True
        )
    }


def _table_weights(ordered: Sequence[tuple[Key, CellSums]]) -> list[int]:
    """Return weights in the table's proportions; a point of mean weight counts as one."""
    total = sum(sums.samples for _, sums in ordered)
    return [max(1, rounded_quotient(s.samples * len(ordered) * WEIGHT_ONE, total)) for _, s in ordered]


def _rows(table: PointTable, lsb_per_g: float, points: PointSet) -> PointSet:
    """Return each row as a point, with its temperature on the scale of the points that were fitted."""
    scale = points.temperature
    samples = windows_of(table).samples.tolist()
    milli = [0] * len(table) if table.temperature_mc is None else table.temperature_mc.tolist()
    columns = zip(samples, table.counts.tolist(), milli, strict=True)
    sums = [CellSums(1, number, (x, y, z), heat) for number, (x, y, z), heat in columns]
    rows = to_points(sums, [WEIGHT_ONE] * len(sums), lsb_per_g, temperature=False)
    if scale is None:
        return rows
    span, reference = 1000 * round(scale.span_c), scale.reference_mc
    tau = [rounded_quotient((s.temperature_mc - reference * s.samples) * ONE, s.samples * span) for s in sums]
    return replace(rows, tau=np.array(tau, np.int64), temperature=scale)
