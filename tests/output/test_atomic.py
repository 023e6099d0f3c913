"""Files appear complete or not at all."""

from __future__ import annotations

import errno
import json
import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from accelcal_cli.core.errors import OutputError
from accelcal_cli.core.system import host
from accelcal_cli.output.files import json_text, parsed, replacing, write_text


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_file_appears_only_at_the_end(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    with replacing(target) as temporary:
        temporary.write_text("new")
        assert not target.exists()
        assert temporary.parent == tmp_path
    assert target.read_text() == "new"
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_an_error_leaves_the_old_file_and_no_temporary(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(error), replacing(target) as temporary:
        temporary.write_text("half")
        raise error
    assert target.read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("code", [errno.EROFS, errno.EIO, errno.ESTALE])
def test_a_disk_that_fails_at_the_clearing_too_is_said_as_what_it_did_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    def fails(*_arguments: object, **_options: object) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(Path, "replace", fails)
    monkeypatch.setattr(Path, "unlink", fails)
    with pytest.raises(OutputError, match=rf"a\.txt: cannot be written \({os.strerror(code)}\)"):
        write_text(tmp_path / "a.txt", "x")


def test_a_missing_folder_is_an_output_error_with_the_path(tmp_path: Path) -> None:
    target = tmp_path / "absent" / "a.txt"
    with pytest.raises(OutputError, match=r"absent/a\.txt.*cannot be written"):
        write_text(target, "x")


def test_a_full_disk_is_an_output_error_that_says_so() -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    error = None
    try:
        with Path("/dev/full").open("wb", buffering=0) as file:
            file.write(b"x")
    except OSError as caught:
        error = caught
    assert error is not None
    from accelcal_cli.output.files import output_error

    assert "free some space" in str(output_error(error, Path("out.parquet")))


def test_the_file_has_the_usual_permissions(tmp_path: Path) -> None:
    mask = os.umask(0o027)
    try:
        write_text(tmp_path / "a.txt", "x")
    finally:
        os.umask(mask)
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == 0o640


@pytest.mark.parametrize("name", ["x" * 255, "é" * 127])
def test_a_name_of_the_longest_kind_leaves_room_for_the_temporary(tmp_path: Path, name: str) -> None:
    write_text(tmp_path / name, "x")
    assert names(tmp_path) == [name]
    with pytest.raises(OutputError, match="rename the recording"):
        write_text(tmp_path / (name + "xx"), "x")


def test_what_a_killed_process_left_is_removed_with_the_next_writing(tmp_path: Path) -> None:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    dead, living = process.pid, os.getpid()
    kept = [
        f".a.txt.{host()}.{living}.0123456789ab.tmp",
        f".a.txt.elsewhere.{dead}.0123456789ab.tmp",
        f".b.txt.{host()}.{dead}.0123456789ab.tmp",
    ]
    for name in [*kept, f".a.txt.{host()}.{dead}.0123456789ab.tmp"]:
        (tmp_path / name).write_text("half")
    write_text(tmp_path / "a.txt", "x")
    assert names(tmp_path) == sorted([*kept, "a.txt"])


def test_a_large_folder_is_not_listed_for_each_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    listed: list[object] = []
    clock = [0.0]

    def slow(folder: Path) -> Iterator[os.DirEntry[str]]:
        listed.append(folder)
        clock.append(clock[-1] + 0.05)
        return plain(folder)

    plain = os.scandir
    monkeypatch.setattr("accelcal_cli.output.files.os.scandir", slow)
    monkeypatch.setattr("accelcal_cli.output.files.time", SimpleNamespace(monotonic=lambda: clock[-1]))
    for number in range(20):
        write_text(tmp_path / f"{number}.txt", "x")
    assert listed == [tmp_path]


def test_no_character_of_our_json_acts_on_a_terminal_and_all_are_there() -> None:
    said = {"model": "a\x7f\x1b\x85\x9b\u202e\u2066\u200fzé"}
    text = json_text(said, indent=2)
    assert text == '{\n  "model": "a\\u007f\\u001b\\u0085\\u009b\\u202e\\u2066\\u200fzé"\n}'
    assert json.loads(text) == parsed(text) == said


def test_an_error_names_the_output_and_not_its_temporary_file(tmp_path: Path) -> None:
    path = tmp_path / "out.h5"
    with pytest.raises(OutputError) as caught, replacing(path) as temporary:
        raise OutputError("cannot be written", path=temporary)
    assert caught.value.path == path
    assert not list(tmp_path.iterdir())
