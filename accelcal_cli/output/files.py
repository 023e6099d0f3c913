"""Files that appear complete or not at all, tables as CSV, and whether a Parquet file is one of ours.

What a Parquet file of ours says of itself is read without loading pyarrow where there is no file.
"""

from __future__ import annotations

import contextlib
import csv
import errno
import hashlib
import io
import json
import os
import re
import stat
import time
from collections.abc import Iterable, Iterator, Sequence
from math import isfinite
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NoReturn

from accelcal_cli.core.errors import (
    AccelcalError,
    OutputError,
    UnreadableError,
    output_error,
    printable,
    spreadsheet_cell,
)
from accelcal_cli.core.identity import STUDY, refuse_other
from accelcal_cli.core.paths import is_file
from accelcal_cli.core.paths import stat_or_none as look
from accelcal_cli.core.recording import METADATA_KEY
from accelcal_cli.core.system import PLAIN_FILE, host, lives

if TYPE_CHECKING:
    import pyarrow as pa

LONG_NAME = 160
"""Length [bytes] beyond which a name is replaced by its hash; most disks take 255."""

DEEPEST = 32
"""Most lists and objects in each other; what we write has fewer than ten."""

WIDEST = 64
"""Most bits of a whole number besides its sign."""

OBEYED = re.compile("[\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")
"""Control characters and marks of direction that JSON texts may hold as they are."""

WAIT_S = 0.05
"""Interval [s] at which temporaries are looked for that other processes are to remove."""

_LISTED: dict[Path, tuple[list[str], float]] = {}
"""Names of temporaries in each folder, and the time up to which they need not be listed again."""
_MODES = {"rb": os.O_RDONLY, "r+b": os.O_RDWR, "a": os.O_WRONLY | os.O_APPEND | os.O_CREAT}


@contextlib.contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn an OSError of the block into an OutputError of its file, or of `path` if it names none."""
    try:
        yield
    except OSError as error:
        raise output_error(error, Path(error.filename or path)) from error


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path next to `path` that takes its place when the block ends without error.

    The content is flushed to the disk before the rename. On any error, interruption included,
    the temporary is removed and `path` stays as it was.

    Raises:
        OutputError: the file cannot be written.
    """
    if exists(path) and not is_file(path):  # a rename would replace a device, a pipe or a folder
        raise OutputError("is not a regular file and is not replaced", path=path, hint="give another name")
    temporary = _temporary_name(path)
    try:
        _create(temporary)
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
        with contextlib.suppress(OSError):  # the rename itself is durable where folders can be opened
            handle = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
    except OSError as error:
        raise output_error(error, path) from error
    except OutputError as error:
        error.path = path if error.path == temporary else error.path
        raise
    finally:
        discard(temporary)


def discard(temporary: Path) -> None:
    """Remove a temporary as far as the disk allows it; an earlier error is the one to report."""
    with contextlib.suppress(OSError):
        temporary.unlink(missing_ok=True)


def open_plain(path: Path, mode: str) -> IO[Any]:
    """Open a file of ours in a user's folder; mode `rb` or `r+b`, or `a` for UTF-8 text.

    A link could lead to somebody else's file, and a pipe would be waited for without end.

    Raises:
        OutputError: it is a link, a pipe or anything else but a plain file.
        OSError: it is not there or cannot be opened.
    """
    try:
        handle = os.open(path, _MODES[mode] | PLAIN_FILE, 0o666)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENXIO, errno.EISDIR):
            raise _not_plain(path) from error
        raise
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise _not_plain(path)
    coded, ends = (None, None) if "b" in mode else ("utf-8", "\n")
    return os.fdopen(handle, mode, encoding=coded, newline=ends)


def _not_plain(path: Path) -> OutputError:
    hint = "move it away, or choose another folder with -d"
    return OutputError("is not a plain file", path=path, hint=hint)


def exists(path: Path) -> bool:
    """Return True if an output is there already.

    Raises:
        OutputError: its name cannot be one.
    """
    try:
        return look(path) is not None
    except OSError as error:
        raise output_error(error, path) from error


