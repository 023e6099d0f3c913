"""OUT knows whose results it holds: other folders are refused, the same ones known wherever they are."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.studies import orphans
from tests.cli.run import Ran, run
from tests.cli.studies import rows, study_folder
from tests.recordings import directions, still_counts, write_raw

NAMES = ("p1/a.raw", "p1/b.raw", "p2/c.raw")


def study(*folders: Path, out: Path, words: tuple[str, ...] = (), code: int | None = None) -> Ran:
    return run("study", *folders, "-d", out, "-j", 1, "--report-only", *words, code=code)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Recordings of which a study is made, in `out` beside them."""
    folder = study_folder(tmp_path / "in", NAMES)
    study(folder, out=tmp_path / "out", code=0)
    return folder


def codes(out: Path) -> dict[str, str]:
    told = json.loads((out / "study.json").read_text())["orphans"]
    return {one["report"]: one["code"] for one in told}


def other_disk(monkeypatch: pytest.MonkeyPatch, *places: Path) -> None:
    """Let folders be on another disk than they are, as after something was mounted or unmounted there."""
    true = orphans.numbers_of

    def numbers(folder: Path) -> tuple[int, int]:
        disk, number = true(folder)
        return disk + 1000 * (folder in places), number

    monkeypatch.setattr(orphans, "numbers_of", numbers)


@pytest.mark.parametrize("words", [(), ("--dry-run",), ("--shard", "1/2"), ("-q",)])
@pytest.mark.parametrize("given", [["other"], ["in/p1"], ["other", "in"], ["."]])
def test_other_folders_and_parts_are_refused(given: list[str], words: tuple[str, ...], folder: Path) -> None:
    here, out = folder.parent, folder.parent / "out"
    study_folder(here / "other", ("x.raw",))
    table = (out / "study.csv").read_bytes()
    paths = [here / one for one in given]
    ran = study(*paths, out=out, words=words)
    named = " and ".join(str(one.resolve()) for one in paths)
    assert (ran.code, ran.out) == (2, "")
    assert ran.err.splitlines()[-1] == (
        f"accelcal: {out}: holds the results of {folder}, not of {named}; choose another folder with -d, or "
        "replace them with --force"
    )
    assert (out / "study.csv").read_bytes() == table


def test_one_of_several_folders_is_a_part_and_a_further_one_is_not(tmp_path: Path) -> None:
    one, two, three = (study_folder(tmp_path / name, (f"{name}.raw",)) for name in ("A", "B", "C"))
    out = tmp_path / "out"
    study(one, two, out=out, code=0)
    assert f"{out}: holds the results of {one} and {two}, not of {one};" in study(one, out=out, code=2).err
    study(one, three, out=out, code=2)
    study(one, two, three, out=out, code=0)
    assert [row["path"] for row in rows(out)] == ["A/A.raw", "B/B.raw", "C/C.raw"]


def moved(folder: Path) -> Path:
    return folder.rename(folder.parent / "moved")


def linked(folder: Path) -> Path:
    link = folder.parent / "link"
    link.symlink_to(folder, target_is_directory=True)
    return link


def copied(folder: Path) -> Path:
    """Copied to another disk with new times; the first folder is gone."""
    copy = Path(shutil.copytree(folder, folder.parent / "copy", copy_function=shutil.copyfile))
    shutil.rmtree(folder)
    return copy


@pytest.mark.parametrize("way", [moved, linked, copied])
def test_the_same_folder_is_known_again(way: Any, folder: Path) -> None:
    out, there = folder.parent / "out", way(folder)
    ran = study(there, out=out, code=0)
    assert "3 recordings" in ran.err and codes(out) == {}
    assert ("3 unchanged" in ran.err) == (way is not copied)  # its content decides
    (there / "p1/a.raw").unlink()
    study(there, out=out, code=0)
    assert list(codes(out)) == ["p1/a.calibration.json"]
    study(there, out=out, words=("--prune",), code=0)
    assert not (out / "p1/a.calibration.json").exists() and (out / "p1/b.calibration.json").exists()


def test_t_what_a_copy_lacks_is_said_at_once(folder: Path) -> None:
    """Also while the first folder is there; the second run says the same."""
    out, copy = folder.parent / "out", Path(shutil.copytree(folder, folder.parent / "copy"))
    (copy / "p1/a.raw").unlink()
    for _ in range(2):
        study(copy, out=out, code=0)
        assert codes(out) == {"p1/a.calibration.json": "recording_elsewhere"}


@pytest.mark.parametrize("change", ["content", "size", "few"])
def test_a_copy_of_something_else_is_another_folder(change: str, folder: Path) -> None:
    """With the same names: of another visit, of changed recordings, or one that is a part of the first."""
    other = Path(shutil.copytree(folder, folder.parent / "other"))
    for number, name in enumerate(NAMES):
        data = bytearray((other / name).read_bytes())
        data[-1] ^= 1
        if change == "content":
            (other / name).write_bytes(data)
        elif change == "size":
            (other / name).write_bytes(data * 2)
        elif number:
            (other / name).unlink()
    study(other, out=folder.parent / "out", code=2)


