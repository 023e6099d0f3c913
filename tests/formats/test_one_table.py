"""One table in every container is one recording, and refused alike."""

from __future__ import annotations

import json
import re
import tempfile
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import accelcal
from accelcal_cli.core.errors import AccelcalError
from accelcal_cli.core.recording import Chunk, Recording
from accelcal_cli.formats import open_recording
from tests.formats.one_table import CONTAINERS, START_S, TABLES, Table, table
from tests.recordings import LSB_PER_G, RATE_HZ, directions, still_counts

CHUNK_SAMPLES = dict(zip(CONTAINERS, (1100, 97, 10**6, 7, 300, 64, 37, 250, 9, 150), strict=True))
"""Rows of a chunk: no part of the tables, so that things meet its ends, elsewhere in each container."""

REFERENCE = "csv"
OF_THE_FILE = {"path", "format", "total_bytes"}
OF_THE_TEXT = {"said"}
KNOWN_OR_NOT = ("duration_s", "samples")
"""Facts that a file may not tell before it is read to its end; where two tell them, they are equal."""

CASES = [(made.name, kind) for made in TABLES.values() for kind, one in CONTAINERS.items() if one.holds(made)]
IN_A_STUDY = ("csv", "parquet", "feather", "h5", "npz", "mat")

Found = dict[str, Any]


def read(path: Path, made: Table, kind: str) -> Found:
    """Return what a file gives, by name: of its recording and rows, or of the error that refuses it."""
    try:
        with open_recording(path, made.options) as reader:
            chunks = list(reader.chunks(CHUNK_SAMPLES[kind]))
            return of_recording(reader.recording, made) | of_rows(chunks)
    except AccelcalError as error:
        reason = getattr(error, "reason", None)
        return {
            "error": type(error).__name__,
            "reason": reason and reason.code,
            "message": without_places(error.message, made),
            "sensors": error.sensors,
            "said": str(error),
        }


def of_recording(recording: Recording, made: Table) -> Found:
    """Return all that a recording says but of its file, with notes without places."""
    facts = {name: value for name, value in asdict(recording).items() if name not in OF_THE_FILE}
    return facts | {"notes": [without_places(note, made) for note in recording.notes]}


def of_rows(chunks: list[Chunk]) -> Found:
    """Return all rows of a recording, and the problems told with them."""
    problems = [problem for chunk in chunks for problem in chunk.problems]
    return {
        "rows": sum(map(len, chunks)),
        "counts": joined(chunk.counts for chunk in chunks),
        "times": joined(chunk.time_us for chunk in chunks),
        "breaks": joined(chunk.breaks + chunk.first_sample for chunk in chunks),
        "clock_jumps": joined(chunk.clock_jumps + chunk.first_sample for chunk in chunks),
        "temperature": joined(chunk.temperature_mc for chunk in chunks),
        "gyroscope": joined(chunk.gyro_counts for chunk in chunks),
        "validity": joined(
            np.zeros(len(chunk), np.uint8) if chunk.validity is None else chunk.validity for chunk in chunks
        ),
        "problems": [(one.code, one.count, one.sample, one.empty_rows) for one in problems],
    }


def joined(parts: Any) -> list[Any] | None:
    """The values of all chunks; None if none has any."""
    known = [part for part in parts if part is not None]
    return np.concatenate(known).tolist() if known else None


def without_places(text: str, made: Table) -> str:
    """A sentence without the words of its container: `column 3 ('x')`, `column 'x'`, `/x` and `x` are one."""
    text = re.sub(r"\b(?:line|row) \d+", "ROW", text)
    text = re.sub(r"\b(?:dataset|array|variable)(s?)\b", r"column\1", text)
    text = re.sub(r"\bcolumn \d+ \('[^']*'\)", "PLACE", text)
    return places(made.name).sub("PLACE", text)


