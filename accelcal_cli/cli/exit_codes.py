"""Exit codes from errors, in the only place that knows both; and the only way by which text is printed.

Whatever a file says of itself, no control character of it reaches the terminal.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import click

from accelcal_cli.core.errors import (
    AccelcalError,
    OutputError,
    UnreadableError,
    cause_of_kind,
    disk_fault,
    missing_resource,
    printable,
)
from accelcal_cli.core.system import clear_alarm, ending_signals, set_alarm

OK = 0
SOME_FAILED = 1
REFUSED = 4
BUG = 70
NO_MEMORY = 71
INTERRUPTED = 130
STDERR = 2
AGAIN_S = 0.001
DELETE = "\x7f"
"""Control character that our JSON text contains as it is."""


def of_all(codes: list[int]) -> int:
    """Return the exit code of a command that did several things; of a single one its own."""
    if len(codes) == 1:
        return codes[0]
    return SOME_FAILED if any(codes) else OK


class InterruptedBySignalError(BaseException):
    """A signal that ends the command: unwinds the stack, so that temporaries are removed.

    It may be given a hint how to continue.
    """


def run_safely(command: Callable[[], Any]) -> int:
    """Run a command and turn whatever happens into an exit code, with one line on stderr.

    The command returns its exit code, or None for 0.
    """
    try:
        watch_signals()
        code = _code_of(command)
        _end_silently_on_signals()
    except (KeyboardInterrupt, InterruptedBySignalError, click.Abort) as stop:
        _end_silently_on_signals()
        more = stop.args[:1] if isinstance(stop, InterruptedBySignalError) else ()
        say("; ".join(["interrupted", "no incomplete output was left behind", *more]))
        code = INTERRUPTED
    return code if isinstance(code, int) else OK


def _code_of(command: Callable[[], Any]) -> Any:
    _open_standard_files()
    try:
        code = command()
        sys.stdout.flush()
        if isinstance(sys.stdout, _LostOutput) and sys.stdout.lines:
            raise OutputError(f"{sys.stdout.why}: the output was lost")
    except click.Abort:
        raise
    except Exception as error:
        code = of_failure(error)
    return code


def of_failure(error: Exception) -> int:
    """Print an error that is being handled in one line and return its exit code.

    Raises:
        InterruptedBySignalError: it was raised while a signal ended the command, whose code counts.
    """
    if cause_of_kind(error, InterruptedBySignalError, KeyboardInterrupt):
        raise InterruptedBySignalError from None
    if isinstance(error, click.ClickException):
        say(_usage(error))
        return error.exit_code
    if isinstance(error, AccelcalError):
        say(str(error))
        return error.exit_code
    if isinstance(error, BrokenPipeError):
        _silence(sys.stdout)
        return SOME_FAILED
    lost = isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EIO, errno.EDQUOT)
    if isinstance(error, OSError) and lost and error.filename is None:  # not one of the outputs
        say(f"standard output cannot be written ({error.strerror})")
        _silence(sys.stdout)
        return OutputError.exit_code
    return report_bug()


class _LostOutput(io.StringIO):
    """Stand-in for a standard output that is closed or can take no more; the work continues."""

    def __init__(self, why: str, *, lines: bool) -> None:
        super().__init__()
        self.why = why
        self.lines = lines

    def write(self, text: str) -> int:
        self.lines = self.lines or text != ""
        return len(text)


def _open_standard_files() -> None:
    """Open standard files that are closed, so that no output file gets one of their numbers."""
    while (handle := os.open(os.devnull, os.O_RDWR)) <= STDERR:
        pass
    os.close(handle)
    if sys.stdout is None:
        sys.stdout = _LostOutput("standard output is closed", lines=False)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a terminal's encoding may lack characters


def show(text: str) -> None:
    """Print lines of tab-separated fields, or of JSON, on standard output.

    Where it can take no more, the work continues, and the exit code says so; where its reader is gone, it
    ends.
    """
    try:
        click.echo(printable(text.replace(DELETE, "\\u007f"), kept="\n\t"))
    except BrokenPipeError:
        raise
    except OSError as error:
        _silence(sys.stdout)
        sys.stdout = _LostOutput(f"standard output cannot be written ({error.strerror})", lines=True)


def say(message: str) -> None:
    """Print one line on stderr; if nobody can take it, the exit code still tells."""
    if sys.stderr is not None:
        try:
            click.echo(f"accelcal: {printable(message)}", err=True)
        except OSError:
            _silence(sys.stderr)


def _usage(error: click.ClickException) -> str:
    """Return click's message in one line, with the command whose help tells more."""
    text = " ".join(error.format_message().split()).removesuffix(".")
    text = f"{text[:1].lower()}{text[1:]}"
    if not isinstance(error, click.UsageError):
        return text
    command = "accelcal" if error.ctx is None else error.ctx.command_path
    return f"{text}{' See' if text.endswith('?') else '; see'}: {command} --help"


def report_bug(path: Path | None = None) -> int:
    """Keep the traceback of the current exception in a file, and say where; running out of memory is not a
    bug.

    Args:
        path: the file in work when the bug appeared.

    Raises:
        InterruptedBySignalError: it came of a signal, which may end the wait for a lock within the code that
            releases it.
    """
    import traceback

    kind, value, _ = sys.exc_info()
    if cause_of_kind(value, InterruptedBySignalError, KeyboardInterrupt):
        raise InterruptedBySignalError from None
    if (lack := missing_resource(value)) is not None:
        where = "" if path is None else f"{path}: "
        say(f"{where}{lack}; free some, or give fewer --chunk-samples")
        return NO_MEMORY
    if (fault := disk_fault(value)) is not None:
        say(fault)
        return UnreadableError.exit_code
    name = "error" if kind is None else kind.__name__
    text = " ".join(f"{name}: {value}".split())
    say(f"a bug in accelcal ({text}); please report it with {keep_trace(traceback.format_exc())}")
    return BUG


def keep_trace(text: str) -> str:
    """Write a traceback into a temporary file; return its name, or the bug's place if there is no room."""
    import tempfile  # here and above: a run without a bug need not wait for them

    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="accelcal-bug-", suffix=".txt", delete=False, encoding="utf-8", errors="replace"
        ) as file:
            file.write(text)
    except OSError:
        places = [line.strip() for line in text.splitlines() if line.startswith("  File ")]
        return f"its place ({places[-1] if places else 'unknown'}); no temporary file can be written"
    return file.name


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise InterruptedBySignalError


def watch_signals() -> None:
    """Let signals that end the command raise InterruptedBySignalError from now on."""
    for number in ending_signals():
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)
    sys.unraisablehook = _raise_lost_interruption


def _end_silently_on_signals() -> None:
    """Let signals end the process silently from now on: there is nothing left to tidy up."""
    clear_alarm(_interrupt)
    for number in ending_signals():
        if signal.getsignal(number) is _interrupt:
            signal.signal(number, signal.SIG_DFL)


def _raise_lost_interruption(lost: sys.UnraisableHookArgs) -> None:
    """Raise an interruption again that was lost in a callback, such as one of an import."""
    if lost.exc_type is not InterruptedBySignalError:
        sys.__unraisablehook__(lost)
    else:
        set_alarm(_interrupt, AGAIN_S)


def _silence(stream: Any) -> None:
    """Send the interpreter's last flush nowhere, after the reader of our output has gone."""
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
