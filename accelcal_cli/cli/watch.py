"""`accelcal watch`."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, BinaryIO

import click

from accelcal_cli.cli import exit_codes, options
from accelcal_cli.cli.help import Command
from accelcal_cli.core.calibration import Transform
from accelcal_cli.core.errors import UsageError, output_error, printable, unread
from accelcal_cli.core.paths import is_file, is_same
from accelcal_cli.core.recording import Recording
from accelcal_cli.core.system import ending_signals
from accelcal_cli.output.files import exists
from accelcal_cli.pipeline.jobs import STDIN, Request
from accelcal_cli.pipeline.options import chosen_settings, read_options
from accelcal_cli.watching.watch import StepResult, Unpacker, Watch

if TYPE_CHECKING:
    from accelcal_cli.watching.row_stream import RowStream

PIECE_BYTES = 1 << 16
"""Most bytes that are read at a time."""

KINDS = ("arrow", "csv")


@click.command(
    "watch",
    cls=Command,
    examples=(
        "watch recording.cwa # a line of JSON for each event",
        "watch /dev/stdin --rate 100 --unit g -o calibrated.csv",
    ),
)
@click.argument("recording", type=options.FILE)
@click.option("-o", "--output", type=options.FILE, metavar="FILE",
              help="Write calibrated rows from the first fit on; `-` is standard output.")  # fmt: skip
@click.option("--to", "kind", type=options.OneOf(KINDS),
              help="Form of the rows: Arrow IPC stream or CSV.  [default: csv for .csv and `-`]")  # fmt: skip
@options.recalibrate_option
@options.method_options
@options.error_option
@options.precision_option
@options.stream_options
def command(recording: Path, **values: Any) -> int:
    """Calibrate RECORDING, a file, a named pipe or `-`, while it grows.

    Prints a JSON object for each event: progress, fitted, refitted, drifted, ended; on stderr where rows
    go to standard output. When the input ends, exits with the code `calibrate` would give for the complete
    recording.
    """
    request = Request(options=read_options(values), settings=chosen_settings(values))
    request = request if recording == STDIN else request.for_recording(recording)
    if values["kind"] is not None and values["output"] is None:
        raise UsageError("--to is for --output only", hint="omit it")
    watch, unpacker = Watch(recording, request.options, request.recording_settings), Unpacker(recording)
    with _input(recording) as source, _Outputs(values, recording) as outputs, _Signals(recording) as signals:
        while data := signals.read(source):
            for piece in unpacker.take(data):
                outputs.put(watch.take(piece))
        ended = watch.end()
        outputs.put(ended)
    return exit_codes.OK if ended.events[-1]["calibration"] is not None else exit_codes.REFUSED


class _Signals:
    """Signals end the command only while it waits for bytes: what is half done is finished first."""

    def __init__(self, recording: Path) -> None:
        self._recording = recording
        self._handlers: dict[int, Any] = {}
        self._came = self._waiting = False

    def __enter__(self) -> _Signals:
        for number in ending_signals():
            if signal.getsignal(number) is not signal.SIG_IGN:
                self._handlers[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_failure: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        if self._came and kind is None:
            raise exit_codes.InterruptedBySignalError

    def _note(self, _number: int, _frame: FrameType | None) -> None:
        self._came = True
        if self._waiting:
            raise exit_codes.InterruptedBySignalError

    def read(self, source: BinaryIO) -> bytes:
        """Read the next bytes; none at the end.

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
            raise unread(error, self._recording) from error
        finally:
            self._waiting = False


@contextlib.contextmanager
def _input(recording: Path) -> Iterator[BinaryIO]:
    """Open the recording for reading.

    Raises:
        UsageError: there is no standard input.
        UnreadableError: the file cannot be read.
    """
    if recording == STDIN:
        if sys.stdin is None:
            raise UsageError("standard input is closed", hint="give the name of a file")
        yield sys.stdin.buffer
        return
    try:
        file = recording.open("rb", buffering=0)
    except OSError as error:
        raise unread(error, recording) from error
    try:
        yield file
    finally:
        with contextlib.suppress(OSError):  # all that was read is sound
            file.close()


class _Outputs:
    """Where calibrated rows go, if anywhere, begun with the first of them; and where events go."""

    def __init__(self, values: dict[str, Any], recording: Path) -> None:
        self._path, self._precision_mg = values["output"], values["precision_mg"]
        self._kind = values["kind"]
        self._stack = contextlib.ExitStack()
        self._stream: RowStream | None = None
        if self._path is not None and self._kind is None:
            self._kind = "csv" if self._path == STDIN or self._path.suffix.lower() == ".csv" else "arrow"
        if self._path == STDIN and not hasattr(sys.stdout, "buffer"):
            raise UsageError("standard output is closed", hint="give the name of a file to --output")
        if self._path is not None and self._path != STDIN and exists(self._path) and is_file(self._path):
            same = recording != STDIN and is_same(self._path, recording)
            what = "is the recording itself" if same else "exists already"
            raise UsageError(what, path=self._path, hint="give another name to --output")

    def __enter__(self) -> _Outputs:
        return self

    def __exit__(self, *_failure: object) -> None:
        self._stack.close()

    def put(self, result: StepResult) -> None:
        """Write the rows, and show the events, that some bytes led to."""
        for rows in result.rows if self._path is not None else ():
            if self._stream is None:
                self._stream = self._stack.enter_context(self._begun(rows.recording))
            right = Transform.of(rows.calibration, rows.recording.lsb_per_g, self._precision_mg)
            self._stream.write(rows.chunk, right.apply(rows.chunk))
        for event in result.events:
            text = json.dumps(event, allow_nan=False, ensure_ascii=False)
            if self._path == STDIN:
                click.echo(printable(text), err=True)
            else:
                exit_codes.show(text)

    def _begun(self, recording: Recording) -> RowStream:
        from accelcal_cli.watching.row_stream import RowFile, RowStream  # few runs write rows

        if self._path == STDIN:
            return RowStream(_to_standard_output, self._kind, recording)
        file = self._stack.enter_context(RowFile(self._path))
        return RowStream(file.put, self._kind, recording)


def _to_standard_output(piece: bytes) -> None:
    try:
        sys.stdout.buffer.write(piece)
        sys.stdout.buffer.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        raise output_error(error, STDIN) from error