@cache
def places(name: str) -> re.Pattern[str]:
    """The names of a table's columns as sentences give them."""
    names = {one for name in TABLES[name].columns for one in (name, name.replace("/", "_"))}
    either = "|".join(map(re.escape, sorted(names, key=len, reverse=True)))
    return re.compile(rf"(?<![\w/])(?:column )?(['\"]?)/?(?:{either})\1(?!\w)")


@cache
def expected(name: str) -> Found:
    """Return what the text file of a table gives."""
    with tempfile.TemporaryDirectory() as folder:
        return read(CONTAINERS[REFERENCE].file(Path(folder), TABLES[name]), TABLES[name], REFERENCE)


def differences(folder: Path, name: str, kind: str) -> dict[str, str]:
    """Return what differs from the text, by name; for the text itself, where it is not right."""
    made, text = TABLES[name], expected(name)
    if kind == REFERENCE:
        wanted = right(made)
        codes = [code for code, *_ in text.get("problems", [])]
        found = text | {"refused": refusal(text, made), "rest_g": rest(text), "codes": codes}
    else:
        wanted, found = text, read(CONTAINERS[kind].file(folder, made), made, kind)
        if ("error" in wanted) != ("error" in found):
            return {"error": shown(wanted.get("message"), found.get("message"))}
    names = sorted(wanted if kind == REFERENCE else {*wanted, *found} - OF_THE_TEXT)
    pairs = {one: (wanted.get(one), found.get(one)) for one in names}
    untold = () if kind == REFERENCE else KNOWN_OR_NOT
    return {
        one: shown(*pair)
        for one, pair in pairs.items()
        if pair[0] != pair[1] and not (one in untold and None in pair)
    }


def right(made: Table) -> Found:
    """Return what is right for a table in any container."""
    return {"refused": made.refused, "rest_g": None if made.refused else 1.0, **made.says}


def refusal(found: Found, made: Table) -> str | None:
    """The pattern of the refusal if it fits, or else the error."""
    said: str | None = found.get("said")
    return made.refused if said and re.search(made.refused or "$.", said) else said


def rest(found: Found) -> float | None:
    """The median length of the acceleration in g, to 1 %; None if none was read."""
    if "error" in found:
        return None
    counts = float(np.median(np.linalg.norm(found["counts"], axis=1)))
    return round(counts / float(found["lsb_per_g"]), 2)


def shown(wanted: Any, found: Any) -> str:
    """The first place where two values differ."""
    if isinstance(wanted, list) and isinstance(found, list) and len(wanted) == len(found):
        row = next(row for row, both in enumerate(zip(wanted, found, strict=True)) if both[0] != both[1])
        return f"[{row}] {wanted[row]} | {found[row]}"
    return f"{str(wanted)[:300]} | {str(found)[:300]}"


@pytest.mark.parametrize(("name", "kind"), [pytest.param(*case, id=": ".join(case)) for case in CASES])
def test_one_table_is_one_recording_in_every_container(tmp_path: Path, name: str, kind: str) -> None:
    assert differences(tmp_path, name, kind) == {}


def test_a_study_of_one_table_in_six_containers(tmp_path: Path) -> None:
    values = still_counts(directions(24)) / LSB_PER_G
    times = START_S + np.round(np.arange(len(values)) / RATE_HZ, 6)
    made = table("a day", {"time": times}, dict(zip("xyz", values.T, strict=True)))
    (tmp_path / "in").mkdir()
    for kind in IN_A_STUDY:
        CONTAINERS[kind].file(tmp_path / "in", made, kind)
    found = accelcal.study(tmp_path / "in", tmp_path / "out", jobs=1, report_only=True, progress=False)
    assert found["outcome"].tolist() == ["calibrated"] * len(IN_A_STUDY)
    reports = [json.loads((tmp_path / f"out/{kind}.calibration.json").read_text()) for kind in IN_A_STUDY]
    assert [one["calibration"] for one in reports] == [reports[0]["calibration"]] * len(IN_A_STUDY)
