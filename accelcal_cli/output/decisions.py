"""decisions.csv: what people decided about the recordings of a study, and whom they exclude by it.

The file is a person's: it is read with care, and never written. A row that makes no sense is a finding, and
the rest counts. A file that cannot be read at all is an error, since no exclusion may be lost in silence.
"""

from __future__ import annotations

import codecs
import contextlib
import csv
import io
import json
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, islice
from pathlib import Path
from typing import Any, NoReturn

from accelcal_cli.core.errors import FORMULA, Reason, UnreadableError, printable
from accelcal_cli.core.paths import is_file, open_found
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.unpacking import plain_name
from accelcal_cli.output.files import looking_at
from accelcal_cli.output.sentences import sentence

Row = Mapping[str, Any]
Content = tuple[Any, ...]
CONTENT = ("sha256", "sensor")
"""Columns of the table by which a recording is known under any name."""
WORD = re.compile(r"[^\W_]+")

NAME = "decisions.csv"
COLUMNS = ("recording", "use", "note", "who", "when", "result")
"""Columns of the file, of which the first two are needed."""
AS_IN_TABLE = {"recording": "path", "who": "decided_by", "when": "decided_at"}
"""Names of some of them in study.csv, which people copy."""
USES = {
    "yes": "yes", "use": "yes", "with care": "with care", "care": "with care",
    "no": "no", "exclude": "no", "excluded": "no",
}  # fmt: skip
"""Words of `use`, and what they stand for in the table of a study."""
CAUTIOUS = ("no", "with care", "yes")
"""Values of `use` in the table, the most cautious first."""
CHANGED = ("use", "why", "decided_by", "decided_at", "note")
"""Columns of the table that a decision fills."""
READ = ("path", "use", "why", "decided_by", "result", "sha256", "sensor", "device_serial")
"""Columns of the table by which it is known who is excluded."""
WITHOUT_DATA = (Outcome.REFUSED, "failed")
SOMEBODY = "a person"
"""Value of `decided_by` if the file names nobody."""

LARGEST, MOST_ROWS, LONGEST = 64 << 20, 200_000, 2000
"""Bounds: bytes of the file, its rows, and characters that are kept of a cell."""
MOST_LISTED, MOST_SHOWN, MOST_GONE, ROWS_BYTES, INDENT_BYTES = 1000, 10, 10_000, 24 << 20, 80
"""Bounds on what `study.json` holds, so that it can be read again: entries of a list, row numbers of a
finding, recordings that are gone, bytes of the decisions and of what a row is indented by."""
DELIMITERS = ",;\t"
EXCEL_LINE = re.compile(r"\Asep=.[\r\n]+", re.IGNORECASE)
"""First line that names the delimiter to Excel."""
MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))


@dataclass(frozen=True, slots=True)
class Decision:
    """A row of the file.

    Attributes:
        recording: as it is written there; use: a value of USES.
        result: the column `result` of the table when it was decided; empty if that is not known.
        row: its number in a spreadsheet.
    """

    recording: str
    use: str
    note: str
    who: str
    when: str
    result: str
    row: int


@dataclass(frozen=True, slots=True)
class Decisions:
    """The content of a file of decisions.

    Attributes:
        file: its name.
        findings: what cannot be read in it.
        last: the table of the last run; gone: content of excluded recordings that it does not have, by name.
    """

    file: str
    rows: list[Decision] = field(default_factory=list)
    findings: list[Reason] = field(default_factory=list)
    last: Sequence[Row] = ()
    gone: Mapping[str, Content] = field(default_factory=dict)


@dataclass(slots=True)
class Merged:
    """Decisions put to the rows of a study's table.

    Attributes:
        changes: columns that change, by the path of the recording in the table.
        named: paths of the recordings that rows name; copies of excluded ones change, too.
        rows: the decisions, by the paths of their recordings where these are known.
        findings: what is wrong with decisions.
        gone: content of excluded recordings that are not in the table, by name.
    """

    decisions: Decisions
    changes: dict[str, dict[str, str | None]] = field(default_factory=dict)
    named: set[str] = field(default_factory=set)
    gone: dict[str, Content] = field(default_factory=dict)
    findings: list[Reason] = field(default_factory=list)
    rows: list[Decision] = field(default_factory=list)

    @property
    def excluded(self) -> set[str]:
        """Paths of the recordings that people excluded."""
        return {path for path, change in self.changes.items() if change["use"] == "no"}

    def as_json(self) -> dict[str, Any]:
        """Return the object of `study.json`: the file as it was read."""
        rows = [[getattr(one, name) for name in COLUMNS] for one in self.rows]
        sizes = accumulate(len(json.dumps(row)) + INDENT_BYTES for row in rows)
        there = rows[: sum(size <= ROWS_BYTES for size in sizes)]
        numbers = {"decided": len(self.named), "rows_not_listed": len(rows) - len(there)}
        gone = dict(islice(self.gone.items(), MOST_GONE))
        return {"file": self.decisions.file, **numbers, "gone": gone, "rows": there}