@pytest.mark.parametrize(("kept", "code"), [(0, 2), (1, 0), (3, 0)])
@pytest.mark.parametrize("sign", ["path", "number"])
def test_what_is_elsewhere_or_in_its_place_is_known_by_a_recording(
    sign: str, kept: int, code: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another disk may be at the same path, and a new folder may get the number of one that is gone."""
    for name in NAMES[kept:]:
        (folder / name).unlink()
    write_raw(folder / "new.raw", still_counts(directions(70)))
    if sign == "path":
        other_disk(monkeypatch, folder)
        study(folder, out=folder.parent / "out", code=code)
    else:
        study(moved(folder), out=folder.parent / "out", code=code)


def test_force_replaces_and_strays_are_listed_and_pruned(folder: Path) -> None:
    out, other = folder.parent / "out", study_folder(folder.parent / "other", ("x.raw", "y.raw", "z.raw"))
    for number, name in enumerate("xyz"):
        write_raw(other / f"{name}.raw", still_counts(directions(70 + number)))
    assert run("calibrate", folder / "p1/a.raw", "-o", out / "hand.calibrated.parquet").code == 0
    ran = study(other, out=out, words=("--force",), code=0)
    assert codes(out) == {f"{name[:-4]}.calibration.json": "recording_elsewhere" for name in NAMES}
    text = f"p1/a.calibration.json stays, and --prune removes it: its recording a.raw was in {folder}/p1, "
    assert text in ran.err
    ran = study(other, out=out, words=("--prune", "--dry-run"), code=0)
    assert "p1/a.calibration.json would be removed: its" in ran.err
    study(other, out=out, words=("--prune",), code=0)
    left = sorted(one.relative_to(out).as_posix() for one in out.rglob("*.calibration.json"))
    assert left == [f"{name}.calibration.json" for name in ("hand", "x", "y", "z")]
    study(other, out=out, code=0)
    assert codes(out) == {}


@pytest.mark.parametrize("left", [".DS_Store", "NOT_MOUNTED", "elsewhere/new.raw"])
def test_h4_results_stay_where_a_disk_may_be_away(left: str, folder: Path) -> None:
    """Its folder is there, but no recording of an earlier run is in it."""
    out = folder.parent / "out"
    shutil.rmtree(folder / "p2")
    (folder / "p2").mkdir()
    study_folder(folder / "p2", (left,)) if left.endswith(".raw") else (folder / "p2" / left).write_text("x")
    for _ in range(1 if left.endswith(".raw") else 2):
        study(folder, out=out, words=("--prune", "--force"), code=0)
        assert (out / "p2/c.calibration.json").exists() and codes(out) == {}
    shutil.rmtree(folder / "p2")
    study(folder, out=out, words=("--prune",), code=0)
    assert not (out / "p2/c.calibration.json").exists()


def test_h4_results_stay_once_on_another_disk(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a recording beside others, too: these may be a copy on the disk below."""
    out = folder.parent / "out"
    (folder / "p1/a.raw").unlink()
    with monkeypatch.context() as patched:
        other_disk(patched, folder / "p1")
        study(folder, out=out, words=("--prune",), code=0)
        assert (out / "p1/a.calibration.json").exists() and codes(out) == {}
        held = json.loads((out / "study.json").read_text())["provenance"]["folders"]
        assert held[0]["disks"] == {"p1": folder.stat().st_dev + 1000}
        study(folder, out=out, words=("--prune",), code=0)
        assert not (out / "p1/a.calibration.json").exists()
    (folder / "p1/b.raw").unlink()
    (folder / "p1/NOT_MOUNTED").write_text("")
    for _ in range(2):
        study(folder, out=out, words=("--prune", "--force"), code=0)
        assert (out / "p1/b.calibration.json").exists() and codes(out) == {}


@pytest.mark.parametrize("columns", ["path,use,why", "why,report,new,outcome,path"])
def test_d1_a_table_of_another_version_is_known_by_its_columns(columns: str, folder: Path) -> None:
    out = folder.parent / "out"
    text = (out / "study.csv").read_text()
    rest = text.splitlines()[0].removeprefix("path,use,why")
    (out / "study.csv").write_text(columns + rest + "\n")
    study(folder, out=out, code=0)
    assert (out / "study.csv").read_text() == text


@pytest.mark.parametrize("name", ["study.csv", "study.json", "study.parquet"])
def test_d1_a_dry_run_foresees_that_a_file_is_in_the_way(name: str, tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in", NAMES[:1]), tmp_path / "out"
    out.mkdir()
    (out / name).write_text("path,mine\n")
    lines = [study(folder, out=out, words=words, code=5).err for words in ((), ("--dry-run",))]
    assert lines[0] == lines[1] and "was not written by accelcal" in lines[0]


@pytest.mark.parametrize(
    "odd", [3, [], [3], [{"path": "x"}], [{"path": 3, "place": "", "device": 1, "number": 1}]]
)
def test_folders_that_others_changed_are_not_known(odd: Any, folder: Path) -> None:
    out = folder.parent / "out"
    held = json.loads((out / "study.json").read_text()) | {"provenance": {"folders": odd}}
    (out / "study.json").write_text(json.dumps(held))
    assert study(folder, out=out).code == 0
