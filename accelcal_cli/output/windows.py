"""The table of a recording's still windows, with what became of each (docs/outputs.md).

`collect.table` reads it back into the same windows: means and spreads are those of the raw counts, and with
`samples` and `counts_per_g` their sums come out as the integers that they were.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.clock import MICROSECONDS, iso_time
from accelcal_cli.core.local_time import UTC
from accelcal_cli.core.points import Role, Windows, WindowUses
from accelcal_cli.core.recording import METADATA_KEY
from accelcal_cli.output.files import open_plain, replacing, write_csv

if TYPE_CHECKING:
    import pyarrow as pa

ROLE_NAMES = [role.name.lower().replace("_", " ") for role in Role]
TEXT = ("role",)
TIME = "time"
NUMBERS = ("first_sample", "samples", "point", "posture", "fold")
"""Columns of whole numbers; a negative one stands for none."""

COLUMNS = (
    TIME, "first_sample", "samples", "x", "y", "z", "spread_x", "spread_y", "spread_z", "temperature_c",
    "counts_per_g", "role", "point", "posture", "fold", "raw_g", "calibrated_g",
)  # fmt: skip
AXES = "xyz"

WRITTEN_AT_ONCE = 1 << 16
"""Windows that are written at a time; as columns and as text they take up to a kB each."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class WindowTable:
    """The content of the table of m still windows.

    Attributes:
        windows: with their times.
        lsb_per_g: counts per standard g.
        window_uses: of the windows.
        posture, fold: (m,) of each window's point, the fold being the one that held it out; -1 for none.
        calibration: None if the recording was refused.
        utc_offset_s: that the device's clock is ahead of UTC; None if its zone is not known.
    """

    windows: Windows
    lsb_per_g: float
    window_uses: WindowUses
    posture: NDArray[np.int64]
    fold: NDArray[np.int64]
    calibration: Calibration | None
    utc_offset_s: int | None

    def parts(self, number: int) -> Iterator[WindowTable]:
        """Yield parts of at most `number` windows; an empty one if there are none."""
        for start in range(0, max(1, len(self.windows)), number):
            here = slice(start, start + number)
            yield replace(
                self,
                windows=self.windows.select(here),
                window_uses=WindowUses(self.window_uses.role[here], self.window_uses.point[here]),
                posture=self.posture[here],
                fold=self.fold[here],
            )

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return all columns, (m,) each, by name; NaN and negative whole numbers stand for none."""
        windows = self.windows
        assert windows.start_us is not None
        mean_g = windows.sums / (windows.samples[:, np.newaxis] * self.lsb_per_g)
        spread_g = windows.spread / self.lsb_per_g
        heat = after = np.full(len(windows), np.nan)
        if windows.temperature_sums is not None:
            heat = windows.temperature_sums / (windows.samples * 1000)
        if self.calibration is not None:
            after = _lengths(_calibrated(mean_g, windows, heat, self.calibration))
        return {
            TIME: windows.start_us,
            "first_sample": windows.first_sample,
            "samples": windows.samples,
            **{name: mean_g[:, axis] for axis, name in enumerate(AXES)},
            **{f"spread_{name}": spread_g[:, axis] for axis, name in enumerate(AXES)},
            "temperature_c": heat,
            "counts_per_g": np.full(len(windows), self.lsb_per_g),
            "role": np.array(ROLE_NAMES)[self.window_uses.role],
            "point": self.window_uses.point,
            "posture": self.posture,
            "fold": self.fold,
            "raw_g": _lengths(mean_g),
            "calibrated_g": after,
        }


def _calibrated(mean_g: Floats, windows: Windows, heat_c: Floats, calibration: Calibration) -> Floats:
    """Return the calibrated mean of each window, (m, 3), with the correction of its middle."""
    if calibration.correction is not None:
        mean_g = calibration.correction.applied(mean_g, windows.first_sample + windows.samples // 2)
    celsius = np.where(np.isnan(heat_c), calibration.reference_c(), heat_c)
    return np.stack(calibration.applied(list(mean_g.T), celsius), axis=1)


def _lengths(g: Floats) -> Floats:
    x, y, z = g.T
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def is_window_table(path: Path) -> bool:
    """Return True if a file begins with the table's header line; raises OutputError for links and pipes."""
    head = ",".join(COLUMNS).encode() + b"\n"
    try:
        with open_plain(path, "rb") as file:
            return bool(file.read(len(head)) == head)
    except OSError:
        return False


def write_windows(table: WindowTable, path: Path, metadata: dict[str, Any]) -> None:
    """Write a table as Parquet or CSV, by the name's suffix.

    Args:
        metadata: what a Parquet file says of itself.

    Raises:
        OutputError: the file cannot be written.
    """
    parts = table.parts(WRITTEN_AT_ONCE)
    if path.suffix.lower() == ".csv":
        write_csv(path, COLUMNS, (row for part in parts for row in zip(*_cells(part), strict=True)))
    else:
        _write_parquet(parts, path, metadata)


def _cells(table: WindowTable) -> Iterator[Sequence[object]]:
    """Yield the columns as cells of a text, None where there is nothing."""
    columns = table.columns()
    for name in COLUMNS:
        values = columns[name].tolist()
        if name == TIME:
            yield [iso_time(value, table.utc_offset_s) for value in values]
        elif name in NUMBERS:
            yield [None if value < 0 else value for value in values]
        else:
            yield values if name in TEXT else [None if isnan(value) else value for value in values]


def _write_parquet(parts: Iterator[WindowTable], path: Path, metadata: dict[str, Any]) -> None:
    # Not every run writes Parquet, and pyarrow takes as long to load as all of accelcal.
    import pyarrow.parquet as pq

    about = {METADATA_KEY: json.dumps(metadata).encode()}
    tables = (arrow(part).replace_schema_metadata(about) for part in parts)
    first = next(tables)
    with (
        replacing(path) as temporary,
        temporary.open("wb") as file,
        pq.ParquetWriter(file, first.schema, compression="zstd") as writer,
    ):
        for table in chain([first], tables):
            writer.write_table(table)


def arrow(table: WindowTable) -> pa.Table:
    """Return the table as Arrow, null where there is nothing."""
    import pyarrow as pa

    def array(name: str, values: NDArray[Any]) -> pa.Array:
        if name == TIME:
            zone = None if table.utc_offset_s is None else UTC
            return pa.array(values - MICROSECONDS * (table.utc_offset_s or 0), pa.timestamp("us", zone))
        if name in NUMBERS:
            return pa.array(values, pa.int64(), mask=values < 0)
        return pa.array(values) if name in TEXT else pa.array(values, pa.float64(), mask=np.isnan(values))

    columns = table.columns()
    return pa.Table.from_arrays([array(name, columns[name]) for name in COLUMNS], COLUMNS)
