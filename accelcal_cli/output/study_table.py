"""The table of a study, `study.parquet`, for all who read columns of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.identity import STUDY, refuse_other
from accelcal_cli.core.recording import METADATA_KEY
from accelcal_cli.output.files import parsed

if TYPE_CHECKING:
    import pyarrow as pa

NAME = "study.parquet"


def read_columns(path: Path, names: Sequence[str]) -> pa.Table:
    """Read columns of the table of a study.

    Raises:
        UnreadableError: it cannot be read, or is not such a table, or is one of another version.
    """
    import pyarrow as pa  # which --help does not need
    import pyarrow.parquet as pq

    try:
        with path.open("rb") as source, pq.ParquetFile(source, pre_buffer=False) as file:
            schema = file.schema_arrow
            refuse_other(_identity(schema), STUDY, path)
            for name in names:
                if (number := schema.names.count(name)) != 1:
                    raise ValueError(f"it has {'more than one' if number else 'no'} column {name}")
            return file.read(columns=list(names), use_threads=False)
    except (pa.ArrowException, OSError, ValueError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise UnreadableError(f"cannot be read ({reason})", path=path, hint="run the study again") from error


def _identity(schema: pa.Schema) -> Any:
    """Return what a table says of itself; tables of development versions have no more than a column."""
    about = (schema.metadata or {}).get(METADATA_KEY)
    if about is not None:
        return parsed(about)
    return {"accelcal_version": None} if {"path", "accelcal_version"} <= {*schema.names} else None
