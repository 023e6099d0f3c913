"""A small study folder, and what its outputs hold."""

from __future__ import annotations

import contextlib
import csv
import json
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from tests.cli.run import Ran, run, without_capture
from tests.recordings import directions, still_counts, write_raw

NAMES = ("north/a.raw", "north/b.raw", "south/deep/c.raw")


def study_folder(folder: Path, names: tuple[str, ...] = NAMES) -> Path:
    """Good recordings, the later ones longer, and files that are none."""
    for number, name in enumerate(names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_raw(path, still_counts(directions(60 + 2 * number), seed=number + 1))
    (folder / "readme.txt").write_text("recorded in spring\n")
    (folder / ".hidden.cwa").write_bytes(b"x")
    return folder


def results(out: Path) -> dict[str, object]:
    """All outputs by name, without provenance; the ledger knows times and is left out."""
    found: dict[str, object] = {}
    for path in sorted(out.rglob("*")):
        if path.is_dir() or path.suffix == ".ledger":
            continue
        content: object = path.read_bytes()
        if path.suffix == ".json":
            content = {
                key: value for key, value in json.loads(path.read_text()).items() if key != "provenance"
            }
        found[path.relative_to(out).as_posix()] = content
    return found


def study(*given: Any, code: int | None = None) -> Ran:
    """Run on a folder, given before more words, with the outputs in `out` beside it."""
    folder, *words = without_capture(given)
    return run("study", folder, "-d", folder.parent / "out", "-j", 2, *words, code=code)


def run_in(folder: Path, *words: object) -> Ran:
    """Run in this process with a current folder; its workers are forked from the server of earlier runs."""
    with contextlib.chdir(folder):
        return run(*words)


def study_in(here: Path, *words: object, folder: str = "in", out: str = "out", jobs: int = 2) -> Ran:
    """A study of a folder below `here`, whose outputs lie there, too; named from there."""
    return run_in(here, "study", folder, "-d", out, "-j", jobs, *words)


def change_ledger(out: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Change each entry of a study's ledger; its checksum is right again."""
    texts = []
    for line in (out / "study.ledger").read_bytes().splitlines():
        change(entry := json.loads(line.partition(b" ")[2]))
        texts.append(json.dumps(entry).encode())
    lines = [f"{zlib.crc32(text):08x} ".encode() + text + b"\n" for text in texts]
    (out / "study.ledger").write_bytes(b"".join(lines))


def rows(out: Path, name: str = "study") -> list[dict[str, str]]:
    """All columns of the table, as CSV would have them."""
    return texts_of(pq.read_table(out / f"{name}.parquet"))


def csv_rows(out: Path) -> list[dict[str, str]]:
    """The table for people."""
    with (out / "study.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def texts_of(table: pa.Table) -> list[dict[str, str]]:
    return [{name: "" if one is None else str(one) for name, one in row.items()} for row in table.to_pylist()]
