"""Names and texts that a shell, a terminal, a browser or a spreadsheet could take for more than names.

They go through every command; nothing that comes out may act, and no line may be faked.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote_to_bytes

import click
import pytest

from accelcal_cli.cli.main import cli
from tests.cli.run import Ran, command, nightly, run, run_process
from tests.recordings import directions, still_counts, write_raw
from tests.six_pose.made import session, write_csv

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="such names are not allowed elsewhere")

BODY = "<img src=x onerror=alert(1)>\"'&\x1b[31m\n\t\u202e\u2066$(id)`id`;%s{}|*\udce9\x7f\x85\u2028"
SERIAL = "=<script>alert(1)</script>\"'&\x1b[31m\u202e$(id);`id`,\n2"
FORMULA = re.compile(r"[=@\t\r\n]|[+-](?![0-9.eE+-]*$)")


def recording(folder: Path, lead: str, seed: int = 1) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = write_raw(folder / f"{lead}{BODY}.raw", still_counts(directions(60), seed=seed))
    layout = layout_of(path)
    layout.write_text(layout.read_text().replace("[dump]\n", f"[dump]\nserial = {json.dumps(SERIAL)}\n"))
    return path


def layout_of(path: Path) -> Path:
    return path.with_name(f"{path.stem}.layout.toml")


def assert_harmless(ran: Ran, *codes: int, lines: int | None = None) -> Ran:
    """No character that acts, no traceback, and as many lines on stdout as there should be."""
    for text in (ran.out, ran.err):
        assert_text(text, "\n\t")
    assert ran.code in codes and "a bug in" not in ran.err, ran
    if lines is not None:
        assert len(ran.lines) == lines, ran.out
    return ran


def assert_text(text: str, kept: str) -> None:
    odd = {ascii(char) for char in text if not (char.isprintable() or char in kept)}
    assert not odd, (odd, text[:300])


def assert_cells(text: str) -> list[dict[str, str]]:
    """A CSV table of which no cell is a formula."""
    assert_text(text, "\n")
    read = csv.reader(io.StringIO(text))
    rows = list(read)
    assert not [cell for row in rows for cell in row if FORMULA.match(cell)]
    assert len({len(row) for row in rows}) == 1 and text.count("\n") in (len(rows), len(rows) - 1)
    return [dict(zip(rows[0], row, strict=True)) for row in rows[1:]]


class Elements(HTMLParser):
    """Tags of a page that are there, with their attributes."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))


