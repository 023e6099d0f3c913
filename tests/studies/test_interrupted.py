"""A study that is killed, interrupted, or started twice; and a worker that is killed."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

import pytest

from accelcal_cli.studies.records import Entry, Ledger
from tests.cli.run import command, nightly, run
from tests.cli.studies import results, run_in, study_folder
from tests.recordings import directions, still_counts, write_raw
from tests.studies.conftest import SIX
from tests.studies.processes import begun, held, kill, lines, session, soon

resource = pytest.importorskip("resource")
pytestmark = pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
MOMENTS = (
    "b/p0.calibrated.parquet", "a/p1.calibration.json", "b/p1.calibrated.parquet", "b/p2.calibration.json"
)  # fmt: skip
"""Files that are never given their names in a study that is killed."""


@pytest.mark.parametrize("last", ["a/p0.calibration.json", *(nightly(name) for name in MOMENTS)])
def test_killed_at_any_moment_a_rerun_ends_as_if_nothing_had_been(
    six: Path, undisturbed: dict[str, object], tmp_path: Path, last: str
) -> None:
    out = tmp_path / "out"
    with held(tmp_path, last) as hold:
        process = begun(six, out, environment=hold.environment)
        hold.process()
        soon(lambda: lines(out))
        kill(process)
    done = lines(out)
    assert 0 < done < len(SIX)
    assert (out / "study.lock").exists()
    again = run_in(tmp_path, "study", six, "-d", out)
    assert again.code == 0
    assert f"{done} unchanged" in again.err
    assert results(out) == undisturbed


@pytest.mark.nightly
def test_a_worker_that_is_killed_costs_its_recording_alone(six: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with held(tmp_path, "b/p2.calibrated.parquet") as hold:
        process = begun(six, out, environment=hold.environment)
        worker = hold.process()
        assert list(out.glob(f"b/.p2.calibrated.parquet.*.{worker}.*.tmp"))
        os.kill(worker, signal.SIGKILL)
        _, said = process.communicate()
    assert process.returncode == 1
    assert f"{six / 'b/p2.raw'}: its process was ended by SIGKILL" in said.decode()
    assert "6 recordings: 5 calibrated, 1 failed" in said.decode()
    assert not list(out.rglob("*.tmp"))
    again = run_in(tmp_path, "study", six, "-d", out)
    assert again.code == 0
    assert "5 unchanged" in again.err


@pytest.mark.parametrize("number", [signal.SIGTERM, nightly(signal.SIGINT)])
def test_interrupted_it_leaves_nothing_half_written(six: Path, tmp_path: Path, number: int) -> None:
    out = tmp_path / "out"
    with held(tmp_path, "a/p0.calibrated.parquet") as hold:
        process = begun(six, out, environment=hold.environment)
        hold.process()
        soon(lambda: lines(out))
        process.send_signal(number)
        _, said = process.communicate()
    assert process.returncode == 130
    known = len((out / "study.csv").read_text().splitlines()) - 1
    assert 1 <= known <= 12, "the table is that of what is done"
    assert said.decode() == (
        f"accelcal: interrupted; no incomplete output was left behind; {known} recordings done; "
        "the same command does the rest\n"
    )
    soon(lambda: not session(process.pid))
    assert not [path for path in out.rglob("*") if path.suffix in (".tmp", ".lock")]


@pytest.mark.nightly
def test_interrupted_while_workers_start_it_says_so_in_one_line(six: Path, tmp_path: Path) -> None:
    """Ctrl-C reaches all processes, also the one that is still importing what workers need."""
    with held(tmp_path, "accelcal_cli.studies.preload") as hold:
        process = begun(six, tmp_path / "out", environment=hold.environment)
        assert hold.process() != process.pid
        os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate()
    assert process.returncode == 130
    left = "no incomplete output was left behind"
    assert said.decode() == (
        f"accelcal: interrupted; {left}; 0 recordings done; the same command does the rest\n"
    )
    soon(lambda: not session(process.pid))


def test_interrupted_it_counts_what_the_table_has_although_a_later_round_is_to_come(
    six: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is reported of a recording that may borrow until all others are done."""
    out, add = tmp_path / "out", Ledger.add
    seen: list[Entry] = []

    def interrupted(self: Ledger, entry: Entry) -> None:
        seen.append(entry)
        if len(seen) > 3:
            raise KeyboardInterrupt
        add(self, entry)

    monkeypatch.setattr(Ledger, "add", interrupted)
    ran = run("study", six, "-d", out, "-j", 1, "--borrow")
    assert ran.code == 130 and "; 3 recordings done; " in ran.err
    assert len((out / "study.csv").read_text().splitlines()) == 3 + 1


def test_of_two_at_once_the_second_leaves(six: Path, undisturbed: dict[str, object], tmp_path: Path) -> None:
    out = tmp_path / "out"
    with held(tmp_path, "a/p0.calibrated.parquet") as hold:
        process = begun(six, out, environment=hold.environment)
        hold.process()
        second = run_in(tmp_path, "study", six, "-d", out)
    assert (second.code, second.out) == (75, "")
    assert f"process {process.pid} on " in second.err
    process.communicate()
    assert process.returncode == 0
    assert results(out) == undisturbed


@pytest.mark.nightly
def test_a_disk_that_takes_no_more_costs_the_recordings_that_need_it(six: Path, tmp_path: Path) -> None:
    study, out = tmp_path / "in", tmp_path / "out"
    study_folder(study, SIX[:1])
    write_raw(study / "long.raw", still_counts(directions(240)))
    words, limit = command("study", study, "-d", out), 400_000
    done = subprocess.run(
        words,
        capture_output=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
        check=False,
    )
    assert done.returncode == 1
    assert b"long.calibrated.parquet: cannot be written" in done.stderr
    assert b"2 recordings: 1 calibrated, 1 failed" in done.stderr
    assert not list(out.rglob("*.tmp"))
    assert run_in(tmp_path, "study", study, "-d", out).code == 0
