"""`accelcal watch`."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import stat
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, BinaryIO

import click

from accelcal_cli.cli import exit_codes, options
from accelcal_cli.core.calibration import Transform
from accelcal_cli.core.errors import UnreadableError, UsageError, output_error, printable
from accelcal_cli.core.recording import Recording
from accelcal_cli.output.files import exists
from accelcal_cli.pipeline import watch_state
from accelcal_cli.pipeline.given import read_options, settings
from accelcal_cli.pipeline.jobs import STDIN, Request
from accelcal_cli.pipeline.watch import Calibrated, Happened, Watch

if TYPE_CHECKING:
    from accelcal_cli.output.row_stream import RowFile, RowStream

PIECE_BYTES = 1 << 16
SAVE_S = 1800
"""A state is saved at each event, and after so many seconds of recording."""

FITS = ("fitted", "refitted", "drifted")
KINDS = ("arrow", "csv")


@click.command("watch")
@click.argument("recording", type=options.FILE)
@click.option("--state", type=options.FILE, metavar="FILE",
              help="Keep in FILE where the watch stands, so that it can be stopped and go on.")  # fmt: skip
@click.option("-o", "--output", type=options.FILE, metavar="FILE",
              help="Write calibrated rows from the first fit on; `-` is standard output.")  # fmt: skip
@click.option("--to", "kind", type=options.OneOf(KINDS),
              help="Rows as an Arrow IPC stream or as CSV.  [default: csv for .csv and `-`]")  # fmt: skip
@options.recalibrate_option
@options.method_options
@options.damage_option
@options.precision_option
@options.stream_options
def command(recording: Path, **values: Any) -> int:
    """Calibrate RECORDING, a file, a named pipe or `-`, while it grows.

    Prints a JSON object for each event: progress, fitted, refitted, drifted, ended; on stderr where rows
    go to standard output. The exit code is that of `calibrate` for all that came.
    """
    request = Request(options=read_options(values), settings=settings(values))
    request = request if recording == STDIN else request.for_recording(recording)
    if values["kind"] is not None and values["output"] is None:
        raise UsageError("--to is for --output only", hint="omit it")
    state = _State(values["state"], watch_state.options_sha256(request.options, request.recording_settings))
    watch = Watch(recording, request.options, request.recording_settings, state.load())
    with _input(recording, watch) as source, _Rows(values, recording) as rows, _Signals(recording) as signals:
        told = exit_codes.show if values["output"] != STDIN else _told_on_stderr
        return _watched(watch, source, state, signals, _Outputs(rows, told))


class _State:
    """The file of the state, if there is one."""

    def __init__(self, path: Path | None, made_with: str) -> None:
        self._path, self._made_with = path, made_with
        self._saved = 0

    def load(self) -> Any:
        """See `watch_state.load`."""
        return None if self._path is None else watch_state.load(self._path, self._made_with)

    def save(self, watch: Watch) -> None:
        """Save where a watch stands."""
        standing = watch.standing
        self._saved = 0 if standing.stage is None else standing.stage.samples
        if self._path is not None:
            watch_state.save(self._path, standing, self._made_with)

    def is_old(self, watch: Watch) -> bool:
        """Whether it is time to save."""
        stage = watch.standing.stage
        return stage is not None and stage.samples - self._saved >= SAVE_S * stage.recording.rate_hz

    def words(self, watch: Watch) -> tuple[str, ...]:
        """How to go on."""
        go_on = f"go on with --state {self._path}, from byte {watch.standing.taken}"
        return () if self._path is None else (go_on,)

    @property
    def kept(self) -> bool:
        """Whether the watch can go on later."""
        return self._path is not None


def _watched(watch: Watch, source: BinaryIO, state: _State, signals: _Signals, outputs: _Outputs) -> int:
    """Read to the end; the state is sound whenever a signal may end that."""

    def save() -> None:
        outputs.settle()
        state.save(watch)

    try:
        while data := signals.read(source):
            happened = watch.take(data)
            outputs.put(happened)
            if state.is_old(watch) or any(event["event"] in FITS for event in happened.events):
                save()
    except exit_codes.InterruptedBySignalError:
        save()
        raise exit_codes.InterruptedBySignalError(*state.words(watch)) from None
    save()
    happened = watch.end(for_good=not state.kept)
    outputs.put(happened)
    return exit_codes.OK if happened.events[-1]["calibration"] is not None else exit_codes.REFUSED


class _Signals:
    """Signals end the command only while it waits for bytes: what is half done is finished first."""

    def __init__(self, recording: Path) -> None:
        self._recording = recording
        self._held: dict[int, Any] = {}
        self._came = self._waiting = False

    def __enter__(self) -> _Signals:
        for number in (signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):
            if signal.getsignal(number) is not signal.SIG_IGN:
                self._held.setdefault(number, signal.signal(number, self._note))
        return self

    def __exit__(self, kind: type[BaseException] | None, *_failure: object) -> None:
        for number, handler in self._held.items():
            signal.signal(number, handler)
        if self._came and kind is None:
            raise exit_codes.InterruptedBySignalError

    def _note(self, _number: int, _frame: FrameType | None) -> None:
        self._came = True
        if self._waiting:
            raise exit_codes.InterruptedBySignalError

    def read(self, source: BinaryIO) -> bytes:
        """The next bytes; none at the end.

        Raises:
            InterruptedBySignalError: a signal came.
            UnreadableError: they cannot be read.
        """
        self._waiting = True
        try:
            if self._came:
                raise exit_codes.InterruptedBySignalError
            return os.read(source.fileno(), PIECE_BYTES)
        except OSError as error:
            raise _unreadable(error, self._recording) from error
        finally:
            self._waiting = False


@contextlib.contextmanager
def _input(recording: Path, watch: Watch) -> Iterator[BinaryIO]:
    """The bytes that follow on what the watch has taken in.

    Raises:
        UsageError: there is no standard input.
        UnreadableError: the file cannot be read, or is not the one that was watched.
    """
    if recording == STDIN:
        if sys.stdin is None:
            raise UsageError("standard input is closed", hint="give the name of a file")
        yield sys.stdin.buffer
        return
    with contextlib.ExitStack() as stack:
        try:
            file = recording.open("rb", buffering=0)
            stack.callback(_leave, file)
            if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                watch.go_on_in(file)
        except OSError as error:
            raise _unreadable(error, recording) from error
        yield file


def _leave(file: BinaryIO) -> None:
    """Close a file that was read: what could go wrong would change nothing."""
    with contextlib.suppress(OSError):
        file.close()


def _unreadable(error: OSError, recording: Path) -> UnreadableError:
    what = f"cannot be read ({error.strerror or error})"
    return UnreadableError(what, path=recording, hint="check the path and permissions")


def _told_on_stderr(text: str) -> None:
    click.echo(printable(text), err=True)


class _Outputs:
    """Where rows and events go."""

    def __init__(self, rows: _Rows, told: Callable[[str], None]) -> None:
        self._rows, self._told = rows, told

    def put(self, happened: Happened) -> None:
        """Write what came of some bytes."""
        for one in happened.rows:
            self._rows.write(one)
        for event in happened.events:
            self._told(json.dumps(event, allow_nan=False, ensure_ascii=False))

    def settle(self) -> None:
        """See that a state which is saved next knows of no rows that a power failure could take back."""
        self._rows.settle()


class _Rows:
    """Where calibrated rows go, if anywhere; begun with the first of them."""

    def __init__(self, values: dict[str, Any], recording: Path) -> None:
        self._path, self._precision_mg = values["output"], values["precision_mg"]
        self._kind = values["kind"]
        self._stack = contextlib.ExitStack()
        self._stream: RowStream | None = None
        self._file: RowFile | None = None
        if self._path is not None and self._kind is None:
            self._kind = "csv" if self._path == STDIN or self._path.suffix.lower() == ".csv" else "arrow"
        if self._path == STDIN and not hasattr(sys.stdout, "buffer"):
            raise UsageError("standard output is closed", hint="give the name of a file to --output")
        if self._path is not None and self._path != STDIN and exists(self._path) and self._path.is_file():
            same = recording != STDIN and self._path.samefile(recording)
            what = "is the recording itself" if same else "exists already"
            raise UsageError(what, path=self._path, hint="give another name to --output")

    def __enter__(self) -> _Rows:
        return self

    def __exit__(self, *_failure: object) -> None:
        self._stack.close()

    def write(self, rows: Calibrated) -> None:
        """Write rows as the coefficients in force make them."""
        if self._path is None:
            return
        if self._stream is None:
            self._stream = self._stack.enter_context(self._begun(rows.recording))
        right = Transform.of(rows.calibration, rows.recording.lsb_per_g, self._precision_mg)
        self._stream.write(rows.chunk, right.apply(rows.chunk))

    def _begun(self, recording: Recording) -> RowStream:
        from accelcal_cli.output.row_stream import RowFile, RowStream  # few runs write rows

        if self._path == STDIN:
            return RowStream(_to_standard_output, self._kind, recording)
        self._file = self._stack.enter_context(RowFile(self._path))
        return RowStream(self._file.put, self._kind, recording)

    def settle(self) -> None:
        """Bring the rows of a file to the disk; raises OutputError where that fails."""
        if self._file is not None:
            self._file.settle()


def _to_standard_output(piece: bytes) -> None:
    try:
        sys.stdout.buffer.write(piece)
        sys.stdout.buffer.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        raise output_error(error, STDIN) from error
