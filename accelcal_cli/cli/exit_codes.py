"""From errors to exit codes: the only place that knows both."""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

import click

from accelcal_cli.core.errors import AccelcalError, OutputError

OK = 0
SOME_FAILED = 1
REFUSED = 4
BUG = 70
INTERRUPTED = 130
STDERR = 2


def of_all(codes: list[int]) -> int:
    """The exit code of a command that did several things: its own for a single one."""
    if len(codes) == 1:
        return codes[0]
    return SOME_FAILED if any(codes) else OK


class InterruptedBySignalError(BaseException):
    """A signal that ends the command: unwinds the stack, so that temporaries are removed."""


def run_safely(command: Callable[[], Any]) -> int:
    """Run a command and turn whatever happens into an exit code, with one line on stderr.

    The command returns its exit code, or None for 0.
    """
    _watch_signals()
    try:
        code = _code_of(command)
    except (KeyboardInterrupt, InterruptedBySignalError, click.Abort):
        say("interrupted; no incomplete output was left behind")
        code = INTERRUPTED
    return code if isinstance(code, int) else OK


def _code_of(command: Callable[[], Any]) -> Any:
    lost = _open_standard_files()
    try:
        code = command()
        sys.stdout.flush()
        if lost is not None and lost.lines:
            raise OutputError("standard output is closed: the output was lost")
    except click.Abort:
        raise
    except click.ClickException as error:
        error.show()
        code = error.exit_code
    except AccelcalError as error:
        say(str(error))
        code = error.exit_code
    except BrokenPipeError:
        _silence_stdout()
        code = SOME_FAILED
    except OSError as error:
        code = _output_failed(error)
    except Exception:
        code = report_bug()
    return code


class _Lost(io.StringIO):
    """Stands for a standard output that was closed before this process began; the work goes on."""

    lines = False

    def write(self, text: str) -> int:
        self.lines = self.lines or text != ""
        return len(text)


def _open_standard_files() -> _Lost | None:
    """Fill the places of standard files that are closed, so that no output of ours comes to lie there."""
    while (handle := os.open(os.devnull, os.O_RDWR)) <= STDERR:
        pass
    os.close(handle)
    if sys.stdout is not None:
        return None
    lost = _Lost()
    sys.stdout = lost
    return lost


def _output_failed(error: OSError) -> int:
    """A write that failed outside the outputs is one to standard output; all else is a bug."""
    if error.errno not in (errno.ENOSPC, errno.EIO, errno.EDQUOT) or error.filename is not None:
        return report_bug()
    say(f"standard output cannot be written ({error.strerror})")
    _silence_stdout()
    return OutputError.exit_code


def say(message: str) -> None:
    """One line on stderr."""
    if sys.stderr is not None:
        click.echo(f"accelcal: {message}", err=True)


def report_bug() -> int:
    """Keep the traceback of the current exception in a file, and say where.

    Raises:
        InterruptedBySignalError: it came of a signal, which may end the wait for a lock within the code that
            releases it.
    """
    import traceback

    kind, value, _ = sys.exc_info()
    if _came_of_a_signal(value):
        raise InterruptedBySignalError from None
    name = "error" if kind is None else kind.__name__
    text = " ".join(f"{name}: {value}".split())
    say(f"a bug in accelcal ({text}); please report it with {keep_trace(traceback.format_exc())}")
    return BUG


def _came_of_a_signal(error: BaseException | None) -> bool:
    while error is not None and not isinstance(error, KeyboardInterrupt | InterruptedBySignalError):
        error = error.__context__
    return error is not None


def keep_trace(text: str) -> str:
    """Write a traceback into a temporary file; returns its name."""
    import tempfile  # here and above: a run without a bug need not wait for them

    with tempfile.NamedTemporaryFile(
        "w", prefix="accelcal-bug-", suffix=".txt", delete=False, encoding="utf-8"
    ) as file:
        file.write(text)
    return file.name


def _watch_signals() -> None:
    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise InterruptedBySignalError

    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, interrupt)


def _silence_stdout() -> None:
    """Whoever read our output is gone: let the interpreter's last flush go nowhere."""
    devnull = os.open(os.devnull, os.O_WRONLY)
    os.dup2(devnull, sys.stdout.fileno())
