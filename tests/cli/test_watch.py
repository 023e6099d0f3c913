"""`accelcal watch` as a process: pipes, signals, gzip and streams of rows."""

from __future__ import annotations

import gzip
import io
import json
import os
import signal
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from tests.cli.run import Ran, command, run, run_process
from tests.recordings import LSB_PER_G, good_raw, paper_recording

Capture = pytest.CaptureFixture[str]
PAPER = ("--profile", "paper")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return paper_recording(tmp_path_factory.mktemp("watched"))


@pytest.fixture(scope="module")
def undisturbed(recording: Path) -> list[Any]:
    """Events of a watch that nothing disturbed, with rows in `rows.arrows`."""
    ran = run_process("watch", recording, *PAPER, "-o", recording.with_name("rows.arrows"))
    assert (ran.code, ran.err) == (0, "")
    return events_of(ran)


def events_of(ran: Ran) -> list[Any]:
    return [json.loads(line) for line in ran.lines]


def layout_of(recording: Path) -> tuple[str, ...]:
    return ("--format", "raw", "--layout", str(recording.with_name("paper.layout.toml")))


def fed(path: Path, pieces: Iterator[bytes]) -> threading.Thread:
    """Writes into a named pipe, as a device would."""

    def write() -> None:
        with path.open("wb", buffering=0) as file:
            for piece in pieces:
                file.write(piece)

    thread = threading.Thread(target=write)
    thread.start()
    return thread


def pieces(data: bytes, random: Random) -> Iterator[bytes]:
    while data:
        size = random.randint(1, 100_000)
        yield data[:size]
        data = data[size:]


def beside(recording: Path, name: str, data: bytes | None = None) -> Path:
    """A path for another copy of the recording, with the layout beside it."""
    path = recording.parent / name
    path.parent.mkdir(exist_ok=True)
    if data is not None:
        path.write_bytes(data)
    (path.parent / "paper.layout.toml").write_bytes(recording.with_name("paper.layout.toml").read_bytes())
    return path


def test_a_named_pipe_gives_the_same_events(recording: Path, undisturbed: list[Any], capsys: Capture) -> None:
    pipe = beside(recording, "piped/paper.raw")
    os.mkfifo(pipe)
    thread = fed(pipe, pieces(recording.read_bytes(), Random(1)))
    ran = run(capsys, "watch", pipe, *PAPER)
    thread.join()
    assert (ran.code, ran.err) == (0, "")
    assert events_of(ran) == undisturbed
    assert [event["event"] for event in undisturbed].count("fitted") == 1
    assert undisturbed[-1]["event"] == "ended"


def test_gzip_that_grows_gives_the_same_events_each_time_from_its_start(
    recording: Path, undisturbed: list[Any], capsys: Capture
) -> None:
    """A member of the file for each part that came."""
    path, data = beside(recording, "packed/paper.raw.gz"), recording.read_bytes()
    for start, stop in ((0, 400_000), (400_000, len(data))):
        with path.open("ab") as file:
            file.write(gzip.compress(data[start:stop], 1))
        ran = run(capsys, "watch", path, *PAPER)
        assert ran.err == ""
        assert events_of(ran)[:-1] == [one for one in undisturbed[:-1] if one["bytes"] <= stop]
    assert events_of(ran) == undisturbed


