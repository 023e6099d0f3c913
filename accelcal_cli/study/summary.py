"""The study in one table, as Parquet and CSV, and its counts as JSON.

Sorted and without times, so that a study that was interrupted ends with the same bytes as one that was not.
"""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from accelcal_cli import __version__
from accelcal_cli.output.atomic import replacing, write_text
from accelcal_cli.study.row import COLUMNS, TEXT, WHOLE


@dataclass(frozen=True, slots=True)
class Summary:
    """A study's result.

    Attributes:
        rows: one a recording, by path.
        waiting: recordings that were not tried yet: too new, too old, or another shard's.
        left_out: files that are no recordings.
        up_to_date: recordings of which nothing had to be done; not part of what is written.
        pools: device, number of recordings, outcome and message of each pool, by name.
    """

    rows: list[dict[str, Any]]
    settings: dict[str, Any]
    waiting: int = 0
    left_out: int = 0
    up_to_date: int = 0
    pools: dict[str, dict[str, Any]] = field(default_factory=dict)

    def outcomes(self) -> dict[str, int]:
        """How many recordings had which outcome."""
        return dict(sorted(Counter(row["outcome"] for row in self.rows).items()))

    def counts(self) -> dict[str, Any]:
        """The content of `study.json`."""
        return {
            "accelcal_version": __version__,
            "recordings": len(self.rows),
            "outcomes": self.outcomes(),
            "models": dict(sorted(Counter(row["model"] for row in self.rows if row["model"]).items())),
            "waiting": self.waiting,
            "left_out": self.left_out,
            "pools": self.pools,
            "settings": self.settings,
        }


def write(summary: Summary, out: Path, name: str) -> None:
    """`NAME.parquet`, `NAME.csv`, and last `NAME.json`.

    Raises:
        OutputError: one cannot be written.
    """
    with replacing(out / f"{name}.parquet") as temporary, temporary.open("wb") as file:
        pq.write_table(_table(summary.rows), file, compression="zstd")
    write_text(out / f"{name}.csv", _csv(summary.rows))
    write_text(out / f"{name}.json", json.dumps(summary.counts(), indent=2, ensure_ascii=False) + "\n")


def _kind(name: str) -> pa.DataType:
    if name in TEXT:
        return pa.string()
    return pa.int64() if name in WHOLE else pa.float64()


def _table(rows: list[dict[str, Any]]) -> pa.Table:
    columns = [pa.array([row[name] for row in rows], _kind(name)) for name in COLUMNS]
    return pa.Table.from_arrays(columns, COLUMNS)


def _csv(rows: list[dict[str, Any]]) -> str:
    text = io.StringIO()
    table = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()
