"""Names that are no text, a working folder that is gone, a standard output that is closed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.run import Ran, command, nightly, run
from tests.cli.studies import study
from tests.recordings import directions, good_csv, still_counts, write_raw

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="not so elsewhere")


def test_a_name_that_is_not_utf8(tmp_path: Path) -> None:
    name = os.fsdecode(b"caf\xe9.raw")
    (tmp_path / "in").mkdir()
    path = write_raw(tmp_path / "in" / name, still_counts(directions(60)))
    run("calibrate", path, "-d", tmp_path / "alone", code=0)
    report = tmp_path / "alone" / os.fsdecode(b"caf\xe9.calibration.json")
    assert report.with_name(os.fsdecode(b"caf\xe9.calibrated.parquet")).exists()
    layout = path.with_name(os.fsdecode(b"caf\xe9.layout.toml"))
    assert run("verify", report, path, "--values", "--layout", layout).code == 0
    assert run("apply", "--coefficients", report, path, "-d", tmp_path / "applied").code == 0
    assert study(tmp_path / "in").code == 0
    assert "1 unchanged" in study(tmp_path / "in").err


@pytest.mark.parametrize(
    ("words", "code"),
    [
        nightly(("calibrate", "p.csv"), 3),
        nightly(("calibrate", "{good}", "-d", "out"), 5),
        nightly(("calibrate", "{good}", "-d", "{out}"), 0),
        nightly(("study", ".", "-d", "out"), 5),
        (("study", "{folder}", "-d", "{out}"), 5),
    ],
)
def test_a_working_folder_that_is_gone(tmp_path: Path, words: tuple[str, ...], code: int) -> None:
    good, gone = good_csv(tmp_path), tmp_path / "gone"
    gone.mkdir()
    places = {"good": good, "folder": tmp_path, "out": tmp_path / "out"}
    done = subprocess.run(
        [
            "sh",
            "-c",
            'cd "$0" && rmdir "$0" && exec "$@"',
            gone,
            *command(*(w.format(**places) for w in words)),
        ],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=False,
    )
    assert done.returncode == code, done.stderr
    assert done.stderr.count("\n") == (code != 0)
    assert "bug" not in done.stderr


def closed(*words: object) -> Ran:
    """Run with a standard output that is closed."""
    done = subprocess.run(
        ["sh", "-c", 'exec "$0" "$@" >&-', *command(*words)], stderr=subprocess.PIPE, text=True, check=False
    )
    return Ran(done.returncode, "", done.stderr)


def test_rows_do_not_go_to_a_closed_standard_output(tmp_path: Path) -> None:
    ran = closed("watch", good_csv(tmp_path), "-o", "-")
    assert (ran.code, ran.err.count("\n")) == (2, 1)
    assert ran.err.startswith("accelcal: standard output is closed; ")


def test_a_closed_standard_output_is_told_and_the_outputs_stay(tmp_path: Path) -> None:
    good = good_csv(tmp_path)
    ran = closed("calibrate", good)
    assert (ran.code, ran.err) == (5, "accelcal: standard output is closed: the output was lost\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "good.calibrated.parquet",
        "good.calibration.json",
        "good.csv",
        "good.quality.json",
    ]


@pytest.mark.nightly
def test_a_study_needs_no_standard_output(tmp_path: Path) -> None:
    good_csv(tmp_path)
    ran = closed("study", tmp_path, "-d", tmp_path / "out", "-j", 1, "-q")
    assert (ran.code, ran.err) == (0, "")
    assert (tmp_path / "out/study.json").exists()