def read_decisions(path: Path) -> Decisions:
    """Read a file of decisions.

    Raises:
        UnreadableError: it is not such a file, or too large.
        OSError: it is not there, or cannot be opened.
    """
    with open_found(path) as file:
        data = file.read(LARGEST + 1)
    if len(data) > LARGEST:
        _refuse(path, f"is larger than {LARGEST >> 20} MiB, which no table of decisions is")
    text = EXCEL_LINE.sub("", _decoded(data).lstrip("\ufeff"))
    delimiter, places = _layout(path, text)
    found, number = Decisions(printable(path.name)), 0
    try:
        lines = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
        for number, cells in enumerate(lines, start=1):
            if number > MOST_ROWS:
                _refuse(path, f"has more than {MOST_ROWS} rows")
            if number > 1:
                _take(found, number, {name: cells[at] for name, at in places.items() if at < len(cells)})
    except csv.Error as error:
        _refuse(path, f"cannot be read as a table from row {number + 1} on ({error})")
    return found


def _refuse(path: Path, what: str) -> NoReturn:
    hint = "a table of decisions (CSV) has the columns recording and use: correct it, or move it away"
    raise UnreadableError(what, path=path, hint=hint)


def _decoded(data: bytes) -> str:
    """Return the text of a file as spreadsheets save it: UTF-8, UTF-16, or that of Western Windows."""
    codings = [coding for mark, coding in MARKS if data.startswith(mark)]
    if b"\0" in data[:2] and not codings:
        codings = ["utf-16-be" if data[:1] == b"\0" else "utf-16-le"]
    for coding in (*codings, "utf-8"):
        with contextlib.suppress(UnicodeDecodeError):
            return data.decode(coding)
    return data.decode("cp1252", "replace")


def _layout(path: Path, text: str) -> tuple[str, dict[str, int]]:
    """Return the delimiter, and the places of the columns that are there, by name."""
    line = text[:LONGEST].splitlines()[:1]
    for delimiter in DELIMITERS:
        head = [name.strip().lower() for cells in csv.reader(line, delimiter=delimiter) for name in cells]
        names = {name: name for name in COLUMNS if name in head}
        names |= {name: its for name, its in AS_IN_TABLE.items() if name not in names and its in head}
        if not {"recording", "use"} <= names.keys():
            continue
        for name in names.values():
            if head.count(name) > 1:
                _refuse(path, f"has the column {name} twice")
        return delimiter, {name: head.index(its) for name, its in names.items()}
    _refuse(path, "has no columns recording and use in its first row")


def _take(found: Decisions, number: int, cells: Mapping[str, str]) -> None:
    """Add a row to the decisions, or what is wrong with it to the findings; an empty row decides nothing."""
    texts = {name: " ".join(_unescaped(cells.get(name, "")).split())[:LONGEST] for name in COLUMNS}
    texts["recording"] = _unescaped(cells.get("recording", ""))[:LONGEST]
    texts["who"] = "" if texts["who"] == SOMEBODY else texts["who"]
    shown = {name: printable(text) for name, text in texts.items()}
    word = " ".join(re.split(r"[\s_-]+", shown["use"].lower()))
    if not (word or shown["note"]):
        return
    if shown["recording"].strip() and word in USES:
        found.rows.append(Decision(**(shown | {"use": USES[word]}), row=number))
        return
    column = "use" if shown["recording"].strip() else "recording"
    found.findings.append(
        Reason.of("decision_unreadable", row=number, column=column, cell=shown[column][:80])
    )


def _unescaped(cell: str) -> str:
    """Return a cell without the apostrophe that keeps spreadsheets from changing it."""
    return cell[1:] if cell[:1] == "'" and FORMULA.match(cell[1:]) else cell


def merged(decisions: Decisions, rows: Iterable[Row], others: Collection[str] = ()) -> Merged:
    """Put decisions to the rows of a table: of rows that contradict each other the more cautious one counts.

    A table that is more cautious stays as it is where the result has changed since, or there are no data.
    An exclusion reaches copies, and the same bytes under a new name.

    Args:
        others: paths of further recordings of the study, which have no row yet.
    """
    table = {row["path"]: row for row in rows}
    found, path_of = Merged(decisions, findings=[*decisions.findings]), _finder([*table, *others])
    of_recording: dict[str, list[Decision]] = {}
    for one in decisions.rows:
        path = path_of(one.recording)
        found.rows.append(replace(one, recording=path or one.recording))
        of_recording.setdefault(path, []).append(one)
    found.named |= of_recording.keys() & table.keys()
    if "" in of_recording:
        _follow(found, table, of_recording[""])
    for name in sorted(found.named):
        _decide(found, name, table[name], of_recording[name])
    excluded = found.excluded
    for group in alike(table, "device_serial", *CONTENT).values():
        reached = [path for path in group if path in excluded]
        for first in reached:  # which grows
            left = {*group} - found.named - found.changes.keys()
            more = sorted(path for path in left if not of_another_name(first, path))
            found.changes |= dict.fromkeys(more, found.changes[first])
            reached += more
    return found


