"""A study on two machines with one folder: one goes down, or is only held up and comes back."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.cli.run import Ran, nightly
from tests.cli.studies import results, run_in
from tests.studies.processes import begun, held, kill, lines, soon

pytestmark = pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
STRUCK = "a/p0.calibration.json"


def here(six: Path, out: Path, *words: object) -> Ran:
    return run_in(six, "study", six, "-d", out, "-j", 2, *words)


@pytest.mark.parametrize("down", [True, nightly(False)])
def test_unlocked_the_other_does_the_rest_and_who_comes_back_stops(
    six: Path, undisturbed: dict[str, object], tmp_path: Path, down: bool
) -> None:
    out = tmp_path / "out"
    with held(tmp_path, STRUCK) as hold:
        process = begun(six, out, environment={**hold.environment, "ACCELCAL_NODE": "first"})
        hold.process()
        soon(lambda: lines(out))
        if down:
            kill(process)
        done = lines(out)
        assert list(out.glob("a/.p0.calibration.json.first*.tmp"))
        refused = here(six, out)
        assert refused.code == 75
        assert f"process {process.pid} on first" in refused.err
        assert "remove its lock with --unlock" in refused.err
        removed = here(six, out, "--unlock")
        assert (removed.code, f"removed the lock of process {process.pid}" in removed.err) == (0, True)
        taken = here(six, out)
        assert taken.code == 0, taken.err
        assert not down or f"{done} unchanged" in taken.err
        assert results(out) == undisturbed
    if not down:
        _, said = process.communicate()
        assert process.returncode == 75, said
        gone = "removed|taken over by process [0-9]+ on .*"  # as it finds it before the other ends, or after
        kept = "finished recordings are kept; run the same command again"
        text = f"study.lock: the lock of this run was ({gone}); {kept}"
        assert re.search(text, said.decode())
    assert results(out) == undisturbed
    again = here(six, out)
    assert (again.code, results(out)) == (0, undisturbed)
    assert "6 unchanged" in again.err


@pytest.mark.nightly
def test_a_part_that_went_down_hinders_nobody(
    six: Path, undisturbed: dict[str, object], tmp_path: Path
) -> None:
    """Each part, of which the first is killed at its table, and its lock removed on another machine."""
    out = tmp_path / "out"
    with held(tmp_path, "study.1-of-2.json") as hold:
        node = {**hold.environment, "ACCELCAL_NODE": "first"}
        process = begun(six, out, "--shard", "1/2", environment=node)
        hold.process()
        kill(process)
    assert here(six, out, "--shard", "2/2").code == 0
    refused = here(six, out, "--collect")
    assert (refused.code, "with --shard 1/2 --unlock" in refused.err) == (75, True)
    assert here(six, out, "--shard", "1/2", "--unlock").code == 0
    collected = here(six, out, "--collect")
    assert collected.code == 0, collected.err
    assert {name: content for name, content in results(out).items() if "-of-" not in name} == undisturbed
    requeued = here(six, out, "--shard", "1/2")
    assert requeued.code == 0, requeued.err
    assert not [name for name in results(out) if name.endswith((".lock", ".tmp"))]
