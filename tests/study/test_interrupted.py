"""A study that is killed, interrupted, or started twice; and a worker that is killed."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests.cli.run import command, run_process
from tests.cli.studies import results, study_folder
from tests.recordings import directions, still_counts, write_raw
from tests.study.processes import begun, commands, lines, session, soon

resource = pytest.importorskip("resource")
pytestmark = pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
NAMES = tuple(f"{site}/p{number}.raw" for site in ("a", "b") for number in range(3))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return study_folder(tmp_path_factory.mktemp("study") / "in", NAMES)


@pytest.fixture(scope="module")
def undisturbed(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    out = tmp_path_factory.mktemp("undisturbed")
    assert run_process("study", folder, "-d", out, "-j", 1).code == 0
    return results(out)


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(1, 5))]
)
def test_killed_at_any_moment_a_rerun_ends_as_if_nothing_had_been(
    folder: Path, undisturbed: dict[str, object], tmp_path: Path, seed: int
) -> None:
    out = tmp_path / "out"
    process = begun(folder, out)
    soon(lambda: lines(out) > seed // 2)
    time.sleep(random.Random(seed).uniform(0, 0.1))
    process.kill()
    process.communicate()
    soon(lambda: not session(process.pid))
    done = lines(out)
    assert 0 < done < len(NAMES)
    assert (out / "study.lock").exists()
    again = run_process("study", folder, "-d", out)
    assert again.code == 0
    assert f"{done} unchanged" in again.err
    assert results(out) == undisturbed


def test_a_worker_that_is_killed_costs_its_recording_alone(folder: Path, tmp_path: Path) -> None:
    study, out = tmp_path / "in", tmp_path / "out"
    study_folder(study, NAMES[:1])
    write_raw(study / "long.raw", still_counts(directions(1200)))
    process = begun(study, out)
    temporary = soon(lambda: next(out.glob(".long.calibrated.parquet.*.tmp"), None))
    pid = int(temporary.name.split(".")[-3])
    Path(f"/proc/{pid}").stat()
    subprocess.run(["kill", "-9", str(pid)], check=True)
    _, said = process.communicate()
    assert process.returncode == 1
    assert f"{study / 'long.raw'}: its process was ended by SIGKILL" in said.decode()
    assert "2 recordings: 1 calibrated, 1 failed" in said.decode()
    assert not list(out.rglob("*.tmp"))
    again = run_process("study", study, "-d", out)
    assert again.code == 0
    assert "1 unchanged" in again.err


@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.nightly)])
def test_interrupted_it_leaves_nothing_half_written(folder: Path, tmp_path: Path, number: int) -> None:
    out = tmp_path / "out"
    process = begun(folder, out)
    soon(lambda: lines(out))
    process.send_signal(number)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 130
    assert said.decode() == "accelcal: interrupted; nothing half-written was left\n"
    soon(lambda: not session(process.pid))
    assert not [path for path in out.rglob("*") if path.suffix in (".tmp", ".lock")]


def test_interrupted_at_the_terminal_while_workers_start_it_says_so_in_one_line(
    folder: Path, tmp_path: Path
) -> None:
    """Ctrl-C reaches all processes, also the one that is still importing what workers need."""
    for attempt in range(20):
        process = begun(folder, tmp_path / str(attempt))
        early = interrupted_while_it_starts(process, tmp_path / str(attempt))
        _, said = process.communicate(timeout=30)
        if early:
            break
    assert process.returncode == 130
    assert said.decode() == "accelcal: interrupted; nothing half-written was left\n"


def interrupted_while_it_starts(process: subprocess.Popen[bytes], out: Path) -> bool:
    """Press Ctrl-C once there is a server of workers; whether no recording was done by then."""
    soon(lambda: process.poll() == 0 or any(b"forkserver" in words for words in commands(process.pid)))
    time.sleep(0.2)
    early = process.poll() is None and not lines(out)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGINT)
    return early


def test_of_two_at_once_the_second_leaves(
    folder: Path, undisturbed: dict[str, object], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    process = begun(folder, out)
    soon((out / "study.lock").exists)
    second = run_process("study", folder, "-d", out)
    assert (second.code, second.out) == (75, "")
    assert f"process {process.pid} on " in second.err
    process.communicate()
    assert process.returncode == 0
    assert results(out) == undisturbed


def test_a_disk_that_takes_no_more_costs_the_recordings_that_need_it(folder: Path, tmp_path: Path) -> None:
    study, out = tmp_path / "in", tmp_path / "out"
    study_folder(study, NAMES[:1])
    write_raw(study / "long.raw", still_counts(directions(240)))
    words, limit = command("study", study, "-d", out), 400_000
    done = subprocess.run(
        words,
        capture_output=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
        timeout=60,
        check=False,
    )
    assert done.returncode == 1
    assert b"long.calibrated.parquet: cannot be written" in done.stderr
    assert b"2 recordings: 1 calibrated, 1 failed" in done.stderr
    assert not list(out.rglob("*.tmp"))
    assert run_process("study", study, "-d", out).code == 0
