"""A study that is killed again and again, at moments that chance chooses."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests.cli.run import run_process
from tests.cli.studies import results
from tests.studies.conftest import SIX
from tests.studies.processes import begun, held, session, soon

pytestmark = pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
ENDS = ("calibrated.parquet", "calibration.json")
MOMENTS = (
    "accelcal_cli.studies.run", "accelcal_cli.studies.preload", "study.parquet", "study.csv", "study.ledger",
    *(f"{name.removesuffix('raw')}{end}" for name in SIX for end in ENDS),
)  # fmt: skip
"""What is about to be imported, or to be given its name, when a study is struck."""


@pytest.mark.nightly
@pytest.mark.parametrize("times", [50])
def test_killed_again_and_again_it_ends_as_if_nothing_had_been(
    six: Path, undisturbed: dict[str, object], tmp_path: Path, temporaries: Path, times: int
) -> None:
    seed = int(os.environ.get("ACCELCAL_KILLS_SEED", time.time_ns() % 1_000_000))
    print(f"ACCELCAL_KILLS_SEED={seed}")
    chance, out = random.Random(seed), tmp_path / "out"
    for number in range(times):
        (tmp_path / str(number)).mkdir()
        said, code = struck(six, out, tmp_path / str(number), chance)
        assert code in (-signal.SIGKILL, -signal.SIGTERM, -signal.SIGINT, 0, 1, 130), said
        assert b"Traceback" not in said or code in (-signal.SIGTERM, -signal.SIGINT), said
        whole = {name: content for name, content in results(out).items() if is_output(name)}
        assert whole == {name: undisturbed[name] for name in whole}
        if chance.random() < 0.3:
            shutil.rmtree(out, ignore_errors=True)
    last = run_process("study", six, "-d", out)
    assert last.code == 0, last.err
    assert results(out) == undisturbed
    assert list(temporaries.iterdir()) == []


def struck(folder: Path, out: Path, here: Path, chance: random.Random) -> tuple[bytes, int]:
    """What a study says that is held somewhere, if it comes there, and then struck; and how it ends."""
    with held(here, chance.choice(MOMENTS)) as hold:
        process = begun(folder, out, environment=hold.environment)
        soon(lambda: process.poll() is not None or any(hold.folder.glob("[0-9]*")))
        strike(process, chance)
    _, said = process.communicate()
    soon(lambda: not session(process.pid))
    return said, process.returncode


def is_output(name: str) -> bool:
    return ".calibrat" in name and not name.endswith(".tmp")


def strike(process: subprocess.Popen[bytes], chance: random.Random) -> None:
    """Kill it, end it kindly, or kill one of the processes that it started."""
    kind = chance.choice(("kill", "kill one", signal.SIGTERM, signal.SIGINT))
    if kind == "kill":
        process.kill()
    elif kind == "kill one":
        others = sorted(set(session(process.pid)) - {str(process.pid)}, key=int)
        with contextlib.suppress(ProcessLookupError):
            os.kill(int(chance.choice([*others, process.pid])), signal.SIGKILL)
    else:
        process.send_signal(kind)
