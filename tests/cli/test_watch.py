"""`accelcal watch` as a process: pipes, signals, states and streams of rows."""

from __future__ import annotations

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

from tests.cli.run import Ran, command, exit_code, run, run_process
from tests.recordings import LSB_PER_G, good_raw, paper_recording

Capture = pytest.CaptureFixture[str]
PAPER = ("--profile", "paper")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return paper_recording(tmp_path_factory.mktemp("watched"))


@pytest.fixture(scope="module")
def undisturbed(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Any], bytes]:
    """Events and state of a watch that nothing disturbed."""
    state = tmp_path_factory.mktemp("states") / "state"
    ran = run_process("watch", recording, *PAPER, "--state", state)
    assert (ran.code, ran.err) == (0, "")
    return events_of(ran), state.read_bytes()


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


def test_a_named_pipe_gives_the_same_events_and_state(
    recording: Path, undisturbed: tuple[list[Any], bytes], tmp_path: Path
) -> None:
    pipe, state = tmp_path / "paper.raw", tmp_path / "state"
    (tmp_path / "paper.layout.toml").write_bytes(recording.with_name("paper.layout.toml").read_bytes())
    os.mkfifo(pipe)
    thread = fed(pipe, pieces(recording.read_bytes(), Random(1)))
    ran = run_process("watch", pipe, *PAPER, "--state", state)
    thread.join()
    assert (ran.code, ran.err) == (0, "")
    assert events_of(ran) == undisturbed[0]
    assert state.read_bytes() == undisturbed[1]
    assert [event["event"] for event in undisturbed[0]].count("fitted") == 1
    assert undisturbed[0][-1]["event"] == "ended"


@pytest.mark.parametrize(
    "how", ["SIGINT", *(pytest.param(how, marks=pytest.mark.nightly) for how in ("SIGTERM", "SIGKILL"))]
)
def test_what_ends_a_watch_leaves_a_state_to_go_on_with(
    how: str, recording: Path, undisturbed: tuple[list[Any], bytes], tmp_path: Path
) -> None:
    """It is ended when it has told its first fit, while it waits for more."""
    data, state = recording.read_bytes(), tmp_path / "state"
    words = command("watch", "-", *PAPER, *layout_of(recording), "--state", state)
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(words, **pipes, bufsize=0) as process:  # type: ignore[call-overload]
        feeding = threading.Thread(target=process.stdin.write, args=(data[:1_400_000],))
        feeding.start()
        while json.loads(process.stdout.readline())["event"] != "fitted":
            pass
        feeding.join()
        process.send_signal(getattr(signal, how))
        error = process.stderr.read().decode()
        process.wait()
    if how == "SIGKILL":
        assert process.returncode == -signal.SIGKILL
    else:
        assert process.returncode == 130
        assert f"go on with --state {state}, from byte " in error
        assert len(error.splitlines()) == 1
    first = json.loads(state.read_bytes().split(b"\n", 1)[0])["bytes"] if state.exists() else 0
    ran = run_process("watch", "-", *PAPER, *layout_of(recording), "--state", state, stdin=data[first:])
    assert (ran.code, ran.err) == (0, "")
    assert events_of(ran)[-1] == undisturbed[0][-1]
    mine, theirs = (json.loads(one.split(b"\n", 1)[0]) for one in (state.read_bytes(), undisturbed[1]))
    assert mine["bytes"] == theirs["bytes"]
    assert mine["samples"] == theirs["samples"]


def test_a_file_goes_on_where_it_was_left(
    recording: Path, undisturbed: tuple[list[Any], bytes], tmp_path: Path, capsys: Capture
) -> None:
    data, path, state = recording.read_bytes(), tmp_path / "paper.raw", tmp_path / "state"
    (tmp_path / "paper.layout.toml").write_bytes(recording.with_name("paper.layout.toml").read_bytes())
    events = []
    for size in (400_000, 1_200_000, 1_300_001, len(data)):
        path.write_bytes(data[:size])
        ran = run(capsys, "watch", path, *PAPER, "--state", state)
        assert ran.err == ""
        events += [event for event in events_of(ran) if event["event"] != "ended"]
    assert events == undisturbed[0][:-1]
    assert state.read_bytes() == undisturbed[1]


def expected_rows(recording: Path, event: dict[str, Any]) -> np.ndarray:
    """a = K (v + o), by hand, of all rows from the fit on."""
    counts = np.frombuffer(recording.read_bytes(), "<i2").reshape(-1, 3)[event["samples"] :]
    gain, offset = np.array(event["calibration"]["gain"]), np.array(event["calibration"]["offset_g"])
    return (counts / LSB_PER_G + offset) @ gain.T


def test_rows_go_to_standard_output_and_events_to_stderr(recording: Path) -> None:
    ran = run_process("watch", recording, *PAPER, "-o", "-")
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


def test_rows_as_an_arrow_stream(recording: Path, tmp_path: Path, capsys: Capture) -> None:
    ran = run(capsys, "watch", recording, *PAPER, "-o", tmp_path / "rows.arrows")
    (fitted,) = [event for event in events_of(ran) if event["event"] == "fitted"]
    table = pa.ipc.open_stream(io.BytesIO((tmp_path / "rows.arrows").read_bytes())).read_all()
    assert table.schema.names == ["time", "x", "y", "z", "validity"]
    assert table.schema.field("x").metadata == {b"unit": b"g"}
    found = np.stack([table[axis].to_numpy() for axis in "xyz"], axis=1)
    assert np.abs(found - expected_rows(recording, fitted)).max() < 1e-6


def test_rows_are_on_the_disk_before_a_state_that_knows_of_them(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state, rows, order, bring = tmp_path / "state", tmp_path / "rows.csv", [], os.fsync

    def noted(file: int) -> None:
        order.append(os.fstat(file).st_ino)
        bring(file)

    monkeypatch.setattr(os, "fsync", noted)
    assert exit_code("watch", recording, *PAPER, "--state", state, "-o", rows) == 0
    assert order[order.index(state.stat().st_ino) - 1] == rows.stat().st_ino


def test_what_cannot_be_is_refused_in_a_line(recording: Path, tmp_path: Path, capsys: Capture) -> None:
    state, output = tmp_path / "state", tmp_path / "rows.csv"
    state.write_bytes(b"nonsense")
    output.write_bytes(b"mine")
    for words, code, text in (
        ((recording, "--state", state), 3, "is no state of accelcal watch"),
        ((recording, "--to", "csv"), 2, "--to is for --output only"),
        ((recording, "-o", output), 2, "exists already"),
        ((recording, "-o", recording), 2, "is the recording itself"),
        ((tmp_path / "nothing.csv",), 3, "cannot be read"),
        ((tmp_path,), 3, "is a folder"),
    ):
        ran = run(capsys, "watch", *words)
        assert (ran.code, ran.out) == (code, ""), ran
        assert text in ran.err
        assert len(ran.err.splitlines()) == 1
    assert output.read_bytes() == b"mine"


def test_too_little_stillness_is_exit_code_4(tmp_path: Path, capsys: Capture) -> None:
    path = good_raw(tmp_path)
    path.write_bytes(path.read_bytes()[:20_000])
    ran = run(capsys, "watch", path)
    assert ran.code == 4
    assert events_of(ran)[-1]["outcome"] == "refused"
    assert run_process("watch", "-", stdin=b"").code == 3