def assert_page(page: Path, scripts: int) -> None:
    text = page.read_text("utf-8")
    assert_text(text, "\n")
    elements = Elements()
    elements.feed(text)
    tags = [tag for tag, _ in elements.found]
    assert "img" not in tags and tags.count("script") == scripts
    assert not [name for _, held in elements.found for name in held if name.startswith("on")]
    assert "&lt;img" in text and ("alert(1)" in text)
    for tag, held in elements.found:
        target = held.get("href") or ""
        if tag == "a" and not target.startswith("#"):
            assert (page.parent / os.fsdecode(unquote_to_bytes(target))).exists(), target


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A recording with all that `calibrate` makes of it."""
    folder = tmp_path_factory.mktemp("hostile")
    path = recording(folder / f"@{BODY}", "=")
    out = folder / f"-{BODY}"
    ran = run_process(
        "calibrate", "--model", 6, "-d", out, "--html", "--windows", folder / "windows.csv", "--", path
    )
    assert_harmless(ran, 0, lines=1)
    assert len(ran.lines[0].split("\t")) == 11
    beside = {"report": ".calibration.json", "parquet": ".calibrated.parquet", "page": ".html"}
    made = {name: out / f"={BODY}{suffix}" for name, suffix in beside.items()}
    return {"recording": path, "windows": folder / "windows.csv", **made}


def test_calibrate(calibrated: dict[str, Path]) -> None:
    assert_page(calibrated["page"], 0)
    assert_cells(calibrated["windows"].read_text("utf-8"))
    report = json.loads(calibrated["report"].read_text("utf-8"))
    assert_text(report["recording"]["path"], "")
    assert report["recording"]["device"]["serial"].startswith("=<script>")


COMMANDS: dict[str, tuple[tuple[str, ...], tuple[int, ...], int | None]] = {
    "calibrate": (("--json", "--model", "6", "--force", "-d", "{out}", "--", "{recording}"), (0,), 1),
    "apply": (("--coefficients", "{report}", "-d", "{out}", "--", "{recording}"), (0,), 1),
    "inspect": (("--", "{recording}"), (0,), None),
    "inspect --json": (("--", "{recording}"), (0,), 1),
    "apply --report-only": (("--coefficients", "{report}", "-d", "{out}", "--", "{recording}"), (0,), 1),
    "verify": (("{report}", "{recording}", "--values", "--layout", "{layout}"), (0,), 1),
    "fit": (("{windows}",), (0,), 1),
    "report": (("-d", "{out}", "--", "{report}"), (0,), 1),
    "six-pose": (("-d", "{out}", "--", "{recording}"), (4,), 1),
    "six-pose --unchecked": (("-d", "{out}", "--roll", "z,{body}", "--", "{recording}"), (2,), 0),
    "six-pose --poses": (("{recording}", "-d", "{out}", "--", "{recording}"), (2,), 0),
    "evaluate methods": (("--only", "fixed32", "--", "{recording}"), (0,), None),
    "evaluate methods --csv": (("--only", "fixed32", "--", "{recording}"), (0,), 2),
    "evaluate methods --json": (("--only", "fixed32", "--", "{recording}"), (0,), 1),
    "evaluate stillness": (("--", "{recording}"), (0,), None),
    "evaluate stillness --csv": (("--", "{recording}"), (0,), 6),
    "evaluate segments": (("--hours", "0.2", "--", "{recording}"), (0, 4), None),
    "evaluate segments --json": (("--hours", "0.2", "--", "{recording}"), (0, 4), None),
    "evaluate duration": (("--hours", "0.2", "--", "{recording}"), (0, 4), None),
    "evaluate duration --json": (("--hours", "0.2", "--", "{recording}"), (0, 4), 1),
    "export --to ggir": (("{report}",), (0,), 2),
    "export --to biobank": (("{report}",), (0,), 1),
    "export --to omconvert": (("{report}",), (0,), 1),
    "export --to json": (("{report}",), (0,), 1),
    "export --to csv": (("{parquet}", "-o", "{out}/={body}.csv"), (0,), 0),
    "export --to npz": (("{parquet}", "-o", "{out}/={body}.npz"), (0,), 0),
    "export --to mhealth": (("{parquet}", "-o", "{out}/={body}.csv"), (0, 2), 0),
    "export --to bids": (("{parquet}", "-o", "{out}/sub-01_task-rest_tracksys-wrist_motion.tsv"), (0, 2), 0),
    "watch": (("--", "{recording}"), (0, 4), None),
    "calibrate --effect": (("-d", "{out}", "--", "{recording}"), (0,), 1),
    "evaluate smoothing": (("--", "{recording}"), (0, 4), None),
    "evaluate homogeneity": (("--", "{recording}", "{recording}"), (0, 1, 2, 3, 4), None),
    "simulate": (("{out}/={body}", "--days", "0.01", "--rate", "25"), (0,), 1),
}
"""Words, exit codes and lines on stdout of commands; what goes over a study comes below."""

NIGHTLY = {
    "evaluate methods",
    "evaluate methods --csv",
    "evaluate stillness",
    "evaluate segments",
    "evaluate duration",
    "calibrate --effect",
}
"""Others of the same command are in `make test`."""

OF_STUDIES = {"study", "devices"}
NAMELESS = {"gravity", "evaluate gravity", "evaluate simulation"}
"""They are told no names."""


def all_commands() -> Iterator[str]:
    context = click.Context(cli)
    for name in cli.list_commands(context):
        found = cli.get_command(context, name)
        below = found.list_commands(context) if isinstance(found, click.Group) else ()
        yield from (f"{name} {inner}" for inner in below) if below else (name,)


def test_no_command_is_left_out() -> None:
    tried = {" ".join(word for word in one.split() if not word.startswith("--")) for one in COMMANDS}
    tried = {one.removesuffix(f" {one.split()[-1]}") if one.startswith("export") else one for one in tried}
    assert tried | OF_STUDIES | NAMELESS == set(all_commands())


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.nightly] * (name in NIGHTLY)) for name in COMMANDS]
)
def test_every_command(tmp_path: Path, calibrated: dict[str, Path], name: str) -> None:
    words, codes, lines = COMMANDS[name]
    out = tmp_path / f"@{BODY}"
    out.mkdir()
    places = {key: str(path) for key, path in calibrated.items()}
    places |= {"layout": str(layout_of(calibrated["recording"])), "out": str(out), "body": BODY}
    ran = run(*name.split(), *(word.format(**places) for word in words))
    assert_harmless(ran, *codes, lines=lines)
    if name.endswith("--json") or name == "export --to json":
        for line in ran.lines:
            json.loads(line)
    if name.endswith(("--csv", "--to ggir")):
        assert_cells(ran.out)
    for made in out.glob("*.csv"):
        assert_cells(made.read_text("utf-8"))
    for made in out.glob("*.html"):
        assert_page(made, 0)


def test_a_session_of_files(tmp_path: Path) -> None:
    folder = tmp_path / f"={BODY}"
    folder.mkdir()
    for number, lead in enumerate("=+-@\tx"):
        face = ("+x", "-x", "+y", "-y", "+z", "-z")[number]
        write_csv(folder / f"{lead}{BODY}.csv", session([face], seed=number + 1))
    first = write_csv(folder / f"#{BODY}.csv", session(["+x"]))
    assert_harmless(run("six-pose", "-d", tmp_path, "--", folder), 0, lines=1)
    (made,) = tmp_path.glob("*.calibration.json")
    for one in json.loads(made.read_text("utf-8"))["known_orientations"]["files"]:
        assert_text(one["name"], "")
    assert_harmless(run("report", "-d", tmp_path / "page", "--", made), 0, lines=1)
    (page,) = (tmp_path / "page").glob("*.html")
    assert_page(page, 0)
    first.write_bytes(b"hello")
    assert_harmless(run("six-pose", "-d", tmp_path, "--", folder), 3, lines=0)
    listed = tmp_path / f"@{BODY}.poses.csv"
    listed.write_text(f"file;ax;ay;az\n{SERIAL.replace(chr(10), ' ')};1;0;0\n")
    write_csv(first, session(["+x"]))
    words = ("--roll", f"z,{BODY}", "--poses", listed, "-d", tmp_path, "--", folder)
    assert_harmless(run("six-pose", *words), 2, lines=0)


@pytest.mark.parametrize("tool", ["biobank", "omconvert"])
def test_a_line_for_a_shell_is_one_command_with_one_file(calibrated: dict[str, Path], tool: str) -> None:
    ran = run("export", calibrated["report"], "--to", tool)
    words = shlex.split(ran.out)
    assert words[1].endswith(".raw") and "$(id)`id`;" in words[1] and words[2].startswith("-")
    assert sum(".raw" in word for word in words) == 1


@pytest.mark.parametrize("tool", ["biobank", "omconvert"])
def test_a_name_like_an_option_is_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tool: str) -> None:
    recording(tmp_path, "-")
    monkeypatch.chdir(tmp_path)
    assert run("calibrate", "--model", 6, "--report-only", "--", f"-{BODY}.raw").code == 0
    ran = run("export", "--to", tool, "--", f"-{BODY}.calibration.json")
    word = shlex.split(ran.out)[1]
    assert word.startswith(f"{tmp_path}/-<img")
    told = json.loads(Path(f"-{BODY}.calibration.json").read_text())
    del told["provenance"]  # without which nobody knows where it was
    Path("bare.calibration.json").write_text(json.dumps(told))
    ran = run("export", "--to", tool, "bare.calibration.json")
    assert shlex.split(ran.out)[1].startswith("./-<img")


def test_a_study(tmp_path: Path) -> None:
    for number, lead in enumerate("=+-@\t"):
        recording(tmp_path / "in" / f"{lead}{BODY}", lead, number + 1)
    out = tmp_path / f"out{BODY}"
    words = ("study", tmp_path / "in", "-d", out, "-j", 2)
    assert_harmless(run(*words, "--dry-run"), 0, lines=5)
    assert_harmless(run(*words, "--report-only", "--html"), 0, lines=5)
    table = assert_cells((out / "study.csv").read_text("utf-8"))
    assert len(table) == 5 and {row["outcome"] for row in table} == {"calibrated"}
    assert json.loads((out / "study.json").read_text("utf-8"))
    assert_page_of_study(out)
    pages = [page for page in out.rglob("*.html") if page.name != "study.html"]
    assert len(pages) == 5
    for page in pages:
        assert_page(page, 0)
    for more in ((), ("--json",), ("--csv",), ("--device", SERIAL), ("--device", f"x{SERIAL}")):
        shown = assert_harmless(run("devices", out, *more), 0, 2)
        if more == ("--csv",):
            assert len(assert_cells(shown.out)) == 5
    assert_harmless(run("report", out), 0, lines=0)


def assert_page_of_study(out: Path) -> None:
    page = out / "study.html"
    elements = Elements()
    text = page.read_text("utf-8")
    assert_text(text, "\n")
    elements.feed(text)
    tags = [tag for tag, _ in elements.found]
    assert "img" not in tags and tags.count("script") == 2
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert data is not None and "<" not in data[1]
    json.loads(data[1])


@pytest.mark.parametrize(
    "words",
    [
        ("calibrate", "{x}"),
        ("calibrate", "a.csv", "--format", "{x}"),
        ("calibrate", "a.csv", "--timezone", "{x}"),
        ("calibrate", "a.csv", "--optimizer", "{x}"),
        ("calibrate", "a.csv", "--stillness", "{x}"),
        ("calibrate", "a.csv", "--rate", "{x}"),
        ("calibrate", "a.csv", "--columns", "{x}"),
        ("calibrate", "a.csv", "--layout", "{x}"),
        ("calibrate", "a.csv", "-d", "a.csv/{x}"),
        ("evaluate", "methods", "a.csv", "--only", "{x}"),
        ("evaluate", "simulation", "--optimizer", "{x}"),
        ("simulate", "a", "--format", "{x}"),
        ("study", "{x}", "-d", "out"),
        ("study", ".", "-d", "out", "--shard", "{x}"),
        ("report", "{x}"),
        ("devices", "{x}"),
        ("export", "{x}", "--to", "ggir"),
        ("export", "a", "--to", "{x}"),
        ("fit", "{x}"),
        ("verify", "{x}", "{x}"),
        ("{x}",),
    ],
    ids=" ".join,
)
def test_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.csv").write_text("x,y,z\n" + "0,0,1\n" * 100)
    ran = run(*(word.format(x=BODY) for word in words))
    assert_harmless(ran, 2, 3, 5, lines=0)


@pytest.mark.parametrize(
    ("encoding", "name"), [("iso8859-7", b"\xd9\\xe9.raw"), nightly("latin-1", b"\\u03a9\xe9.raw")]
)
def test_a_terminal_that_has_not_all_characters(tmp_path: Path, encoding: str, name: bytes) -> None:
    path = write_raw(tmp_path / "Ωé.raw", still_counts(directions(4)))
    done = subprocess.run(
        command("inspect", path),
        capture_output=True,
        env={**os.environ, "PYTHONIOENCODING": encoding},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert name in done.stdout


@pytest.mark.parametrize("number", [231, 236, 255])
def test_a_name_as_long_as_names_can_be(tmp_path: Path, number: int) -> None:
    """The names of the outputs are longer: they are written, or it is said."""
    path = tmp_path / f"{'n' * (number - 4)}.raw"
    first = write_raw(tmp_path / "n.raw", still_counts(directions(60)))
    path.write_bytes(first.read_bytes())
    ran = run("calibrate", "--model", 6, path, "--html", "--layout", layout_of(first))
    assert ran.code in (0, 5) and "a bug" not in ran.err, ran.err
    assert ran.err.count("\n") == (ran.code != 0)
    assert [one for one in tmp_path.iterdir() if "parquet" in one.name] == [] or ran.code == 0
