"""Issue 50, item 7: decisions, read as people and spreadsheets write them, and put to a study's table."""

from __future__ import annotations

import csv
import dataclasses
import io
import os
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.output import decisions as module
from accelcal_cli.output.decisions import Decisions, merged, read_decisions
from accelcal_cli.output.files import csv_text, json_text
from accelcal_cli.output.report_reading import LARGEST_BYTES
from accelcal_cli.output.sentences import sentence

PLAIN = (
    "recording,use,note,who,when,result\n"
    "a.cwa,no,Gurt war lose; zu weit,Jörg Müller,2026-11-27T10:00:00+01:00,r1\n"
    "b/c.cwa,with care,,,,\n"
)
RUSSIAN = PLAIN.replace("Jörg Müller", "Анна")


def read(folder: Path, data: bytes | str) -> Decisions:
    path = folder / "decisions.csv"
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return read_decisions(path)


def cells(found: Decisions) -> list[tuple[str, ...]]:
    return [(one.recording, one.use, one.note, one.who, one.when, one.result) for one in found.rows]


EXPECTED = [
    ("a.cwa", "no", "Gurt war lose; zu weit", "Jörg Müller", "2026-11-27T10:00:00+01:00", "r1"),
    ("b/c.cwa", "with care", "", "", "", ""),
]


def semicolons(text: str) -> str:
    out = io.StringIO()
    csv.writer(out, delimiter=";", lineterminator="\n").writerows(csv.reader(io.StringIO(text)))
    return out.getvalue()


@pytest.mark.parametrize(
    "data",
    [
        PLAIN.encode(),
        PLAIN.encode("utf-8-sig"),
        PLAIN.encode("cp1252"),
        PLAIN.encode("utf-16"),
        PLAIN.encode("utf-16-le"),
        PLAIN.encode("utf-16-be"),
        ("\ufeff" + PLAIN).encode("utf-16-be"),
        PLAIN.replace("\n", "\r\n").encode(),
        PLAIN.replace("\n", "\r").encode(),
        semicolons(PLAIN).encode("cp1252"),
        ("sep=;\r\n" + semicolons(PLAIN)).encode("utf-8-sig"),
        PLAIN.replace(",", "\t").encode("utf-16"),
        ("\n".join(",".join(reversed(line.split(","))) for line in PLAIN.splitlines())).encode(),
        PLAIN.replace("recording,use", " Recording , USE ").encode(),
        PLAIN.replace("recording", "path").encode(),
        PLAIN.replace("a.cwa,no", "a.cwa,Exclude").replace("with care", "With_Care").encode(),
        (PLAIN + ",,,,,\n\n,,,\n").encode(),
    ],
    ids=[
        "plain", "mark", "western", "utf-16", "utf-16-le", "utf-16-be", "utf-16-be-mark", "crlf", "cr",
        "excel-german", "excel-sep", "unicode-text", "reordered", "head", "path", "words", "empty rows",
    ],
)  # fmt: skip
def test_decisions_are_read_as_spreadsheets_save_them(tmp_path: Path, data: bytes) -> None:
    found = read(tmp_path, data)
    assert (cells(found), found.findings) == (EXPECTED, [])


def test_two_columns_are_enough(tmp_path: Path) -> None:
    found = read(tmp_path, "use;recording\nno;a.cwa\n;b.cwa\nyes;c.cwa")
    held = [(one.recording, one.use, one.row) for one in found.rows]
    assert held == [("a.cwa", "no", 2), ("c.cwa", "yes", 4)]


def test_the_table_of_a_study_that_a_person_saved_under_another_name_is_read(tmp_path: Path) -> None:
    head = ["path", "use", "why", "decided_by", "decided_at", "note", "result"]
    rows = [["=1+1.cwa", "no", "because", by, "today", None, "r2"] for by in ("B. Meyer", "a person", None)]
    found = cells(read(tmp_path, csv_text(head, rows)))
    assert found == [("=1+1.cwa", "no", "", by, "today", "r2") for by in ("B. Meyer", "", "")]


