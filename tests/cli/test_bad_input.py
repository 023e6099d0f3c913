"""Whatever the input, one line that helps, the right code, and nothing left behind."""

from __future__ import annotations

import gzip
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.cli.run import Ran, assert_one_line, command, files, little_room, nightly, run, run_process
from tests.recordings import RATE_HZ, directions, good_csv, still_counts, write_csv

Begun = Callable[[Path, Path], subprocess.Popen[bytes]]


def refuse(path: Path, code: int, *parts: str, options: tuple[object, ...] = ()) -> Ran:
    before = files(path.parent)
    ran = run("calibrate", path, *options)
    assert ran.code == code, ran
    assert_one_line(ran, str(path), *parts)
    left = [name for name in files(path.parent) if name not in before]
    refused = [f"{path.stem}.{kind}.json" for kind in ("calibration", "quality")]
    assert left in ([], refused if code == 4 else [])
    return ran


def test_a_missing_file(tmp_path: Path) -> None:
    refuse(tmp_path / "absent.csv", 3, "file not found")


def test_an_empty_file(tmp_path: Path) -> None:
    path = tmp_path / "empty.bin"
    path.touch()
    refuse(path, 3, "is empty", "byte 0")


def test_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    folder.mkdir()
    refuse(folder, 3, "is a folder")


