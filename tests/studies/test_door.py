"""One bad path costs itself (`core/paths.py`): faults of the disk, and files that are not plain."""

from __future__ import annotations

import ast
import errno
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import accelcal_cli
from accelcal_cli.core import paths
from accelcal_cli.core.errors import UnreadableError
from tests.cli.run import Ran, run
from tests.recordings import directions, still_counts, write_raw

PACKAGE = Path(accelcal_cli.__file__).parent
ERRNOS = (errno.EACCES, errno.ENAMETOOLONG, errno.ELOOP, errno.EIO, errno.ESTALE)
NOBODY = 65534
ASKING = {
    "is_file", "exists", "is_dir", "is_symlink", "is_fifo", "lstat", "samefile", "resolve", "rglob", "glob"
}  # fmt: skip
ELSEWHERE = {
    "core/paths.py": "the door itself",
    "core/system.py": "/proc",
    "core/input_files.py": "parts by a pattern, whose caller turns the error into one of ours",
    "studies/executors.py": "the package's own code",
    "pages/write.py": "the package's own templates",
    "formats/_parts/archive.py": "members of archives",
    "formats/tables/hdf5.py": "attributes of datasets",
}


def test_h1_questions_to_the_file_system_go_through_the_door() -> None:
    asking = set()
    for path in PACKAGE.rglob("*.py"):
        name = path.relative_to(PACKAGE).as_posix()
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            called = node.func if isinstance(node, ast.Call) else None
            if isinstance(called, ast.Attribute) and called.attr in ASKING:
                asking.add(name)
    asking = {name for name in asking if not name.startswith("laboratory")}
    assert asking - set(ELSEWHERE) <= {"cli/evaluate.py"}