def test_hostile_cells_stay_texts(tmp_path: Path) -> None:
    """Formulas lose the apostrophe alone, control characters are shown, and a cell has an end."""
    rows = [
        ["'=cmd|' /C calc'!A1", "no", "<script>alert(1)</script>", "@who", "", ""],
        ["a.cwa", "yes", "\x1b[31mred\u202e", "x" * 5000, "", ""],
    ]
    out = io.StringIO()
    csv.writer(out).writerows([module.COLUMNS, *rows])
    first, second = read(tmp_path, out.getvalue()).rows
    assert first.recording == "=cmd|' /C calc'!A1"
    assert first.note == "<script>alert(1)</script>"
    assert second.note == r"\x1b[31mred\u202e"
    assert len(second.who) == module.LONGEST


@pytest.mark.parametrize(
    ("line", "column"),
    [
        ("a.cwa,perhaps", "use"),
        (",no", "recording"),
        ("  ,yes", "recording"),
        ("a.cwa", None),
        ("a,,n", "use"),
    ],
)
def test_a_row_that_says_nothing_is_told(tmp_path: Path, line: str, column: str | None) -> None:
    found = read(tmp_path, f"recording,use,note\n{line}\nb.cwa,no\n")
    assert [one.recording for one in found.rows] == ["b.cwa"]
    assert [one.values["column"] for one in found.findings] == ([] if column is None else [column])
    assert all((one.code, one.values["row"]) == ("decision_unreadable", 2) for one in found.findings)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "has no columns recording and use"),
        (b"x,y,z\n1,2,3\n", "has no columns recording and use"),
        (b"recording,note\na,b\n", "has no columns recording and use"),
        (b"recording,use,use\na,yes,no\n", "has the column use twice"),
        (bytes(range(256)) * 4, "has no columns recording and use"),
        (b"\x89PNG\r\n\x1a\n" + bytes(500), "has no columns recording and use"),
        (b'recording,use\na.cwa,"no\nb.cwa,no\n', "cannot be read as a table from row 2 on"),
        (b"recording,use\na.cwa," + b"x" * 200_000 + b"\n", "cannot be read as a table from row 2 on"),
        (b"PK\x03\x04" + os.urandom(3000), "has no columns recording and use"),
    ],
    ids=["empty", "table", "half", "twice", "bytes", "png", "quote", "cell", "xlsx"],
)
def test_a_file_that_is_no_table_of_decisions_is_refused(tmp_path: Path, data: bytes, words: str) -> None:
    with pytest.raises(UnreadableError, match=words):
        read(tmp_path, data)


def test_a_file_of_a_hundred_megabytes_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "decisions.csv"
    with path.open("wb") as file:
        file.write(b"recording,use\n")
        file.truncate(100 << 20)
    with pytest.raises(UnreadableError, match="is larger than 64 MiB"):
        read_decisions(path)


def test_too_many_rows_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_ROWS", 3)
    assert len(read(tmp_path, "recording,use\na,no\nb,no\n").rows) == 2
    with pytest.raises(UnreadableError, match="has more than 3 rows"):
        read(tmp_path, "recording,use\na,no\nb,no\nc,no\n")


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "decisions.csv")
    began = time.monotonic()
    with pytest.raises(UnreadableError, match="not a plain file"):
        read_decisions(tmp_path / "decisions.csv")
    assert time.monotonic() - began < 5


