"""Still-window means that another tool found, from a CSV table."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.core.recording import FLOAT_LSB_PER_G

LARGEST_G = 100.0
LARGEST_C = 1000.0
ALIASES = {
    "x": ("x", "meanx", "mean_x", "x_mean"),
    "y": ("y", "meany", "mean_y", "y_mean"),
    "z": ("z", "meanz", "mean_z", "z_mean"),
    "temperature_c": ("temperature_c", "temperature", "temp"),
    "weight": ("weight",),
    "posture": ("posture",),
}
"""Column names, in lower case; GGIR calls its means meanx, meany, meanz."""


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """n still windows.

    Attributes:
        counts: (n, 3) int64, means in g times FLOAT_LSB_PER_G.
        temperature_mc: (n,) int64, thousandths of a degree C, or None.
        weight: (n,) float64 above zero, or None.
        posture: (n,) int64, number of the posture that the table names, or None.
    """

    counts: NDArray[np.int64]
    temperature_mc: NDArray[np.int64] | None = None
    weight: NDArray[np.float64] | None = None
    posture: NDArray[np.int64] | None = None

    def __len__(self) -> int:
        return len(self.counts)

    def select(self, which: NDArray[np.bool_]) -> Table:
        """The rows of a mask."""
        warm = None if self.temperature_mc is None else self.temperature_mc[which]
        weight = None if self.weight is None else self.weight[which]
        posture = None if self.posture is None else self.posture[which]
        return Table(self.counts[which], warm, weight, posture)


def read_table(path: Path) -> Table:
    """Read columns x, y, z [g], and temperature_c, weight and posture where there are such.

    Raises:
        UnreadableError: it is no such table, or a value is missing or no finite number.
    """
    frame = _frame(path)
    names = _names(path, list(frame.columns))
    g = np.stack([_numbers(path, frame, names[axis], LARGEST_G) for axis in "xyz"], axis=1)
    warm, weight, posture = None, None, None
    if "temperature_c" in names:
        celsius = _numbers(path, frame, names["temperature_c"], LARGEST_C)
        warm = np.rint(celsius * 1000).astype(np.int64)
    if "weight" in names:
        weight = _weights(path, frame, names["weight"])
    if "posture" in names:
        _refuse_empty(path, frame[names["posture"]].to_numpy(str) == "", names["posture"])
        posture = np.unique(frame[names["posture"]].to_numpy(str), return_inverse=True)[1].astype(np.int64)
    return Table(np.rint(g * FLOAT_LSB_PER_G).astype(np.int64), warm, weight, posture)


def _frame(path: Path) -> pd.DataFrame:
    try:
        options: dict[str, Any] = {"dtype": str, "keep_default_na": False, "skip_blank_lines": False}
        return pd.read_csv(path, sep=_delimiter(path), index_col=False, **options)
    except (OSError, EOFError, zlib.error) as error:
        shown = getattr(error, "strerror", None) or error
        raise UnreadableError(f"cannot be read ({shown})", path=path) from error
    except (ValueError, pd.errors.ParserError) as error:
        raise UnreadableError(f"is no table of points ({error})", path=path, hint=_HINT) from error


_HINT = "give a CSV file with a header line and columns x, y, z in g"


def _delimiter(path: Path) -> str:
    """The first of semicolon and tab that the header line holds; else a comma."""
    head = probe_file(path, ReadOptions()).head.split(b"\n", 1)[0]
    return next((mark for mark in ";\t" if mark.encode() in head), ",")


def _names(path: Path, columns: list[str]) -> dict[str, str]:
    """What the table calls each column that is known."""
    lower = {str(name).strip().lower(): name for name in columns}
    found = {
        key: next(lower[name] for name in names if name in lower)
        for key, names in ALIASES.items()
        if any(name in lower for name in names)
    }
    twice = [name for name in found.values() if f"{name}.1" in columns]
    if twice:
        raise UnreadableError(f"has two columns {twice[0]}", path=path, line=1, hint=_HINT)
    missing = [axis for axis in "xyz" if axis not in found]
    if missing:
        raise UnreadableError(f"has no column {', '.join(missing)}", path=path, line=1, hint=_HINT)
    return found


def _numbers(path: Path, frame: pd.DataFrame, name: str, largest: float) -> NDArray[np.float64]:
    values = pd.to_numeric(frame[name].str.strip(), errors="coerce").to_numpy(np.float64)
    bad = ~(np.abs(values) <= largest)
    if bad.any():
        row = int(bad.argmax())
        shown = str(frame[name].iloc[row])[:40]
        raise UnreadableError(
            f"{name} is {shown!r}, not a number within +-{largest:g}",
            path=path,
            line=row + 2,
            hint="mend or remove this line",
        )
    return np.asarray(values)


def _weights(path: Path, frame: pd.DataFrame, name: str) -> NDArray[np.float64]:
    values = _numbers(path, frame, name, np.finfo(np.float64).max)
    _refuse_empty(path, values <= 0, f"{name} above zero")
    return values


def _refuse_empty(path: Path, bad: NDArray[np.bool_], what: str) -> None:
    if bad.any():
        line = int(bad.argmax()) + 2
        raise UnreadableError(f"has no {what}", path=path, line=line, hint="mend or remove this line")
