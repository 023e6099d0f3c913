"""A study whose outputs lie among its recordings, and files there that have the names of its summary."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.run import nightly, run
from tests.cli.studies import NAMES, results, rows, study, study_folder
from tests.recordings import directions, still_counts


def test_the_first_run_and_later_ones_find_the_same(tmp_path: Path) -> None:
    """The lock and, without a ledger, the summary are no files of the study either."""
    folder = study_folder(tmp_path / "in", NAMES[:1])
    assert run("study", folder, "-d", folder).code == 0
    first = results(folder)
    assert json.loads((folder / "study.json").read_text())["left_out"] == 1
    (folder / "study.ledger").unlink()
    for _ in range(2):
        assert run("study", folder, "-d", folder).code == 0
        assert results(folder) == first
    (folder / "study.ledger").unlink()
    above = run("study", tmp_path, "-d", tmp_path / "out", "--dry-run")
    assert above.lines == [f"{folder / NAMES[0]}\ttodo"]


def test_recordings_below_the_outputs_are_left_out_and_that_is_said(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in")
    (folder / "south/notes.txt").write_text("none of them\n")
    said = f"accelcal: ignored, because they are below {folder / 'south'}: 1 recording"
    for words in (["--dry-run"], [], []):
        ran = run("study", folder, "-d", folder / "south", *words)
        assert (ran.code, ran.err.splitlines()[0]) == (0, said)
        assert sorted(line.split("\t")[0] for line in ran.lines) == [str(folder / name) for name in NAMES[:2]]
    for words in (["-q"], ["--exclude", "south/*"], ["--include", "a.raw"]):
        assert "ignored" not in run("study", folder, "-d", folder / "south", *words).err
    assert "ignored" not in run("study", folder, "-d", folder).err


@pytest.mark.parametrize("force", [("--force",), nightly(())])
def test_a_recording_of_the_summarys_name_is_not_overwritten(tmp_path: Path, force: tuple[str, ...]) -> None:
    folder = study_folder(tmp_path / "in", NAMES[:1])
    counts = still_counts(directions(60))
    text = "x,y,z\n" + "".join(f"{x},{y},{z}\n" for x, y, z in counts / 256)
    (folder / "study.csv").write_text(text)
    ran = run("study", folder, "-d", folder, "--rate", 25, "--unit", "g", *force)
    assert (ran.code, ran.out) == (5, "")
    assert f"{folder / 'study.csv'}: would be overwritten by the study's summary" in ran.err
    assert (folder / "study.csv").read_text() == text
    assert not list(folder.rglob("*.calibrated.parquet"))
    assert study(folder, "--rate", 25, "--unit", "g").code == 0
    assert [row["path"] for row in rows(tmp_path / "out")] == [NAMES[0], "study.csv"]


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("study.csv", "path,age\n1,2\n"),
        ("study.json", '{"mine": 1}'),
        nightly("study.json", "["),
        ("study.json", "[" * 100_000),
        nightly("study.ledger", "what I did: 17 recordings\n"),
        nightly("study.parquet", ""),
    ],
)
def test_anothers_file_is_replaced_with_force_only(tmp_path: Path, name: str, content: str) -> None:
    folder, out = study_folder(tmp_path / "in", NAMES[:1]), tmp_path / "out"
    out.mkdir()
    (out / name).write_text(content)
    ran = study(folder)
    assert (ran.code, "was not written by accelcal" in ran.err) == (5, True)
    assert [path.name for path in out.iterdir()] == [name]
    assert (out / name).read_text() == content
    assert study(folder, "--force").code == 0
    assert len(rows(out)) == 1
