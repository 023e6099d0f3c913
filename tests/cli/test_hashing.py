"""The SHA-256 of a long recording, which a helper finds out beside the judgement."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.recordings import good_raw

PROGRAM = """
import os, signal, sys
from accelcal_cli.cli.main import main
from accelcal_cli.pipeline import calibrate, jobs

calibrate.HASHED_BESIDE, caller, how = 0, os.getpid(), sys.argv.pop(1)
hashing = jobs.sha256

def sha256(path):
    if path.suffix != ".raw":
        return hashing(path)
    beside = os.getpid() != caller
    if beside and how == "lost":
        os.kill(os.getpid(), signal.SIGKILL)
    if not beside or how == "helped":
        print("beside" if beside else "by the caller", file=sys.stderr, flush=True)
    if how == "gone":
        path = path.with_name("gone")
    return hashing(path)

jobs.sha256 = sha256
main()
"""


def hashed(how: str, *words: object) -> subprocess.CompletedProcess[str]:
    """The command, for which every recording is long."""
    command = [sys.executable, "-W", "error", "-c", PROGRAM, how, "calibrate", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux forks helpers")
@pytest.mark.parametrize("how, by", [("helped", "beside"), ("lost", "by the caller")])
def test_a_helper_hashes_and_if_it_is_lost_the_caller_does(tmp_path: Path, how: str, by: str) -> None:
    recording = good_raw(tmp_path)
    done = hashed(how, recording, "-q")
    assert (done.returncode, done.stderr) == (0, f"{by}\n")
    report = json.loads((tmp_path / "good.calibration.json").read_text())
    assert report["recording"]["sha256"] == hashlib.sha256(recording.read_bytes()).hexdigest()


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux forks helpers")
def test_a_recording_that_cannot_be_hashed_is_told_in_one_line(tmp_path: Path) -> None:
    recording = good_raw(tmp_path)
    done = hashed("gone", recording, "-q")
    assert done.returncode == 3
    by, line = done.stderr.splitlines()
    assert by == "by the caller" and "gone: cannot be read (No such file or directory)" in line
    assert not (tmp_path / "good.calibration.json").exists()
