"""decisions.csv: what people decided about the recordings of a study, as they and spreadsheets write it.

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
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from pathlib import Path
from typing import Any, NoReturn

from accelcal_cli.core.errors import FORMULA, Reason, UnreadableError, printable
from accelcal_cli.core.paths import is_file, open_found
from accelcal_cli.output.files import looking_at
from accelcal_cli.output.sentences import sentence

NAME = "decisions.csv"
COLUMNS = ("recording", "use", "note", "who", "when", "result")
"""Columns of the file, of which the first two are needed; `path`, as in study.csv, stands for `recording`."""
USES = {
    "yes": "yes", "use": "yes", "with care": "with care", "care": "with care",
    "no": "no", "exclude": "no", "excluded": "no",
}  # fmt: skip
"""Words of `use`, and what they stand for in the table of a study."""
CAUTIOUS = ("no", "with care", "yes")
"""Values of `use` in the table, the most cautious first."""
CHANGED = ("use", "why", "decided_by", "decided_at", "note")
"""Columns of the table that a decision fills."""
READ = ("path", "use", "why", "decided_by", "result")
"""Columns of the table by which it is known who is excluded."""
SOMEBODY = "a person"
"""Value of `decided_by` if the file names nobody."""

LARGEST, MOST_ROWS, MOST_FINDINGS, LONGEST = 64 << 20, 200_000, 100, 2000
"""Bounds: bytes of the file, its rows, findings about them, and characters that are kept of a cell."""
MOST_LISTED, MOST_SHOWN, ROWS_BYTES, INDENT_BYTES = 1000, 10, 32 << 20, 80
"""Bounds on what `study.json` holds, so that it can be read again: entries of a list, row numbers of a
finding, bytes of the decisions and of what a row is indented by."""
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
    """

    file: str
    rows: list[Decision] = field(default_factory=list)
    findings: list[Reason] = field(default_factory=list)


@dataclass(slots=True)
class Merged:
    """Decisions put to the rows of a study's table.

    Attributes:
        changes: columns that change, by the path of the recording in the table.
        rows: the decisions, by the paths of their recordings where these are known.
        findings: what is wrong with decisions.
    """

    decisions: Decisions
    changes: dict[str, dict[str, str | None]] = field(default_factory=dict)
    findings: list[Reason] = field(default_factory=list)
    rows: list[Decision] = field(default_factory=list)

    def said(self) -> list[Reason]:
        """Return the findings, of many only the first."""
        more = len(self.findings) - MOST_FINDINGS
        return [
            *self.findings[:MOST_FINDINGS],
            *([Reason.of("decisions_more", number=more)] if more > 0 else []),
        ]

    def as_json(self) -> dict[str, Any]:
        """Return the object of `study.json`: the file as it was read, and what is wrong with it."""
        rows = [[getattr(one, name) for name in COLUMNS] for one in self.rows]
        sizes = accumulate(len(json.dumps(row)) + INDENT_BYTES for row in rows)
        there = rows[: sum(size <= ROWS_BYTES for size in sizes)]
        found = [{**one.as_json(), "message": sentence(one)} for one in self.said()]
        numbers = {"decided": len(self.changes), "rows_not_listed": len(rows) - len(there)}
        return {"file": self.decisions.file, **numbers, "findings": found, "rows": there}


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
        if "recording" not in names and "path" in head:
            names["recording"] = "path"
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


def merged(decisions: Decisions, rows: Iterable[Mapping[str, Any]], others: Collection[str] = ()) -> Merged:
    """Put decisions to the rows of a table: of rows that contradict each other the more cautious one counts.

    So does the more cautious of a decision and what the table says, if the result has changed since.

    Args:
        others: paths of further recordings of the study, which have no row yet.
    """
    table = {row["path"]: row for row in rows}
    found, lookup = Merged(decisions, findings=[*decisions.findings]), _Lookup([*table, *others])
    of_recording: dict[str, list[Decision]] = {}
    for one in decisions.rows:
        path = lookup.path(one.recording)
        found.rows.append(replace(one, recording=path or one.recording))
        if path is not None:
            of_recording.setdefault(path, []).append(one)
        else:
            values = {"row": one.row, "recording": one.recording}
            found.findings.append(Reason.of("decision_without_recording", **values))
    for path in sorted(of_recording.keys() & table.keys()):
        _decide(found, path, table[path], of_recording[path])
    return found


def _decide(found: Merged, path: str, row: Mapping[str, Any], decisions: Sequence[Decision]) -> None:
    """Decide on one recording."""
    uses = {one.use for one in decisions}
    taken = [one for one in decisions if one.use == min(uses, key=CAUTIOUS.index)][-1]
    if len(uses) > 1:
        rows = [one.row for one in decisions]
        more = {"more": len(rows) - MOST_SHOWN} if len(rows) > MOST_SHOWN else {}
        values = {"recording": path, "rows": rows[:MOST_SHOWN], **more, "use": taken.use}
        found.findings.append(Reason.of("decisions_contradict", **values))
    own = row["use"] if row.get("use") in CAUTIOUS else "no"
    use = taken.use
    if taken.result and row.get("result") and taken.result != row["result"]:
        use = min(taken.use, own, key=CAUTIOUS.index)
        values = {"recording": path, "row": taken.row, "decided": taken.use, "use": use}
        found.findings.append(Reason.of("decision_outdated", **values))
    values = {"who": taken.who, "when": taken.when, "note": taken.note, "decided": taken.use, "own": own}
    why = sentence(Reason.of("decided_by_a_person", **values))
    cells = (use, why, taken.who or SOMEBODY, taken.when or None, taken.note or None)
    found.changes[path] = dict(zip(CHANGED, cells, strict=True))


def excluded(folder: Path, rows: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """Return why people excluded recordings of a study, by their paths in its table.

    A file of decisions that was changed since the last run of the study counts as it is now.

    Args:
        folder: the study's output folder; rows: its table, with at least the columns READ.
    """
    rows = list(rows)
    decided = {row["path"]: row for row in rows if row["decided_by"] is not None}
    path = folder / NAME
    if rows and is_file(path):
        with looking_at(path, UnreadableError):
            decided |= merged(read_decisions(path), rows).changes
    return {path: str(row["why"]) for path, row in decided.items() if row["use"] == "no"}


class _Lookup:
    """Finds the path of a recording that a person named."""

    def __init__(self, paths: Sequence[str]) -> None:
        self._paths = set(paths)
        self._names: dict[str, set[str]] = {}
        for path in paths:
            self._names.setdefault(path.rpartition("/")[2], set()).add(path)

    def path(self, named: str) -> str | None:
        """Return the path of a recording, by its path or a name that no other has; None if there is none."""
        plain = named.strip()
        for one in (named, plain, plain.replace("\\", "/").removeprefix("./")):
            if one in self._paths:
                return one
        same = self._names.get(plain, set())
        return next(iter(same)) if len(same) == 1 else None
