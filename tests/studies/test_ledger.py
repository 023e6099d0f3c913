"""A ledger that is damaged costs what it saved, no more; and what it says is to be tried again."""

from __future__ import annotations

import errno
import json
import os
import shutil
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.studies.records import Ledger
from accelcal_cli.studies.summary import fits
from accelcal_cli.studies.task import guarded
from tests.cli.run import run
from tests.cli.studies import results, run_in, study_folder

NAMES = ("a.raw", "b.raw", "c.raw")


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.mktemp("ledger")
    study_folder(base / "in", NAMES)
    assert run_in(base, "study", base / "in", "-d", base / "out").code == 0
    return base


def changed(line: str, **said: object) -> str:
    """A line whose content was changed by hand."""
    return line[:9] + json.dumps(json.loads(line[9:]) | said)


def forged(line: str, **said: object) -> str:
    """A line with another content and the right checksum."""
    text = changed(line, **said)[9:]
    return f"{zlib.crc32(text.encode()):08x} {text}"


@pytest.mark.parametrize(
    ("damage", "unchanged"),
    [
        (lambda line: changed(line, row={}), 2),
        (lambda line: forged(line, row={}), 2),
        (lambda line: "\0" * 5000, 2),
        (lambda line: changed(line, name=[]), 2),
        (lambda line: changed(line, outputs=[["a\0b", [1, 2]]]), 2),
        (lambda line: line.replace('"calibrated"', '"calibrbted"'), 2),
        (lambda line: line.replace('"samples": 4', '"samples": 5'), 2),
        (lambda line: "[" * 100_000, 2),
        (lambda line: "\udcff\0\n" + line, 3),
        (lambda line: line[:200] + "\n" + line, 3),
        (lambda line: "", 2),
    ],
)
def test_a_damaged_line_is_not_read_and_the_others_are(
    base: Path, tmp_path: Path, damage: Callable[[str], str], unchanged: int
) -> None:
    out = shutil.copytree(base / "out", tmp_path / "out")
    lines = (out / "study.ledger").read_text().splitlines()
    spoilt = [damage(line) if '"a.raw"' in line else line for line in lines]
    assert spoilt != lines
    (out / "study.ledger").write_bytes("\n".join(spoilt).encode("utf-8", "surrogateescape"))
    ran = run("study", base / "in", "-d", out)
    assert (ran.code, f"{unchanged} unchanged" in ran.err) == (0, True), ran.err
    assert results(out) == results(base / "out")
    assert (out / "study.ledger").read_text().splitlines() == lines


@pytest.mark.parametrize(
    "wrong",
    [
        {"row": ["calibrated"]}, {"row": "x"}, {"outputs": [[5, [1, 2]]]}, {"stamps": 7}, {"again": "no"},
        {"row": None, "why": {"code": 1}}, {"outcome": "splendid"}, {"samples": "many"}, {"after_mg": [1]},
        {"exit_code": True},
    ],
)  # fmt: skip
def test_a_forged_line_is_not_believed(base: Path, tmp_path: Path, wrong: dict[str, Any]) -> None:
    lines = (base / "out/study.ledger").read_text().splitlines()
    (line,) = (line for line in lines if '"a.raw"' in line)
    said = json.loads(line[9:])
    changes = wrong if wrong.keys() <= said.keys() else {"row": said["row"] | wrong}
    for more, number in (({}, 1), (changes, 0)):
        (tmp_path / "study.ledger").write_text(forged(line, **more) + "\n")
        assert len(Ledger(tmp_path / "study.ledger", fits=fits).entries("a.raw")) == number


@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_a_ledger_that_is_no_plain_file_is_let_alone(base: Path, tmp_path: Path, kind: str) -> None:
    out, target = shutil.copytree(base / "out", tmp_path / "out"), tmp_path / "mine"
    target.write_bytes((out / "study.ledger").read_bytes())
    (out / "study.ledger").unlink()
    if kind == "link":
        (out / "study.ledger").symlink_to(target)
    else:
        os.mkfifo(out / "study.ledger")
    ran = run("study", base / "in", "-d", out)
    assert target.read_bytes() == (base / "out" / "study.ledger").read_bytes()
    assert (ran.code, "study.ledger" in ran.err) == (5, True), ran.err


def test_a_line_is_its_checksum_and_its_json(base: Path) -> None:
    lines = (base / "out/study.ledger").read_bytes().splitlines()
    assert len(lines) == len(NAMES) + 1
    ledger = Ledger(base / "out/study.ledger")
    for line in lines:
        assert int(line[:8], 16) == zlib.crc32(line[9:])
        said = json.loads(line[9:])
        assert said["round"] == "own"
        assert [entry.asked for entry in ledger.entries(said["name"])] == [said["asked"]]


@pytest.mark.parametrize(
    ("cause", "again"), [(OSError(errno.EIO, "the disk"), True), (OSError("damaged"), False)]
)
def test_a_recording_that_the_disk_did_not_give_is_tried_again(cause: OSError, again: bool) -> None:
    class Told:
        sources = ()

        def failure(self, code: int, _message: str, *, again: bool) -> tuple[int, bool]:
            return code, again

    @guarded
    def work(_task: Any, _report: Any) -> Any:
        try:
            raise cause
        except OSError as error:
            raise UnreadableError("cannot be read") from error

    assert work(Told(), None).entry == (3, again)
