"""Branches for Windows and macOS, on which these tests do not run: by what their documents say."""

from __future__ import annotations

import ast
import ctypes
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from accelcal_cli.cli import exit_codes
from accelcal_cli.core import system
from accelcal_cli.core.system import cpus, keep_freed_memory, lives_on_windows
from accelcal_cli.output import files
from accelcal_cli.studies import executors

Patch = pytest.MonkeyPatch
PACKAGE = Path(exit_codes.__file__).parent.parent
HANDLE = 0x7FFF_FFFF_FFF0
"""Longer than 32 bits, as handles may be."""


class Kernel:
    """kernel32 as its documents have it.

    Attributes:
        codes: exit codes of processes that can be opened, by number.
        error: that of OpenProcess for any other: 87 if there is none, 5 if it is not ours to look at.
    """

    def __init__(self, codes: dict[int, int], error: int = 87) -> None:
        self.codes, self.error, self.open = codes, error, 0
        self.OpenProcess = SimpleFunction(self.open_process)
        self.GetExitCodeProcess = SimpleFunction(self.exit_code)
        self.CloseHandle = SimpleFunction(self.close)

    def open_process(self, access: int, inherit: bool, process: int) -> int | None:
        assert (access, inherit) == (0x1000, False)
        self.open += process in self.codes
        return HANDLE + process if process in self.codes else None

    def exit_code(self, handle: int, code: Any) -> int:
        ctypes.cast(code, ctypes.POINTER(ctypes.c_uint32))[0] = self.codes[handle - HANDLE]
        return 1

    def close(self, _handle: int) -> None:
        self.open -= 1


class SimpleFunction:
    """Called like one of a library; `restype` and `argtypes` can be set."""

    def __init__(self, function: Any) -> None:
        self.function = function

    def __call__(self, *words: Any) -> Any:
        return self.function(*words)


def test_on_windows_a_process_that_ended_is_gone_and_its_handle_closed(monkeypatch: Patch) -> None:
    kernel = Kernel({7: 259, 8: 0, 9: 143})
    monkeypatch.setattr(ctypes, "get_last_error", lambda: kernel.error, raising=False)
    assert [lives_on_windows(process, kernel) for process in (7, 8, 9, 10)] == [True, False, False, False]
    assert kernel.open == 0
    assert kernel.OpenProcess.restype is ctypes.c_void_p
    assert not lives_on_windows(1 << 62, kernel)


def test_on_windows_a_process_that_is_not_ours_to_look_at_lives(monkeypatch: Patch) -> None:
    kernel = Kernel({}, error=5)
    monkeypatch.setattr(ctypes, "get_last_error", lambda: kernel.error, raising=False)
    assert lives_on_windows(7, kernel)


def test_windows_is_asked_where_there_is_windows(monkeypatch: Patch) -> None:
    """A signal 0 would end the process there (os.kill)."""
    kernel = Kernel({7: 259, 8: 1})
    monkeypatch.setattr(system, "sys", SimpleNamespace(platform="win32"))
    monkeypatch.setattr(ctypes, "WinDLL", lambda name, use_last_error: kernel, raising=False)
    monkeypatch.setattr(system.os, "kill", lambda *_words: pytest.fail("a signal"))
    assert system.lives(7)
    assert not system.lives(8)


def test_without_affinity_and_proc_all_cpus_count_and_memory_is_unknown(
    monkeypatch: Patch, tmp_path: Path
) -> None:
    """macOS and Windows have neither sched_getaffinity nor /proc."""
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.delenv("SLURM_CPUS_PER_TASK", raising=False)
    for name in ("PROCESS", "MEMORY"):
        monkeypatch.setattr(system, name, tmp_path / "none")
    assert cpus() == os.cpu_count()
    assert system.available_bytes() is None
    assert system.workers(1000) == os.cpu_count()


def test_only_glibc_is_told_what_to_keep(monkeypatch: Patch) -> None:
    monkeypatch.setattr(system, "sys", SimpleNamespace(platform="darwin"))
    assert not keep_freed_memory()


def test_a_folder_that_cannot_be_opened_need_not_be_flushed(tmp_path: Path, monkeypatch: Patch) -> None:
    """Windows opens no folders (PermissionError); the rename is done."""
    real = os.open

    def opened(path: Any, *more: Any, **named: Any) -> int:
        if Path(path).is_dir():
            raise PermissionError(13, "Permission denied")
        return real(path, *more, **named)

    monkeypatch.setattr(files.os, "open", opened)
    files.write_text(tmp_path / "a.json", "{}")
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_a_table_that_a_spreadsheet_holds_open_is_told_and_stays(tmp_path: Path, monkeypatch: Patch) -> None:
    """Windows replaces no file that another program has open."""
    (tmp_path / "study.csv").write_text("old")

    def refuse(*_paths: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(files.OutputError, match=r"study\.csv: cannot be written \(Permission denied\)"):
        files.write_text(tmp_path / "study.csv", "new")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]


def test_memory_stays_as_it_is_where_it_cannot_be_bounded(monkeypatch: Patch) -> None:
    monkeypatch.setattr(system, "sys", SimpleNamespace(platform="win32"))
    with system.bounded_memory(0):
        assert bytes(1 << 20)


def test_signals_that_a_system_lacks_are_not_asked_for(monkeypatch: Patch) -> None:
    """Windows has neither SIGHUP nor SIGALRM."""
    for name in ("SIGHUP", "SIGALRM", "setitimer", "pthread_sigmask"):
        monkeypatch.delattr(signal, name)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    hook = exit_codes.sys.unraisablehook
    try:
        assert exit_codes.run_safely(lambda: 0) == 0
    finally:
        exit_codes.sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


def doubled(number: int, report_progress: Any) -> int:
    report_progress(0.5)
    return 2 * number


@pytest.mark.nightly
def test_workers_can_begin_from_nothing(monkeypatch: Patch) -> None:
    """As they do on macOS and Windows, which have no server to fork from."""
    monkeypatch.setattr(executors, "has_fork_server", lambda: False)
    pool = executors.ProcessPool(doubled, 2)
    assert sorted(ended.result for ended in pool.run([1, 2, 3])) == [2, 4, 6]


def text_files() -> Iterator[tuple[str, str]]:
    """Calls of the package that open or write a file as text, but for members of archives."""
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            called = isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", ""))
            text = ast.unparse(node) if called in ("open", "write_text") else ""
            if re.match(r"(?!archive)[\w.]+\.write_text\(|(?!archive)([\w.]+\.)?open\(.*'[wax]t?'", text):
                yield path.name, text


def test_lines_end_alike_on_all_systems() -> None:
    """Text files are written with `newline`: without it, Windows would put CR LF."""
    found = list(text_files())
    assert len(found) >= 4
    assert [one for one in found if "newline=" not in one[1]] == []