def temporary_beside(path: Path) -> Path:
    """Make an empty temporary file next to `path`, named by host and process; raises OutputError.

    Those that killed processes of this host left for `path` are removed.
    """
    temporary = _temporary_name(path)
    try:
        _create(temporary)
    except OSError as error:
        discard(temporary)
        raise output_error(error, path) from error
    return temporary


def _temporary_name(path: Path) -> Path:
    """Return a name for a temporary that no other file has."""
    try:
        sweep(path)
    except OSError as error:
        raise output_error(error, path) from error
    return path.with_name(f"{_start(path)}{owner()}.{os.urandom(6).hex()}.tmp")


def owner() -> str:
    """Return the owner in the names of this process's temporaries: `HOST.PROCESS`."""
    return f"{host()}.{os.getpid()}"


def _start(path: Path) -> str:
    """Return how the temporaries of a file begin; a long name would leave no room for the rest."""
    name, encoded = path.name, os.fsencode(path.name)
    short = name if len(encoded) <= LONG_NAME else hashlib.sha256(encoded).hexdigest()[:32]
    return f".{short}."


def _create(path: Path) -> None:
    os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))


def sweep(path: Path) -> None:
    """Remove temporaries of this file whose process on this machine was killed; raises OSError."""
    for name, where, process in _owned(_temporaries(path.parent), [path]):
        if where == host() and not lives(process):
            path.with_name(name).unlink(missing_ok=True)


def sweep_left(paths: Iterable[Path], wait_s: float = 0.0) -> None:
    """Remove temporaries of these files, of which nobody else may write one now, as far as the disk allows.

    Those of living processes of this machine stay.

    Args:
        wait_s: longest wait for other processes to remove theirs.
    """
    below: dict[Path, list[Path]] = {}
    for path in paths:
        below.setdefault(path.parent, []).append(path)
    end = time.monotonic() + wait_s
    for folder, ours in below.items():
        with contextlib.suppress(OSError):
            while (left := _owned(_listed(folder), ours)) and time.monotonic() < end:
                time.sleep(WAIT_S)
            for name, where, process in left:
                if where != host() or not lives(process):
                    (folder / name).unlink(missing_ok=True)


def _owned(names: Iterable[str], paths: Sequence[Path]) -> list[tuple[str, str, int]]:
    """Return those names that are temporaries of the files, each with host and process of its owner."""
    found = []
    starts = tuple(map(_start, paths)) if names else ()
    for name in names:
        start = next((one for one in starts if name.startswith(one)), "")
        where, _, process = name.removeprefix(start).rsplit(".", 2)[0].rpartition(".")
        if start and process.isdigit():
            found.append((name, where, int(process)))
    return found


def _temporaries(folder: Path) -> list[str]:
    """Return names that may be those of our temporaries.

    A folder is not listed again before a hundred times as long as it took: in one with ten thousand
    recordings that would be most of the work.
    """
    now = time.monotonic()
    names, until = _LISTED.get(folder, ([], now))
    if now >= until:
        names = _listed(folder)
        _LISTED[folder] = names, time.monotonic() + 100 * (time.monotonic() - now)
    return names


def _listed(folder: Path) -> list[str]:
    with os.scandir(folder) as entries:
        return [entry.name for entry in entries if entry.name[0] == "." and entry.name.endswith(".tmp")]