@pytest.mark.parametrize("suffix", ["bin", "cwa", "csv", "h5", "raw", "gt3x", "csv.gz", ""])
def test_random_bytes_under_any_name(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"noise.{suffix}"
    path.write_bytes(np.random.RandomState(1).bytes(50_000))
    refuse(path, 3)


def test_t17_text_in_a_column_is_damage_unless_it_is_everywhere(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    lines = path.read_text().splitlines()
    good = run("calibrate", path, "--report-only", "--json")
    lines[1000] = lines[1000].rsplit(",", 1)[0] + ",broken"
    path.write_text("\n".join(lines) + "\n")
    ran = run("calibrate", path, "--report-only", "--json", "--force")
    assert (ran.code, good.code) == (0, 0)
    (problem,) = json.loads(ran.out)["file_health"]["problems"]
    assert (
        problem["code"] == "bad_line" and "line 1001" in problem["message"] and "broken" in problem["message"]
    )
    for index in range(5000, len(lines)):
        lines[index] = lines[index].rsplit(",", 1)[0] + ",broken"
    path.write_text("\n".join(lines) + "\n")
    path.with_suffix(".calibration.json").unlink()
    refuse(path, 3, "line 1001", "broken")


def test_some_missing_values_are_reported_and_the_rest_is_used(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    lines = path.read_text().splitlines()
    for index in (1000, 1001, 5000):
        lines[index] = lines[index].rsplit(",", 1)[0] + ",NaN"
    path.write_text("\n".join(lines) + "\n")
    assert "missing_value" in run("calibrate", path, "--model", 6, code=0).err


def test_nothing_but_nan(tmp_path: Path) -> None:
    path = tmp_path / "nan.csv"
    path.write_text("time,x,y,z\n" + "".join(f"{i / 25},nan,nan,nan\n" for i in range(1000)))
    refuse(path, 3)


def test_constant_data(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "constant.csv", np.tile(np.array([[0, 0, 256]], np.int16), (5000, 1)))
    refuse(path, 4, "one constant value")


def test_no_still_window(tmp_path: Path) -> None:
    time_s = np.arange(10_000) / RATE_HZ
    shaken = np.stack([np.sin(time_s * f) for f in (3.0, 4.0, 5.0)], axis=1)
    path = write_csv(tmp_path / "shaken.csv", (256 * shaken).astype(np.int16))
    refuse(path, 4, "no still window")


def test_an_output_folder_that_cannot_be_made(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    (tmp_path / "file").touch()
    assert_one_line(run("calibrate", path, "-d", tmp_path / "file" / "out"), "out", "cannot be made", code=5)


def test_unknown_names(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    for words in (
        ("--format", "x"),
        ("--optimizer", "x"),
        ("--columns", "a,b"),
        ("--model", "7"),
        ("--nope",),
    ):
        assert "Traceback" not in run("calibrate", path, *words, code=2).err
    assert files(tmp_path) == ["good.csv"]


@pytest.mark.parametrize(
    "words",
    [
        ("--timezone", "+25:00"),
        ("--timezone", "posixrules"),
        ("--profile", "paper", "--model", "3"),
        ("--min-distance-g", "0.2"),
        ("--profile", "default", "--min-distance-g", "0"),
        ("--min-subset-points", "2"),
        ("--max-subset-points", "3"),
        ("--profile", "paper", "--min-subset-points", "3", "--max-subset-points", "2"),
        ("--stillness-axis", "y"),
        ("--profile", "paper", "--stillness", "both", "--stillness-axis", "y"),
    ],
)
def test_impossible_numbers_and_zones(tmp_path: Path, words: tuple[str, ...]) -> None:
    run("calibrate", good_csv(tmp_path), *words, code=2)
    assert files(tmp_path) == ["good.csv"]


@pytest.mark.parametrize("step", [13, nightly(1)])
def test_one_flipped_bit_in_a_gzip_file_is_never_taken_for_data(tmp_path: Path, step: int) -> None:
    packed = bytearray(gzip.compress(good_csv(tmp_path).read_bytes()))
    path = tmp_path / "flipped.csv.gz"
    for at in range(len(packed) // 3, len(packed) // 3 + 40, step):
        path.write_bytes(packed[:at] + bytes([packed[at] ^ 4]) + packed[at + 1 :])
        refuse(path, 3)


def test_a_gzip_file_cut_short_gives_its_rows_and_says_so(tmp_path: Path) -> None:
    packed = gzip.compress(good_csv(tmp_path).read_bytes())
    path = tmp_path / "cut.csv.gz"
    path.write_bytes(packed[: len(packed) * 3 // 4])
    assert "truncated" in run("calibrate", path, "--model", 6, code=0).err
    run("calibrate", tmp_path / "good.csv", "--model", 6, code=0)
    part, full = (pd.read_parquet(tmp_path / f"{name}.calibrated.parquet") for name in ("cut", "good"))
    assert 0 < len(part) < len(full)
    assert (part["time"] == full["time"].iloc[: len(part)]).all()


@pytest.mark.parametrize("name", [nightly("l" * 240 + ".csv"), os.fsdecode(b"bad\xff\tand\nline.csv")])
def test_strange_names(tmp_path: Path, name: str) -> None:
    path = good_csv(tmp_path, name)
    ran = run_process("calibrate", path, "--report-only", "--model", 6)
    assert ran.code in (0, 5), ran
    assert len(ran.lines) == (1 if ran.code == 0 else 0)
    assert len(ran.lines[0].split("\t")) == 11 if ran.lines else "too long" in ran.err


def test_a_loop_of_links_stops_only_itself(tmp_path: Path) -> None:
    loop = tmp_path / "loop.csv"
    loop.symlink_to(loop)
    assert len(run("calibrate", loop, good_csv(tmp_path), "--model", 6, code=1).lines) == 1
    assert run("calibrate", loop).code == 3


def test_a_failed_rerun_keeps_the_earlier_result(tmp_path: Path) -> None:
    path, out = good_csv(tmp_path), tmp_path / "out"
    assert run("calibrate", path, "-d", out).code == 0
    before = {name: (out / name).read_bytes() for name in files(out)}
    with little_room(100_000):
        assert run("calibrate", path, "-d", out, "--force").code == 5
    assert {name: (out / name).read_bytes() for name in files(out)} == before


def running(path: Path, out: Path) -> subprocess.Popen[bytes]:
    """A process that is writing the calibrated rows of a long recording, at any point of it."""
    process = subprocess.Popen(
        command("calibrate", "--model", 6, path, "-d", out, "--chunk-samples", 50),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    while not (out.is_dir() and any(name.endswith(".tmp") for name in files(out))):
        assert process.poll() is None, process.communicate()
        time.sleep(0.001)
    return process


def paused(path: Path, out: Path) -> subprocess.Popen[bytes]:
    """A process that has written the first of its calibrated rows and writes no more."""
    told, tell = os.pipe()
    process = subprocess.Popen(
        [sys.executable, "-c", PAUSING, str(tell), "calibrate", str(path), "-d", str(out), "--model", "6"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        pass_fds=[tell],
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    os.close(tell)
    with os.fdopen(told, "rb") as pipe:
        assert pipe.read(1), process.communicate()
    return process


PAUSING = """
import os, sys, time
from accelcal_cli.cli.main import main
from accelcal_cli.parquet import ParquetSink
tell, write = int(sys.argv.pop(1)), ParquetSink.write
def write_and_pause(sink, portions, fill):
    yield next(write(sink, portions, fill))
    os.write(tell, b"w")
    while True:
        time.sleep(0.01)
ParquetSink.write = write_and_pause
main()
"""
in_the_middle = pytest.mark.parametrize(("begun", "poses"), [(paused, 60), nightly(running, 600)])


@in_the_middle
def test_temporaries_of_a_killed_run_go_with_the_next(tmp_path: Path, begun: Begun, poses: int) -> None:
    path, out = write_csv(tmp_path / "long.csv", still_counts(directions(poses))), tmp_path / "out"
    process = begun(path, out)
    process.kill()
    process.communicate()
    assert any(name.endswith(".tmp") for name in files(out))
    assert run("calibrate", path, "-d", out, "--model", 6).code == 0
    assert files(out) == ["long.calibrated.parquet", "long.calibration.json", "long.quality.json"]


def test_a_closed_standard_error_does_not_stop_the_work(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    shell = " ".join(shlex.quote(word) for word in command("calibrate", path, "--model", 6))
    done = subprocess.run(f"{shell} 2>&-", shell=True, capture_output=True, check=False)
    assert done.returncode == 0, done
    assert (tmp_path / "good.calibration.json").exists()


def test_a_full_disk(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    out = tmp_path / "out"
    with little_room(100_000):
        ran = run("calibrate", path, "-d", out)
    assert ran.code == 5
    assert_one_line(ran, "good.calibrated.parquet", "cannot be written")
    assert files(out) == []


@in_the_middle
@pytest.mark.parametrize("number", [signal.SIGINT, nightly(signal.SIGTERM)])
def test_interruption_leaves_nothing_behind(tmp_path: Path, number: int, begun: Begun, poses: int) -> None:
    path, out = write_csv(tmp_path / "long.csv", still_counts(directions(poses))), tmp_path / "out"
    process = begun(path, out)
    process.send_signal(number)
    out_text, err = process.communicate()
    assert process.returncode == 130, err
    assert out_text == b""
    assert err.count(b"\n") == 1
    assert b"interrupted" in err
    assert files(out) == []


def test_a_closed_pipe_is_quiet(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    process = subprocess.Popen(
        command("calibrate", path, "--model", 6), stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    process.stdout.close()
    err = process.stderr.read()
    process.stderr.close()
    process.wait()
    assert b"Traceback" not in err
    assert b"Exception" not in err


def test_a_pipe_is_called_one_and_never_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.csv")
    for path in (tmp_path / "a.csv", Path("/dev/null")):
        assert_one_line(run("inspect", path), "is a pipe or a device", "write it to a file first", code=3)


def test_a_window_of_one_sample_is_wrong_usage(tmp_path: Path) -> None:
    """It is constant whatever the device did, so it was called a sensor that was off."""
    ran = run("calibrate", good_csv(tmp_path), "--segment-seconds", "0.001")
    assert (ran.code, "--segment-seconds 0.001 is less than two samples at" in ran.err) == (2, True)