@given(data=st.binary(max_size=300))
def test_any_bytes_are_rows_or_an_error(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    for start in (b"", b"recording,use\n", "recording;use\n".encode("utf-16")):
        try:
            found = read(tmp_path_factory.mktemp("any"), start + data)
        except UnreadableError:
            continue
        assert all(one.use in module.CAUTIOUS and one.recording.isprintable() for one in found.rows)


TABLE: list[dict[str, Any]] = [
    {"path": "a.cwa", "use": "yes", "why": None, "result": "r1"},
    {"path": "b/c.cwa", "use": "no", "why": "It was refused.", "result": "r2"},
    {"path": "b/d.cwa", "use": "with care", "why": "Careful.", "result": "r3"},
]


def decided(
    tmp_path: Path, text: str, **more: Any
) -> tuple[dict[str, Any], list[tuple[str, dict[str, Any]]]]:
    found = merged(read(tmp_path, text), TABLE, **more)
    return found.changes, [(one.code, dict(one.values)) for one in found.findings]


def test_a_decision_takes_the_place_of_use_and_why(tmp_path: Path) -> None:
    changes, findings = decided(tmp_path, PLAIN)
    assert findings == []
    assert changes["a.cwa"] == {
        "use": "no",
        "why": "A person decided not to use it (Jörg Müller, 2026-11-27T10:00:00+01:00): "
        "Gurt war lose; zu weit.",
        "decided_by": "Jörg Müller",
        "decided_at": "2026-11-27T10:00:00+01:00",
        "note": "Gurt war lose; zu weit",
    }
    assert changes["b/c.cwa"]["why"] == "A person decided to use it with care."
    assert changes["b/c.cwa"]["decided_by"] == "a person"
    assert "b/d.cwa" not in changes


@pytest.mark.parametrize("named", ["b/d.cwa", "d.cwa", r"b\d.cwa", "./b/d.cwa", "  b/d.cwa "])
def test_a_recording_is_known_by_the_names_that_people_give_it(tmp_path: Path, named: str) -> None:
    changes, findings = decided(tmp_path, f"recording,use\n{named},no\n")
    assert (list(changes), findings) == (["b/d.cwa"], [])


def test_a_decision_without_its_recording_is_told(tmp_path: Path) -> None:
    text = "recording,use\nx.cwa,no\nwaits.cwa,no\n"
    changes, findings = decided(tmp_path, text, others={"waits.cwa"})
    assert changes == {}
    assert findings == [("decision_without_recording", {"row": 2, "recording": "x.cwa"})]


def test_a_name_that_two_recordings_have_is_no_recording(tmp_path: Path) -> None:
    _, findings = decided(tmp_path, "recording,use\nc.cwa,no\n", others={"z/c.cwa"})
    assert [code for code, _ in findings] == ["decision_without_recording"]


def test_of_rows_that_contradict_each_other_the_most_cautious_counts(tmp_path: Path) -> None:
    text = "recording,use,who\na.cwa,yes,A\na.cwa,no,B\na.cwa,with care,C\nb/c.cwa,no,D\nb/c.cwa,no,E\n"
    changes, findings = decided(tmp_path, text)
    assert findings == [("decisions_contradict", {"recording": "a.cwa", "rows": [2, 3, 4], "use": "no"})]
    assert (changes["a.cwa"]["decided_by"], changes["b/c.cwa"]["decided_by"]) == ("B", "E")


@pytest.mark.parametrize(
    ("path", "said", "counts"),
    [("a.cwa", "no", "no"), ("b/c.cwa", "yes", "no"), ("b/d.cwa", "yes", "with care")],
)
def test_on_another_result_the_more_cautious_counts(
    tmp_path: Path, path: str, said: str, counts: str
) -> None:
    changes, findings = decided(tmp_path, f"recording,use,result\n{path},{said},r9\n")
    values = {"recording": path, "row": 2, "decided": said, "use": counts}
    assert findings == [("decision_outdated", values)]
    assert [change["use"] for change in changes.values()] == ([said] if said == counts else [])


@pytest.mark.parametrize("said", ["yes", "with care", "no"])
def test_t_without_data_nobody_decides_to_use_a_recording(said: str, tmp_path: Path) -> None:
    for stays, parquet in ((said != "no", None), (False, "a")):
        row = TABLE[1] | {"outcome": "refused", "parquet": parquet}
        found = merged(read(tmp_path, f"recording,use\nb/c.cwa,{said}\n"), [row])
        assert [one.code for one in found.findings] == ["decision_without_data"] * stays
        assert [change["use"] for change in found.changes.values()] == ([] if stays else [said])


def of_bytes(*paths: str, sha256: str = "1", use: str = "yes", by: str | None = None) -> list[dict[str, Any]]:
    row = {"sha256": sha256, "sensor": None, "device_serial": "A", "use": use, "decided_by": by}
    return [row | {"path": path} for path in paths]


@pytest.mark.parametrize("path", ["P1 (copy).b", "P1 backup.b", "P1.b", "x/P1 (2).b"])
def test_r2_an_exclusion_reaches_all_copies_of_its_person(path: str, tmp_path: Path) -> None:
    """In any order of names, but neither those of other people nor what a row is about."""
    rows = of_bytes("P1 (copy).b", "P1 backup.b", "P1 mine.b", "P1.b", "P2.b", "x/P1 (2).b")
    found = merged(read(tmp_path, f"recording,use\n{path},no\nP1 mine.b,yes\n"), rows)
    assert found.excluded == {"P1 (copy).b", "P1 backup.b", "P1.b", "x/P1 (2).b"}
    assert (found.named, found.as_json()["decided"]) == ({path, "P1 mine.b"}, 2)


@pytest.mark.parametrize("night", ["first", "later", "gone between"])
def test_r2_an_exclusion_follows_the_bytes_to_a_new_name(night: str, tmp_path: Path) -> None:
    """Not to a name that they had before, unless it was excluded; nor where a row is about that."""
    last = of_bytes("P7.b") + of_bytes("P5.b", sha256="2")
    if night != "gone between":
        last += of_bytes("P9.b" if night == "later" else "P1.b", use="no", by="B")
    gone = {} if night == "first" else {"P1.b": ("1", None)}
    for text, follows in (("", ["P5.b", "P9.b"]), ("P9.b,yes\n", ["P5.b"])):
        decisions = read(tmp_path, f"recording,use\nP1.b,no\n{text}")
        decisions = dataclasses.replace(decisions, last=last, gone=gone)
        found = merged(decisions, of_bytes("P5.b", "P7.b", "P9.b") + of_bytes("P6.b", sha256="2"))
        assert sorted(found.excluded) == follows
        (one,) = found.findings
        assert (one.code, one.values["now"]) == ("decision_followed", follows[0])
        assert found.as_json()["gone"] == {"P1.b": ("1", None)}


@pytest.mark.parametrize("note", ["", "x" * 100, "\u00e9" * module.LONGEST])
def test_h3_what_a_study_keeps_of_many_decisions_can_be_read_again(note: str, tmp_path: Path) -> None:
    """All of the rows if they fit; else how many are not there, so that nobody takes them for all."""
    number = 199_990 if len(note) < module.LONGEST else 20_000
    every = [module.Decision("a.cwa", "no", note, "", "", "", row) for row in range(2, number + 2)]
    held = merged(module.Decisions("decisions.csv", every), TABLE).as_json()
    assert len(held["rows"]) + held["rows_not_listed"] == number
    assert (held["rows_not_listed"] == 0) == (note == "")
    assert len(json_text(held, indent=2).encode()) < LARGEST_BYTES / 2


def test_h3_rows_that_contradict_are_named_with_how_many_more(tmp_path: Path) -> None:
    text = "recording,use\n" + "".join(f"a.cwa,{use}\n" for use in ["no", "yes"] * 50)
    (found,) = merged(read(tmp_path, text), TABLE).findings
    assert found.values == {"recording": "a.cwa", "rows": list(range(2, 12)), "more": 90, "use": "no"}
    assert sentence(found).startswith(
        "Rows 2, 3, 4, 5, 6, 7, 8, 9, 10, 11 and 90 more contradict each other on "
    )
