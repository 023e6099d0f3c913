"""Studies of all formats with damaged and hopeless recordings: all others are done, however it is run."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest

from accelcal_cli.studies import executors
from tests.cli.run import Ran
from tests.cli.studies import results, rows, run_in
from tests.studies.mixture import mixture

SIZES = [pytest.param((2, 12, 6), id="20"), pytest.param((185, 10, 5), id="200", marks=pytest.mark.nightly)]
CODES = {"calibrated": "0", "refused": "4", "failed": "3"}


@dataclass(frozen=True)
class Done:
    """A study that was run with one worker, and what its folder holds."""

    folder: Path
    out: Path
    truth: dict[str, str]
    ran: Ran


@pytest.fixture(scope="module", params=SIZES)
def done(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Done:
    folder = tmp_path_factory.mktemp("mixture") / "in"
    truth = mixture(folder, *request.param)
    out = folder.parent / "out"
    return Done(folder, out, truth, study(folder, out, "--jobs", 1))


def study(folder: Path, out: Path, *words: object) -> Ran:
    """With `--strict`, since the rule of what is provisional divides nights that are too short."""
    return run_in(folder, "study", folder, "-d", out, "--strict", *words)


def test_what_can_be_calibrated_is_and_the_summary_says_what_became_of_the_rest(done: Done) -> None:
    assert done.ran.code == 1
    assert "Traceback" not in done.ran.err and "bug" not in done.ran.err
    assert {row["path"]: (row["outcome"], row["exit_code"]) for row in rows(done.out)} == {
        name: (outcome, CODES[outcome]) for name, outcome in done.truth.items()
    }
    assert len(done.ran.lines) == len(done.truth)
    counts = json.loads((done.out / "study.json").read_text())
    assert counts["recordings"] == len(done.truth)
    assert counts["outcomes"] == Counter(done.truth.values())
    assert (counts["left_out"], counts["waiting"]) == (0, 0)
    made = {name for name, outcome in done.truth.items() if outcome == "calibrated"}
    assert len(list(done.out.rglob("*.calibrated.parquet"))) == len(made)


def test_a_rerun_does_nothing_and_starts_no_worker(done: Done, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it then takes, test_many.py measures."""
    files = [path for path in done.out.rglob("*") if path.is_file() and not path.name.startswith("study.")]
    before, held = {path: path.stat().st_mtime_ns for path in files}, results(done.out)
    monkeypatch.delattr(executors, "forkserver_folder")
    again = study(done.folder, done.out)
    assert (again.code, sorted(again.lines)) == (1, sorted(done.ran.lines))
    assert f"{len(done.truth)} unchanged" in again.err
    assert {path: path.stat().st_mtime_ns for path in files} == before
    assert results(done.out) == held


@pytest.mark.nightly
def test_two_workers_give_the_same_bytes(done: Done, tmp_path: Path) -> None:
    assert study(done.folder, tmp_path / "out", "--jobs", 2).code == 1
    assert results(tmp_path / "out") == results(done.out)


@pytest.mark.nightly
def test_three_shards_give_the_same_bytes(done: Done, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for part in (3, 1, 2):
        assert study(done.folder, out, "--jobs", 2, "--shard", f"{part}/3").code in (0, 1, 3, 4)
    assert study(done.folder, out, "--collect").code == 1
    assert {name: content for name, content in results(out).items() if "-of-3" not in name} == results(
        done.out
    )
