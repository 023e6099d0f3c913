"""Numbers that are none, and outputs that are no files: a plain error, and nothing replaced."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from tests.cli.run import run
from tests.recordings import directions

SAMPLE = Path(__file__).resolve().parent.parent.parent / "sample_data" / "recording.bin"


@pytest.mark.parametrize(
    "words",
    [
        ("evaluate", "gravity", "--local-gravity", "nan"),
        ("simulate", "x", "--noise-mg", "nan"),
        ("simulate", "x", "--errors", "nan"),
        ("simulate", "x", "--misalignment", "inf"),
        ("simulate", "x", "--temp-slope", "nan", "0", "0"),
        ("simulate", "x", "--lsb-per-g", "nan"),
        ("evaluate", "methods", SAMPLE, "--json", "--csv"),
    ],
    ids=lambda words: " ".join(str(word) for word in words if word is not SAMPLE),
)
def test_what_is_no_number_is_wrong_usage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[object, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(*words).code == 2
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def points(tmp_path: Path) -> Path:
    path = tmp_path / "points.csv"
    lines = [f"{x:.9f},{y:.9f},{z:.9f}" for x, y, z in directions(60)]
    path.write_text("\n".join(["x,y,z", *lines]) + "\n")
    return path


@pytest.mark.parametrize("force", [(), ("--force",)])
def test_a_pipe_is_not_read_and_not_replaced(tmp_path: Path, points: Path, force: tuple[str, ...]) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    ran = run("fit", points, "-o", pipe, *force)
    assert ran.code == 5 and ran.err.count("\n") == 1
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    ran = run("calibrate", SAMPLE, "-o", pipe, *force, code=5)
    assert stat.S_ISFIFO(pipe.stat().st_mode)


def test_a_folder_is_not_replaced(tmp_path: Path, points: Path) -> None:
    (tmp_path / "folder").mkdir()
    assert run("fit", points, "-o", tmp_path / "folder", "--force").code == 5


def test_a_column_that_stands_twice_is_asked_about(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("x,y,z,x\n1,0,0,0\n")
    ran = run("fit", path)
    assert ran.code == 3 and "line 1: has two columns named x" in ran.err


def test_a_choice_that_is_missing_is_asked_for_on_one_line() -> None:
    ran = run("export", SAMPLE, code=2)
    assert ran.err.startswith("accelcal: missing option '--to'. It is one of ggir, biobank, ")
    assert ran.err.endswith("; see: accelcal export --help\n") and ran.err.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("inspect", "--unit", "furlong", "a.csv"), "invalid value for '--unit': 'furlong' is not one of "),
        (("inspect", "--columns", "a,b", "a.csv"), "invalid value for '--columns': 'a,b' is not three names"),
        (("study", "in"), "missing option '-d' / '--output-dir'; "),
        (("evaluate",), "missing command"),
        (("calibrate", "--nosuch", "a.csv"), "no such option '--nosuch'"),
        (("calibrate", "--sensor\n", "a.csv"), "no such option '--sensor"),
    ],
)
def test_a_wrong_option_is_told_in_one_line_with_the_help(words: tuple[str, ...], what: str) -> None:
    ran = run(*words)
    assert (ran.code, ran.out, ran.err.count("\n")) == (2, "", 1)
    assert ran.err.startswith(f"accelcal: {what}") and ran.err.endswith(f"ee: accelcal {words[0]} --help\n")
