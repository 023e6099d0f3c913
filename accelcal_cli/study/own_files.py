"""What a study writes in OUT beside the recordings' outputs, known by name and content.

OUT may be the study's folder itself, and a recording or another program's table may have one of these names.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from accelcal_cli.core.errors import OutputError
from accelcal_cli.study.row import COLUMNS

NAMES = re.compile(r"study(\.\d+-of-\d+)?\.(csv|json|parquet|ledger|lock)")
SUMMARY = (".parquet", ".csv", ".json")
FIRST = list(COLUMNS[:2])
"""With these columns the table of every version begins."""


def of_a_study(path: Path) -> bool:
    """Whether a file was written by a study, as its ledger, its lock or its summary."""
    return NAMES.fullmatch(path.name) is not None and (path.suffix not in SUMMARY or _summary(path))


def refuse_foreign(out: Path, base: str, recordings: Collection[Path], *, force: bool) -> None:
    """Refuse to overwrite with the summary what no study wrote; a recording not even with `force`.

    Raises:
        OutputError: such a file is in the way.
    """
    for path in _foreign(out, base):
        if not force or path.resolve() in {one.resolve() for one in recordings}:
            raise OutputError(
                "is in the way of the study's summary, and was not written by accelcal",
                path=path,
                hint="move it away, or choose another folder with -d",
            )


def _foreign(out: Path, base: str) -> Iterator[Path]:
    for suffix in SUMMARY:
        path = out / f"{base}{suffix}"
        if path.exists() and not _summary(path):
            yield path


def _summary(path: Path) -> bool:
    try:
        if path.suffix == ".parquet":
            return list(pq.read_schema(path).names[:2]) == FIRST
        if path.suffix == ".csv":
            with path.open("rb") as file:
                return file.readline(4096).startswith(",".join(FIRST).encode() + b",")
        held = json.loads(path.read_text(encoding="utf-8"))
        return isinstance(held, dict) and "accelcal_version" in held and "recordings" in held
    except (OSError, ValueError, pa.ArrowException):
        return False