def _follow(found: Merged, table: Mapping[str, Row], lost: Sequence[Decision]) -> None:
    """Exclude the bytes that rows exclude under a name that is gone, except where they had another before."""
    last = {row["path"]: row for row in found.decisions.last if row["sha256"]}
    known = {**found.decisions.gone, **{path: content(row) for path, row in last.items()}}
    theirs = {path for path, row in last.items() if not excludes(row)}
    path_of, now = _finder(known), alike(table, *CONTENT)
    for one in lost:
        held = known.get(path_of(one.recording)) if one.use == "no" else None
        found.gone |= {} if held is None else {one.recording: held}
        names = [path for path in now.get(held or (), []) if path not in found.named]
        names = [path for path in names if path not in theirs or known[path] != held]
        found.changes |= dict.fromkeys(names, _change(one))
        values = {"row": one.row, "recording": one.recording}
        unknown = Reason.of("decision_without_recording", **values)
        found.findings.append(Reason.of("decision_followed", now=names[0], **values) if names else unknown)


def _decide(found: Merged, path: str, row: Row, decisions: Sequence[Decision]) -> None:
    """Decide on one recording."""
    uses = {one.use for one in decisions}
    taken = [one for one in decisions if one.use == min(uses, key=CAUTIOUS.index)][-1]
    if len(uses) > 1:
        rows = [one.row for one in decisions]
        more = {"more": len(rows) - MOST_SHOWN} if len(rows) > MOST_SHOWN else {}
        values = {"recording": path, "rows": rows[:MOST_SHOWN], **more, "use": taken.use}
        found.findings.append(Reason.of("decisions_contradict", **values))
    own = row["use"] if row.get("use") in CAUTIOUS else "no"
    use = min(taken.use, own, key=CAUTIOUS.index)
    values = {"recording": path, "row": taken.row, "decided": taken.use, "use": use}
    if taken.result and row.get("result") and taken.result != row["result"]:
        found.findings.append(Reason.of("decision_outdated", **values))
    elif use != taken.use and row.get("outcome") in WITHOUT_DATA and not row.get("parquet"):
        found.findings.append(Reason.of("decision_without_data", **values))
    else:
        use = taken.use
    if use == taken.use:
        found.changes[path] = _change(taken)


def _change(taken: Decision) -> dict[str, str | None]:
    """Return the columns that change by a decision."""
    values = {"who": taken.who, "when": taken.when, "note": taken.note, "decided": taken.use}
    why = sentence(Reason.of("decided_by_a_person", **values))
    cells = (taken.use, why, taken.who or SOMEBODY, taken.when or None, taken.note or None)
    return dict(zip(CHANGED, cells, strict=True))


def excludes(row: Row) -> bool:
    """Return True if a row of the table is of a recording that a person excluded."""
    return row.get("decided_by") is not None and row.get("use") == "no"


def excluded(folder: Path, rows: Iterable[Row]) -> dict[str, str]:
    """Return why people excluded recordings of a study, by their paths in its table.

    A file of decisions that was changed since the last run of the study counts as it is now.

    Args:
        folder: the study's output folder; rows: its table, with at least the columns READ.
    """
    table = {row["path"]: row for row in rows}
    found = {path: row for path, row in table.items() if excludes(row)}
    path = folder / NAME
    if table and is_file(path):
        with looking_at(path, UnreadableError):
            now = merged(read_decisions(path), table.values())
        found = {path: row for path, row in found.items() if path not in now.named} | now.changes
    return {path: str(row["why"]) for path, row in found.items() if row["use"] == "no"}


def content(row: Row) -> Content:
    """Return the identity of a recording: the hash of its file, and the sensor that is read of it."""
    return tuple(map(row.get, CONTENT))


def alike(rows: Mapping[str, Row], *columns: str) -> dict[tuple[Any, ...], list[str]]:
    """Return the names of rows with a hash, by their values in some columns."""
    found: dict[tuple[Any, ...], list[str]] = {}
    for name, row in rows.items():
        if row.get("sha256"):
            found.setdefault(tuple(map(row.get, columns)), []).append(name)
    return found


def words_of(path: str) -> tuple[set[str], set[str]]:
    """Return the words of a recording's name, and those of its folders that have a digit."""
    folder, _, name = path.lower().rpartition("/")
    stem = plain_name(name.partition(" [")[0]).rpartition(".")[0] or name
    return {*WORD.findall(stem)}, {one for one in WORD.findall(folder) if any(map(str.isdigit, one))}


def of_another_name(path: str, other: str) -> bool:
    """Return True unless all words of one name are in the other's, as in `P001` and `P001 (copy)`."""
    one, two = (named | numbered for named, numbered in map(words_of, (path, other)))
    return not (one <= two or two <= one)


def _finder(paths: Iterable[str]) -> Callable[[str], str]:
    """Return what finds a path, as people write it, or by a name that no other has; "" stands for none."""
    whole, names = {*paths}, dict[str, list[str]]()
    for path in whole:
        names.setdefault(path.rpartition("/")[2], []).append(path)

    def found(named: str) -> str:
        plain = named.strip()
        spelt = (named, plain, plain.replace("\\", "/").removeprefix("./"))
        same = [one for one in spelt if one in whole][:1] or names.get(plain, [])
        return same[0] if len(same) == 1 else ""

    return found
