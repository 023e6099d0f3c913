"""Damaged files of our own kinds, through the command: reports, points, poses, tables of a study; odd words.

A target is made for a folder, in which the files that its mutants damage are written once.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from accelcal_cli.verify import PROSE
from tests.fuzz import command
from tests.fuzz.archives import archives
from tests.fuzz.blind import blind
from tests.fuzz.made import GAIN, OFFSET, directions, recording
from tests.fuzz.options import options
from tests.fuzz.rules import rules

ODD: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 1e308, -1e308, 1e-320, 2**31, 2**63, -(2**63), 10**30, 10**400, "", "x"),
    *(
        "\0",
        "\ud800",
        "a/" * 3000,
        "\x1b[31m\x07",
        "/dev/zero",
        "/etc/passwd",
        "../../x",
        [],
        {},
        [[]],
        [None],
    ),
    *({"a": 1}, [1, 2, 3], "9" * 50, "nan", float("nan"), float("inf"), 1.5, "calibrated", "borrowed", "12"),
    *("refused", "9", "9T", "0", "2024-03-04T00:00:00", "Europe/Berlin", "-", "=1+1", "\u202e"),
)
CELLS = (
    *(
        "",
        "nan",
        "inf",
        "-inf",
        "1e400",
        "1e308",
        "-1e308",
        "1e-320",
        "0",
        "5",
        "-5",
        "x",
        "1,5",
        '"',
        "\x00",
    ),
    *("\x1b[31m", "=1", "9" * 400, "1e5", "-0", "127", "0x1", "1 2", "\u0661"),
)
POINT_HEADS = (
    *("x,y,z", "meanx,meany,meanz", "x,y,z,temperature_c", "x,y,z,temperature_c,weight,posture", "X,Y,Z"),
    *("x,y,z,weight", "x,y,z,posture", "x,y", "x,x,y,z", "x,y,z,\x1b[31m", "a,b,c", "x;y;z", ""),
)
FITS = ([], [], ["--json"], ["--model", "9"], ["--no-temperature"], ["--latitude", "0", "--altitude", "9000"])
SESSIONS = ([], ["--segment-seconds", "0.1"], ["--face-degrees", "45"])
TABLES = ([], ["--json"], ["--csv"], ["--device", "1"], ["--rule", "reference_c=25"])
Attempt = Callable[[Random, int, Path, Any], "tuple[bytes, str, str | None]"]


def places(node: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in items:
        yield (*at, key)
        yield from places(value, (*at, key))


def damaged_document(document: Any, random: Random) -> tuple[Any, str]:
    new, names = json.loads(json.dumps(document)), []
    for _ in range(random.choice([1, 1, 1, 2, 3])):
        place = random.choice(list(places(new)) or [()])
        node = new
        for key in place[:-1]:
            node = node[key]
        if place:
            damage_value(node, place[-1], random)
            names.append(".".join(map(str, place)))
    return new, " ".join(names)


def damage_value(node: Any, key: Any, random: Random) -> None:
    value, form = node[key], random.randrange(5)
    if form == 0:
        del node[key]
    elif form == 1 and isinstance(node, dict):
        node[str(random.choice(ODD))[:20]] = value
    elif form == 2 and isinstance(value, int | float) and not isinstance(value, bool):
        node[key] = value * random.choice([-1, 2, 0.5, 1.0000001, 1e6]) + random.choice([0, 1])
    else:
        node[key] = random.choice(ODD)


def damaged_text(text: str, random: Random) -> bytes:
    """JSON, perhaps no longer whole."""
    at, form = random.randrange(len(text)), random.randrange(16)
    if form == 0:
        text = text[:at]
    if form == 1:
        text = (
            text[:at]
            + random.choice(["[", "{", '"', "\\u0000", "\x00", "NaN"]) * random.choice([1, 3000])
            + text[at:]
        )
    if form == 2:
        text = text.replace("1", random.choice(["1e999", "9" * 5000]), 2)
    if form == 3:
        return text.encode("utf-16", "surrogatepass")
    data = text.encode("utf-8", "surrogatepass")
    return blind(data, random) if form == 4 else data


def same(before: Any, after: bytes) -> bool:
    """Whether a damaged report still says the same."""
    try:
        return bool(json.loads(after) == before)
    except (ValueError, RecursionError):
        return False


def reports(folder: Path) -> Attempt:
    source, out = recording(folder / "source.csv"), folder / "out"
    command.run(["calibrate", source, "-d", folder / "good"])
    good_report = folder / "good" / "source.calibration.json"
    good, path = json.loads(good_report.read_text()), folder / "mutant.calibration.json"
    table = good_report.with_name("source.calibrated.parquet")

    def attempt(random: Random, number: int, folder: Path, tally: Any) -> tuple[bytes, str, str | None]:
        new, what = damaged_document(good, random)
        data = damaged_text(json.dumps(new), random)
        path.write_bytes(data)
        form = number % 3
        shutil.rmtree(out, ignore_errors=True)
        if form == 0:
            ran, found = command.checked_run(["apply", "--coefficients", path, source, "-d", out], out)
        elif form == 1:
            ran, found = command.checked_run(["verify", path, source])
            if found is None and ran.code == 0 and not same(good, data) and "provenance" not in what:
                found = verified(ran, what)
        else:
            out.mkdir()
            (out / good_report.name).write_bytes(data)
            shutil.copy(table, out)
            ran = command.run(["calibrate", source, "-d", out, *random.choice([[], ["--force"]])])
            found = command.wrong(ran)
        tally.refused += ran.code != 0
        return data, f"{('apply', 'verify', 'calibrate')[form]} {what}", found

    return attempt


def verified(ran: command.Ran, what: str) -> str | None:
    """A report that says something else is not the same; where the recording lay and prose do not matter."""
    places = what.split()
    spared = all(
        one in ("recording.path", "recording.file")
        or one.startswith("recording.notes")
        or one.rpartition(".")[2] in PROSE
        for one in places
    )
    if spared or "identical" not in ran.shown:
        return None
    return f"VERIFIED though {what} was changed: {ran.shown}"


def points(folder: Path) -> Attempt:
    rows, path, result = directions(60).tolist(), folder / "mutant.csv", folder / "result.json"

    def attempt(random: Random, number: int, folder: Path, tally: Any) -> tuple[bytes, str, str | None]:
        head = random.choice(POINT_HEADS[:4] * 3 + POINT_HEADS)
        width = head.count(",") + 1
        lines = [head]
        for k, row in enumerate(rows):
            more = [f"{20 + k % 7}", f"{1 + k % 5}", f"p{k // 4}"]
            lines.append(",".join([*(f"{value:.6f}" for value in row), *more][:width]))
        what = damaged_lines(lines, random)
        data = ("\n".join(lines) + "\n").encode()
        data = blind(data, random) if random.random() < 0.1 else data
        path.write_bytes(data)
        result.unlink(missing_ok=True)
        words = random.choice(FITS)
        ran, found = command.checked_run(["fit", path, "-o", result, *words])
        if found is None and result.exists():
            json.loads(result.read_text(), parse_constant=command.refuse_constant)
        tally.refused += ran.code != 0
        return data, f"{words} {what}", found

    return attempt


FORMS = (10, 10, 10, 10, 1, 10, 10, 10)
"""How often each; the fifth leaves points in a plane, whose fits take all iterations."""


def damaged_lines(lines: list[str], random: Random) -> str:
    """Cells, lines and columns of a table of numbers."""
    names = []
    for _ in range(random.choice([0, 1, 1, 2, 3])):
        at, form = random.randrange(1, len(lines)), random.choices(range(8), FORMS)[0]
        cells = lines[at].split(",")
        place, odd = random.randrange(len(cells)), random.choice(CELLS)
        if form == 0:
            cells[place] = odd
            lines[at] = ",".join(cells)
        if form == 1:
            lines[at] = random.choice(["", ",,,", "#c", "x,y,z", "1,2", "1,2,3,4,5,6,7,8"])
        if form == 2:
            lines[1:] = [lines[at]] * random.choice([3, 50, 300])
        if form in (3, 4):
            for k in range(1, len(lines)):
                row = lines[k].split(",")
                row[place % len(row)] = odd if form == 3 else row[0]
                lines[k] = ",".join(row)
        if form == 5:
            lines[:] = [line.replace(",", ";") for line in lines]
        if form == 6:
            lines[1:] = random.sample(lines[1:], len(lines) - 1)
        if form == 7:
            del lines[max(2, at) :]
        names.append(str(form))
    return " ".join(names)


def poses(folder: Path) -> Attempt:
    faces = np.repeat(
        np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]), 300, axis=0
    )
    raw = np.linalg.solve(GAIN, faces.T).T - OFFSET
    raw += 0.002 * np.random.RandomState(3).standard_normal(raw.shape)
    rows = [f"{k / 30:.3f},{x:.5f},{y:.5f},{z:.5f}" for k, (x, y, z) in enumerate(raw.tolist())]
    path, listed, out = folder / "mutant.csv", folder / "mutant.poses.csv", folder / "out"

    def attempt(random: Random, number: int, folder: Path, tally: Any) -> tuple[bytes, str, str | None]:
        lines = ["t,x [g],y [g],z [g]", *rows]
        what = damaged_lines(lines, random) if number % 2 else ""
        data = ("\n".join(lines) + "\n").encode()
        path.write_bytes(data)
        header = random.choice(["start,end,ax,ay,az", "start,end,ax_g,ay_g,az_g", "file,start,ax,ay,az"])
        listed.write_text("\n".join([header, *(pose(random) for _ in range(random.choice([0, 3, 6])))]))
        words = [*random.choice(SESSIONS), *([] if number % 2 else ["--poses", listed])]
        words += random.choice([[], ["--unchecked"], ["--unchecked", "--roll", "z," + pose(random)]])
        ran, found = command.checked_run(["six-pose", path, "-d", out, *words], out)
        tally.refused += ran.code != 0
        return data, f"{words} {what}", found

    return attempt


def pose(random: Random) -> str:
    begin = random.uniform(-10, 70)
    length = random.choice([8, 0, -3, 1e9])
    axes = [random.choice(["1", "-1", "0", "9.81", "nan", "1e400", "x", ""]) for _ in range(3)]
    return ",".join([f"{begin:.1f}", f"{begin + length:.1f}", *axes])


def study_tables(folder: Path) -> Attempt:
    source, study = folder / "in", folder / "study"
    source.mkdir(exist_ok=True)
    recording(source / "a.csv")
    command.run(["study", source, "-d", study, "-j", "1", "-q"])
    path = study / "study.parquet"
    base = pq.read_table(path)
    rows = base.to_pylist() * 12

    def attempt(random: Random, number: int, folder: Path, tally: Any) -> tuple[bytes, str, str | None]:
        changed = [dict(row, device_serial=str(k % 3), start_time=start_of(k)) for k, row in enumerate(rows)]
        table, what = damaged_table(changed, base.schema, random)
        pq.write_table(table, path)
        data = path.read_bytes()
        if random.random() < 0.15:
            data = blind(data, random)
            path.write_bytes(data)
        (folder / "mutant.parquet").write_bytes(data)
        ran, found = command.checked_run(["devices", study, *random.choice(TABLES)])
        if found is None and ("NaN" in ran.shown or "Infinity" in ran.shown):
            found = f"NO NUMBER is shown: {ran.shown[:300]}"
        tally.refused += ran.code != 0
        return data, what, found

    return attempt


def start_of(number: int) -> str:
    return f"2024-{1 + number % 12:02d}-04T00:00:00.000000"


def damaged_table(rows: list[dict[str, Any]], schema: Any, random: Random) -> tuple[Any, str]:
    for _ in range(random.choice([1, 3, 10, 60])):
        row, field = random.choice(rows), schema.field(random.randrange(len(schema)))
        try:
            row[field.name] = pa.scalar(random.choice(ODD), field.type).as_py()
        except (pa.ArrowException, OverflowError, UnicodeEncodeError, TypeError):
            row[field.name] = None
    table, form = pa.Table.from_pylist(rows, schema=schema), random.randrange(8)
    at = random.randrange(table.num_columns)
    name = table.column_names[at]
    if form == 0:
        table = table.drop_columns([name])
    if form == 1:
        table = table.set_column(at, name, pa.array([random.choice(["a", "1"])] * len(rows)))
    if form == 2:
        table = table.set_column(at, name, pa.array([[1]] * len(rows)))
    if form == 3:
        table = table.slice(0, random.choice([0, 1, 2]))
    if form == 4:
        table = table.append_column(name, pa.array([1] * len(rows)))
    return table, f"form {form} of {name}"


def study_files(folder: Path) -> Attempt:
    """The files by which a study remembers, for the next run of it: ledger, lock, list of outputs, tables."""
    source, good, out = folder / "given", folder / "done", folder / "again"
    source.mkdir(exist_ok=True)
    recording(source / "a.csv")
    (source / "b.csv").write_text("".join((source / "a.csv").read_text().splitlines(keepends=True)[:300]))
    words = ["study", source, "-j", "1", "-q", "-d"]
    code = command.run([*words, good]).code
    tables = {name: (good / name).read_bytes() for name in ("study.csv", "study.parquet", "study.json")}
    names = sorted([path.name for path in good.iterdir()] + ["study.lock"])

    def attempt(random: Random, number: int, folder: Path, tally: Any) -> tuple[bytes, str, str | None]:
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(good, out)
        other = folder / "other.txt"
        other.write_bytes(b"not ours")
        chosen = random.sample(names, 1 + number % 2)
        what = [damaged_file(out, name, other, random) for name in chosen]
        ran = command.run([*words, out])
        found = command.wrong(ran)
        if found is None and other.read_bytes() != b"not ours":
            found = "ANOTHER'S FILE WRITTEN through a link"
        if found is None and ran.code == code and all(name.startswith("study.") for name in chosen):
            found = other_result(out, tables)
        tally.refused += ran.code != code
        return "".join(what).encode(), " ".join(what), found

    return attempt


def other_result(out: Path, tables: dict[str, bytes]) -> str | None:
    """A study that remembers less works more, and says the same."""
    changed = [name for name, data in tables.items() if (out / name).read_bytes() != data]
    return f"ANOTHER RESULT: {changed}" if changed else None


def damaged_file(folder: Path, name: str, other: Path, random: Random) -> str:
    """Damage, remove, replace or link one of a folder's files; gives what was done."""
    path, form = folder / name, random.randrange(8)
    data = path.read_bytes() if path.exists() else b'{"host": "elsewhere", "pid": 1, "started": 1}'
    if form == 0:
        path.unlink(missing_ok=True)
    elif form == 1:
        path.unlink(missing_ok=True)
        path.symlink_to(random.choice([other, folder / "nowhere", path]))
    elif form == 2:
        path.unlink(missing_ok=True)
        path.mkdir()
    elif form == 3:
        path.write_bytes(random.choice([b"", b"[" * 100_000, b"x" * 5000, b"\xff\xfe", other.read_bytes()]))
    elif form == 4 and name.endswith("json"):
        path.write_bytes(
            json.dumps(damaged_document(json.loads(data), random)[0]).encode("utf-8", "surrogatepass")
        )
    elif form == 5:
        path.write_bytes(data[: random.randrange(len(data) + 1)])
    else:
        path.write_bytes(blind(data, random))
    if random.random() < 0.5 and path.is_file() and not path.is_symlink():
        os.utime(path, (1e9, 1e9))
    return f"{name} {form}"


TARGETS: dict[str, Callable[[Path], Attempt]] = {
    "reports": reports,
    "points": points,
    "poses": poses,
    "studies": study_tables,
    "remembered": study_files,
    "options": options,
    "archives": archives,
    "rules": rules,
}
