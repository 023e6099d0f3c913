"""What one command makes of its recordings: `python record.py OUT WORD...` writes OUT/evidence.json.

It runs in a process of its own and imports nothing of the tests: the package may be another checkout's.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import re
import resource
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.main import cli

NO_FACTS = ("provenance", "accelcal_version", "kind", "schema_version")
"""Keys of reports and columns of a study's table that differ from run to run, or with the version."""

LIMITS = {resource.RLIMIT_CPU: 60, resource.RLIMIT_AS: 2 << 30}
"""Limits of a hostile file: seconds and bytes."""

TEMPORARY = re.compile(r"accelcal-bug-\w+|accelcal-[0-9a-f]{6}-[^/'\" ]+")
"""Names of temporary files and folders, which differ from run to run."""


def evidence(out: Path, words: list[str]) -> dict[str, Any]:
    """Run a command and return its exit code, error, reports and hashes of values, as JSON."""
    seen: list[BaseException | None] = []
    for name in ("of_failure", "report_bug"):
        setattr(exit_codes, name, _watched(getattr(exit_codes, name), seen))
    sys.argv = ["accelcal", *words]
    with contextlib.redirect_stderr(io.StringIO()) as err, contextlib.redirect_stdout(io.StringIO()):
        code = exit_codes.run_safely(lambda: cli.main(words, "accelcal", standalone_mode=False))
    said = sorted(line for line in err.getvalue().splitlines() if line.startswith("accelcal: "))
    found: dict[str, Any] = {"exit_code": code, "message": said}
    if seen:
        found["error"] = _error(seen[0])
    if (out / "study.csv").exists():
        found |= _study(out)
    elif reports := list(out.glob("*.calibration.json")):
        found["report"] = _facts(json.loads(reports[0].read_text()))
    files = out.rglob("*.calibrated.parquet")
    return found | {"parquet": {str(path.relative_to(out)): _values(path) for path in files}}


def _watched(function: Any, seen: list[BaseException | None]) -> Any:
    """Return a function that also keeps the exception that is being handled."""

    def watched(*args: Any) -> Any:
        seen.append(sys.exc_info()[1])
        return function(*args)

    return watched


def _error(error: BaseException | None) -> dict[str, Any]:
    places = {name: getattr(error, name, None) for name in ("line", "byte_offset", "hint", "sensors")}
    reason = getattr(error, "reason", None)
    return {"class": type(error).__name__, "reason": reason and reason.as_json(), **places}


def _facts(content: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in content.items() if name not in NO_FACTS}


def _study(out: Path) -> dict[str, Any]:
    table = pq.read_table(out / "study.parquet").to_pylist()
    texts = [{name: "" if one is None else str(one) for name, one in row.items()} for row in table]
    rows = {row["path"]: _facts(row) for row in texts}
    study = _facts(json.loads((out / "study.json").read_text()))
    left_out = {one["path"]: one for one in study.pop("files_left_out")}
    return {"rows": rows, "left_out": left_out, "study": study}


def _values(path: Path) -> dict[str, Any]:
    """Return the number of rows of a Parquet file, and type and SHA-256 of each column's values."""
    table = pq.read_table(path)
    columns = {name: [str(table[name].type), _sha256(table[name])] for name in table.column_names}
    return {"rows": table.num_rows, "columns": columns}


def _sha256(column: pa.ChunkedArray) -> str:
    values = column.to_numpy()
    kept = values.astype(str) if values.dtype == object else values
    digest = hashlib.sha256(np.ascontiguousarray(kept).view(np.uint8).data)
    digest.update(column.is_null().to_numpy().tobytes())
    return digest.hexdigest()


def main(out: Path, words: list[str]) -> None:
    """Write the evidence of a command, whose words `OUT` stand for the folder."""
    if any(word.startswith("hostile") for word in words):
        for limit, most in LIMITS.items():
            resource.setrlimit(limit, (most, most))
    found = evidence(out, [word.replace("OUT", str(out)) for word in words])
    text = json.dumps(found, sort_keys=True).replace(str(out), "OUT")
    (out / "evidence.json").write_text(TEMPORARY.sub("TEMPORARY", text))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