@pytest.mark.parametrize("how", ["SIGINT", pytest.param("SIGTERM", marks=pytest.mark.nightly)])
def test_what_ends_a_watch_leaves_whole_rows(how: str, recording: Path, tmp_path: Path) -> None:
    """It is ended when it has told its first fit, while it waits for more."""
    data, rows = recording.read_bytes(), tmp_path / "rows.csv"
    words = command("watch", "-", *PAPER, *layout_of(recording), "-o", rows)
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(words, **pipes, bufsize=0) as process:  # type: ignore[call-overload]
        feeding = threading.Thread(target=process.stdin.write, args=(data[:1_400_000],))
        feeding.start()
        while (event := json.loads(process.stdout.readline()))["event"] != "fitted":
            pass
        feeding.join()
        process.send_signal(getattr(signal, how))
        error = process.stderr.read().decode()
        process.wait()
    assert process.returncode == 130
    assert error == "accelcal: interrupted; no incomplete output was left behind\n"
    found, expected = rows.read_text(), expected_rows(recording, event)
    assert found.endswith("\n")
    values = np.array([row.split(",")[1:4] for row in found.splitlines()[1:]], float)
    assert len(values) > 10_000
    assert np.abs(values - expected[: len(values)]).max() < 1e-6


def expected_rows(recording: Path, event: dict[str, Any]) -> np.ndarray:
    """a = K (v + o), by hand, of all rows from the fit on."""
    counts = np.frombuffer(recording.read_bytes(), "<i2").reshape(-1, 3)[event["samples"] :]
    gain, offset = np.array(event["calibration"]["gain"]), np.array(event["calibration"]["offset_g"])
    return (counts / LSB_PER_G + offset) @ gain.T


def test_rows_go_to_standard_output_and_events_to_stderr(
    recording: Path, undisturbed: list[Any], capsys: Capture
) -> None:
    (fitted,) = [event for event in undisturbed if event["event"] == "fitted"]
    recording = beside(recording, "short/paper.raw", recording.read_bytes()[: fitted["samples"] * 6 + 60_000])
    ran = run(capsys, "watch", recording, *PAPER, "-o", "-")
    events = [json.loads(line) for line in ran.err.splitlines()]
    (fitted,) = [event for event in events if event["event"] == "fitted"]
    head, *rows = ran.lines
    assert head == '"time","x","y","z","validity"'
    expected = expected_rows(recording, fitted)
    assert len(rows) == len(expected)
    values = np.array([row.split(",")[1:4] for row in rows], float)
    assert np.abs(values - expected).max() < 1e-6
    seconds = 1709510400 + fitted["samples"] / 25
    assert np.datetime64(rows[0].split(",")[0].strip('"')) == np.datetime64(round(seconds * 1e6), "us")


def test_rows_as_an_arrow_stream(recording: Path, undisturbed: list[Any]) -> None:
    (fitted,) = [event for event in undisturbed if event["event"] == "fitted"]
    table = pa.ipc.open_stream(io.BytesIO(recording.with_name("rows.arrows").read_bytes())).read_all()
    assert table.schema.names == ["time", "x", "y", "z", "validity"]
    assert table.schema.field("x").metadata == {b"unit": b"g"}
    found = np.stack([table[axis].to_numpy() for axis in "xyz"], axis=1)
    assert np.abs(found - expected_rows(recording, fitted)).max() < 1e-6


def test_what_cannot_be_is_refused_in_a_line(recording: Path, tmp_path: Path, capsys: Capture) -> None:
    output = tmp_path / "rows.csv"
    output.write_bytes(b"mine")
    for words, code, text in (
        ((recording, "--to", "csv"), 2, "--to is for --output only"),
        ((recording, "-o", output), 2, "exists already"),
        ((recording, "-o", recording), 2, "is the recording itself"),
        ((tmp_path / "nothing.csv",), 3, "file not found"),
        ((tmp_path,), 3, "is a folder"),
    ):
        ran = run(capsys, "watch", *words)
        assert (ran.code, ran.out) == (code, ""), ran
        assert text in ran.err
        assert len(ran.err.splitlines()) == 1
    assert output.read_bytes() == b"mine"


def test_too_little_stillness_is_exit_code_4(tmp_path: Path, capsys: Capture) -> None:
    path = good_raw(tmp_path)
    path.write_bytes(path.read_bytes()[:4_000])
    ran = run(capsys, "watch", path)
    assert ran.code == 4
    assert events_of(ran)[-1]["outcome"] == "refused"
