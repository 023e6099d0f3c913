"""What a Parquet file of ours says of itself: whose it is, without pyarrow where there is no file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import OutputError
from accelcal_cli.output.atomic import output_error

METADATA_KEY = b"accelcal"


def metadata_of(path: Path) -> dict[str, Any]:
    """What a Parquet file of ours says of itself; empty for any other file, or none."""
    try:
        metadata = json.loads(_held(path)) if path.is_file() else {}
    except (OSError, ValueError):
        return {}
    return metadata if isinstance(metadata, dict) else {}


def _held(path: Path) -> bytes:
    """The JSON of ours that a file carries. Loading pyarrow takes as long as all of accelcal."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with path.open("rb") as file:
            held: bytes = (pq.read_schema(file).metadata or {}).get(METADATA_KEY, b"{}")
    except pa.ArrowException:
        return b"{}"
    return held


def written_by_us(path: Path) -> bool:
    """Whether a Parquet file carries our metadata."""
    return bool(metadata_of(path))


def refuse_foreign(path: Path) -> None:
    """Raise OutputError if a Parquet file exists that accelcal did not write."""
    try:
        there = path.exists()
    except OSError as error:
        raise output_error(error, path) from error
    if there and not written_by_us(path):
        raise OutputError(
            "exists and was not written by accelcal",
            path=path,
            hint="move it away, or use --force to replace it",
        )