def write_text(path: Path, text: str) -> None:
    """Write a whole text file atomically (UTF-8).

    Raises:
        OutputError: the file cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def json_text(value: Any, **form: Any) -> str:
    """Return JSON for programs and people: control characters and marks of direction are escaped.

    Args:
        form: `indent` and `separators` of `json.dumps`.
    """
    text = json.dumps(value, allow_nan=False, ensure_ascii=False, **form)
    return OBEYED.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def parsed(text: str | bytes) -> Any:
    """Return the value of a JSON text of ours, which may have been damaged or made by others.

    Raises:
        ValueError: it is not valid JSON, or holds what we never write: endless or huge numbers, halves of
            characters, lists in lists without end, a name twice in an object.
    """
    try:
        value = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_each_once)
    except RecursionError as error:
        raise ValueError("too deeply nested") from error
    level = [value]
    for _ in range(DEEPEST):
        level = [part for one in level for part in _parts(one)]
        if not level:
            return value
    raise ValueError("too deeply nested")


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object; a name that stands twice in it would let two readers see two reports."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a name occurs twice in an object")
    return found


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a JSON number")


def _parts(value: Any) -> Iterable[Any]:
    """Return the members of a list or an object; raises ValueError for a value that we never write."""
    if isinstance(value, dict):
        return (*value, *value.values())
    if isinstance(value, list):
        return value
    if isinstance(value, str):
        value.encode()
    elif isinstance(value, int) and value.bit_length() > WIDEST:
        raise ValueError("a whole number of more than 64 bits")
    elif isinstance(value, float) and not isfinite(value):
        raise ValueError("a number without end")
    return ()


def csv_text(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return CSV with a header line; None is an empty cell, and no text is a formula to a spreadsheet."""
    text = io.StringIO()
    _put_csv(text, head, rows)
    return text.getvalue()


def write_csv(path: Path, head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write CSV atomically, without all of its text in memory; see `csv_text`.

    Raises:
        OutputError: the file cannot be written.
    """
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        _put_csv(file, head, rows)


def _put_csv(file: IO[str], head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    table = csv.writer(file, lineterminator="\n")
    table.writerow(head)
    table.writerows(map(_cell, row) for row in rows)


def _cell(value: object) -> object:
    return spreadsheet_cell(printable(value) if isinstance(value, str) else value)


@contextlib.contextmanager
def looking_at(path: Path, failure: type[AccelcalError] = OutputError) -> Iterator[None]:
    """Turn an OSError of reading a file into one of our errors: so that it is not mistaken for another
    library's.

    Raises:
        AccelcalError: of the kind `failure`.
    """
    try:
        yield
    except OSError as error:
        hint = "check its permissions and its disk"
        raise failure(f"cannot be read ({error.strerror or error})", path=path, hint=hint) from error


def metadata_of(path: Path, failure: type[AccelcalError] = OutputError) -> dict[str, Any]:
    """Return the metadata of a Parquet file of ours; empty for any other file, or none.

    Raises:
        AccelcalError: of the kind `failure`, if it is there and cannot be read.
    """
    schema = stored_schema(path, failure)
    try:
        metadata = parsed(schema.metadata[METADATA_KEY]) if schema is not None else {}
    except (KeyError, TypeError, ValueError):
        return {}
    return metadata if isinstance(metadata, dict) else {}


def stored_schema(path: Path, failure: type[AccelcalError] = OutputError) -> pa.Schema | None:
    """Return the schema of a Parquet file; None for any other file, or none.

    Raises:
        AccelcalError: of the kind `failure`, if it is there and cannot be read.
    """
    with looking_at(path, failure):
        found = look(path)
        if found is None or not stat.S_ISREG(found.st_mode):
            return None
        from accelcal_cli.parquet import read_schema  # pyarrow takes as long to load as all of accelcal

        return read_schema(path)


def written_by_us(path: Path) -> bool:
    """Return True if a Parquet file carries our metadata; raises OutputError if it cannot be read."""
    return bool(metadata_of(path))


PAGE_MARK, PAGE_HEAD = b'<meta name="generator" content="accelcal ', 256
"""Text that pages of ours have, and the number of first bytes in which it stands."""


def is_page(path: Path) -> bool:
    """Return True if a file is a page that accelcal made; raises OutputError if it cannot be read."""
    with looking_at(path):
        found = look(path, follow=False)
        if found is None or not stat.S_ISREG(found.st_mode):
            return False
        with open_plain(path, "rb") as file:
            return PAGE_MARK in file.read(PAGE_HEAD)


def refuse_foreign(path: Path, *, known: bool) -> None:
    """Raise OutputError if a file exists that is not known to be ours."""
    if not known and exists(path):
        raise OutputError(
            "exists and was not written by accelcal",
            path=path,
            hint="move it away, or use --force to replace it",
        )


# The table of a study, `study.parquet`, for all who read columns of it.

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
