"""Ten thousand recordings: what each costs that is not work."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

import pytest

from tests.cli.run import command
from tests.studies.mixture import RATES, simulated

MANY = 10_000
SECONDS_DAYS = 300 / 86_400


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same few files under many names."""
    top = tmp_path_factory.mktemp("many")
    kinds = [kind for kind in RATES if kind != "raw"]
    made = [simulated(top / "made" / kind, kind, 1, SECONDS_DAYS) for kind in kinds]
    for number in range(MANY):
        source = made[number % len(made)]
        path = top / "in" / f"site{number % 20}" / f"p{number}{''.join(source.suffixes)}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.hardlink_to(source)
    return top / "in"


def measured(*words: object) -> tuple[int, float, int]:
    """Exit code, seconds, and peak memory [bytes] of the process that plans and sums up."""
    began, most = time.monotonic(), 0
    process = subprocess.Popen(command(*words), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None:
        status = Path(f"/proc/{process.pid}/status").read_text()
        most = max([most, *(int(line.split()[1]) for line in status.splitlines() if "VmHWM" in line)])
        time.sleep(0.05)
    return process.returncode, time.monotonic() - began, 1024 * most


@pytest.mark.nightly
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
def test_planning_and_a_rerun_take_a_fifth_of_the_work_at_most(folder: Path, tmp_path: Path) -> None:
    code, planned_s, bytes_planned = measured("study", folder, "-d", tmp_path / "out", "--dry-run")
    assert code == 0
    code, worked_s, bytes_worked = measured("study", folder, "-d", tmp_path / "out", "-q")
    assert code == 1
    code, again_s, bytes_again = measured("study", folder, "-d", tmp_path / "out", "-q")
    assert code == 0, "no news"
    print(
        f"{planned_s:.1f} {worked_s:.1f} {again_s:.1f} s, {bytes_planned} {bytes_worked} {bytes_again} bytes"
    )
    assert max(planned_s, again_s) < worked_s / 5
    assert max(bytes_planned, bytes_worked, bytes_again) < 400_000_000