def small_study(top: Path) -> Path:
    """Files of the kinds that discovery asks about: layouts, options, parts, links, a folder of Unisens."""
    folder = top / "in"
    for name in ("north/a.raw", "south/b.raw"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_raw(folder / name, still_counts(directions(12)))
    (folder / "north" / "a.toml").write_text('timezone = "UTC"\n')
    (folder / "south" / "notes.txt").write_text("recorded in spring\n")
    (folder / "study.toml").write_text('["*.raw"]\nshift = 1.0\n')
    (folder / "west").mkdir()
    (folder / "west" / "unisens.xml").write_text("<unisens/>")
    for part in "12":
        (folder / "west" / f"P_160000000{part}.avro").write_bytes(b"Obj\x01")
    (folder / "link").symlink_to(folder / "north", target_is_directory=True)
    return folder


class Faults:
    """Lets the n-th question about a path below a folder fail."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch) -> None:
        self.asked: list[tuple[str, str]] = []
        self.at, self.number = -1, 0
        self._folder = str(folder)
        for module, name in ((os, "stat"), (os, "lstat"), (os, "scandir"), (os, "open")):
            patch.setattr(module, name, self._failing(name, getattr(module, name)))
        patch.setattr(Path, "open", self._failing("open", Path.open))

    def _failing(self, kind: str, plain: Callable[..., Any]) -> Callable[..., Any]:
        def asked(path: Any, *words: Any, **more: Any) -> Any:
            name = os.fspath(path) if isinstance(path, str | os.PathLike) else ""
            if name.startswith(self._folder):
                self.asked.append((kind, name))
                if len(self.asked) - 1 == self.at:
                    raise OSError(self.number, os.strerror(self.number), name)
            return plain(path, *words, **more)

        return asked

    def strike(self, at: int, number: int) -> None:
        """Fail the question of this place with this error."""
        self.asked, self.at, self.number = [], at, number


@pytest.fixture
def faults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Faults]:
    folder = small_study(tmp_path)
    yield Faults(folder, monkeypatch)
    monkeypatch.undo()


def preview(folder: Path, *words: object) -> Ran:
    return run("study", folder, "-d", folder.parent / "out", "--dry-run", "-j", 1, *words)


@pytest.mark.skipif(sys.platform == "win32", reason="links")
@pytest.mark.parametrize("number", ERRNOS, ids=errno.errorcode.get)
def test_h1_a_fault_anywhere_costs_a_row_or_a_note(number: int, tmp_path: Path, faults: Faults) -> None:
    folder = tmp_path / "in"
    assert preview(folder).code == 0
    whole, questions = preview(folder).out.splitlines(), len(faults.asked) // 2
    assert questions > 40, whole
    for at in range(questions):
        faults.strike(at, number)
        ran = preview(folder)
        assert len(faults.asked) > at
        kind, name = faults.asked[at]
        struck = Path(name)
        assert ran.code in (0, 2) and "bug" not in ran.err, (kind, name, ran.err)
        if ran.code == 2:
            assert struck in (folder, folder / "study.toml"), (kind, name, ran.err)
            continue
        for line in whole:
            source = folder / line.split("\t")[0]
            near = source == struck or struck in source.parents or source.stem == struck.stem
            said = any(line.split("\t")[0] in one for one in ran.out.splitlines())
            assert said or near or struck.parent == source.parent, (kind, name, line, ran.out, ran.err)


@pytest.mark.skipif(not hasattr(os, "setuid") or os.getuid() != 0, reason="only root can become another user")
def test_h1_a_folder_without_search_permission_costs_itself(open_folder: Path) -> None:
    """Mode 744 lists names and answers nothing more; root may do anything, so another user tries."""
    folder = small_study(open_folder)
    locked = folder / "locked"
    (locked / "deeper").mkdir(parents=True)
    write_raw(locked / "c.raw", still_counts(directions(12)))
    for path in (open_folder, *open_folder.rglob("*")):
        os.chown(path, NOBODY, NOBODY, follow_symlinks=False)
    locked.chmod(0o744)
    os.chown(locked, 0, 0)
    assert preview(folder).code == 0  # which loads all modules: another user may not read them
    with (open_folder / "seen").open("w") as seen:
        if (child := os.fork()) == 0:  # nothing below returns
            os.setgroups([])
            os.setgid(NOBODY)
            os.setuid(NOBODY)
            ran = preview(folder)
            seen.write(f"{ran.code}\n{ran.out}\n{ran.err}")
            seen.flush()
            os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    code, *lines = (open_folder / "seen").read_text().splitlines()
    assert code == "0" and "bug" not in "".join(lines), lines
    for name in ("north/a.raw\ttodo", "south/b.raw\ttodo", "locked/c.raw", "locked/deeper\tfailed"):
        assert sum(name in one for one in lines) == 1, (name, lines)


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that every user can enter, unlike pytest's."""
    with tempfile.TemporaryDirectory(dir="/var/tmp") as name:
        Path(name).chmod(0o755)
        yield Path(name)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes")
@pytest.mark.parametrize("name", ["unisens.xml", "a.toml", "layout.toml", "a.layout.toml", "b.csv", "x.h5"])
def test_h4_a_pipe_that_is_found_is_not_waited_for(name: str, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    write_raw(tmp_path / "in" / "a.raw", still_counts(directions(12)))
    (tmp_path / "in" / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / "in" / name)
    ran = preview(tmp_path / "in", "--rate", 25, "--lsb-per-g", 256, "--include", "*.raw")
    assert "a.raw" in ran.out and "bug" not in ran.err


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes")
@pytest.mark.parametrize("name", ["in/study.toml", "out/study.ledger", "out/study.lock", "out/study.csv"])
def test_h4_a_pipe_in_place_of_a_file_of_the_study_is_said(name: str, tmp_path: Path) -> None:
    small_study(tmp_path)
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / name)
    ran = run("study", tmp_path / "in", "-d", tmp_path / "out", "-j", 1)
    assert ran.code in (2, 5) and Path(name).name in ran.err and ran.err.count("\n") == 1, ran.err


def test_the_door_tells_what_is_there(tmp_path: Path) -> None:
    file = tmp_path / "a"
    file.write_text("x")
    assert paths.is_file(file) and not paths.is_folder(file) and not paths.is_link(file)
    assert paths.is_folder(tmp_path) and not paths.is_file(tmp_path)
    long = tmp_path / ("n" * 300)
    assert not paths.is_file(long) and paths.stat_or_none(long) is None and not paths.is_there(long)
    assert not paths.is_file(Path("a\0b"))
    assert paths.is_same(file, tmp_path / "." / "a") and not paths.is_same(file, tmp_path)
    with pytest.raises(UnreadableError, match="not a plain file"):
        paths.open_found(tmp_path)
