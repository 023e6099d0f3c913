"""Which part of a study a machine does."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.core.errors import Reason, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.pipeline.jobs import Request
from accelcal_cli.studies import rounds as planning
from accelcal_cli.studies.discovery import Where
from accelcal_cli.studies.records import Item
from accelcal_cli.studies.rounds import Plan, ledger_of, plan
from accelcal_cli.studies.study import Shard, Study, shard
from tests.cli.studies import run_in, study_folder

NAMES = [f"site{number % 7}/p{number:03}.cwa" for number in range(400)]


@pytest.mark.parametrize("number", [1, 2, 7, 50])
def test_shards_are_disjoint_complete_and_even(number: int) -> None:
    parts = [[name for name in NAMES if Shard(index, number).owns(name)] for index in range(1, number + 1)]
    assert sorted(name for part in parts for name in part) == sorted(NAMES)
    assert max(map(len, parts)) < 2 * len(NAMES) / number + 10


def test_the_name_alone_decides() -> None:
    first = int(hashlib.sha256(b"a/b.cwa").hexdigest()[:16], 16) % 8 + 1
    assert [index for index in range(1, 9) if Shard(index, 8).owns("a/b.cwa")] == [first]


def test_sensors_belong_to_the_shard_of_their_file_whatever_their_folder_is_called() -> None:
    files = [f"cohort [left]/p{number}.csv" for number in range(40)]
    owned = [name for name in files if Shard(1, 2).owns(name)]
    assert 0 < len(owned) < len(files)
    for name in (*files, "a [1].csv"):
        for sensor in ("A", "left [1]", "a_b"):
            assert Shard(1, 2).owns(f"{name} [{sensor}]") == Shard(1, 2).owns(name)


def test_names() -> None:
    assert shard(None) == Shard() and shard(None).basename == "study"
    assert shard("2/8") == Shard(2, 8)
    assert shard("2/8").basename == "study.2-of-8"


@pytest.mark.parametrize("text", ["0/8", "9/8", "2", "2/", "-1/8", "a/b", "1/0", ""])
def test_what_is_no_part_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="is not a part such as 2/8"):
        shard(text)


def slurm(task: int, least: int, count: int) -> dict[str, str]:
    return {
        "SLURM_ARRAY_TASK_ID": str(task),
        "SLURM_ARRAY_TASK_MIN": str(least),
        "SLURM_ARRAY_TASK_COUNT": str(count),
    }


def test_a_job_array_gives_the_part() -> None:
    assert [shard("slurm", slurm(task, 0, 3)) for task in range(3)] == [Shard(n, 3) for n in (1, 2, 3)]
    assert shard("slurm", slurm(8, 5, 4)) == Shard(4, 4)


@pytest.mark.parametrize("environment", [{}, slurm(9, 1, 4), {"SLURM_ARRAY_TASK_ID": "1"}])
def test_what_is_no_such_array_is_refused(environment: dict[str, str]) -> None:
    with pytest.raises(UsageError, match="--shard slurm"):
        shard("slurm", environment)


def planned(folder: Path, part: str, **options: Any) -> Plan:
    request = Request(options=ReadOptions(**options), several=True)
    study = Study(Where((folder,), folder / "out"), request, shard=shard(part))
    return plan(study, ledger_of(study))


def test_a_shard_looks_at_its_own_files_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And at those that would have the same outputs: each look takes its time where the disk is far away."""
    names = [f"{letter}.raw" for letter in "abcdefgh"]
    folder, looked_at = study_folder(tmp_path / "in", tuple(names)), []
    (folder / "a.bin").write_bytes(b"no recording")
    real = planning.why_left_out

    def looks(item: Item, *more: Any, **named: Any) -> Reason | None:
        looked_at.append(item.name)
        return real(item, *more, **named)

    monkeypatch.setattr(planning, "why_left_out", looks)
    for index in (1, 2, 3):
        looked_at.clear()
        own = {name for name in (*names, "a.bin", "readme.txt") if Shard(index, 3).owns(name)}
        both = {"a.raw", "a.bin"}
        found = planned(folder, f"{index}/3")
        assert set(looked_at) == own | (both if own & both else set())
        recordings = [*found.todo, *(item for item, _ in found.done)]
        assert {item.name for item in recordings} == own - {"readme.txt"}
        assert [entry.name for entry in found.left_out] == [name for name in own if name == "readme.txt"]


def test_an_option_may_mean_something_for_others_recordings(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in", ("a.raw", "b.raw"))
    (folder / "c.csv").write_text("x,y,z\n" + "1,0,0\n" * 100)
    for index in range(1, 10):
        planned(folder, f"{index}/9", unit="g")
    (folder / "c.csv").unlink()
    with pytest.raises(UsageError, match="unit"):
        planned(folder, "1/9", unit="g")


def test_a_shard_may_have_nothing_to_do_but_the_study_not(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in", ("a.raw",))
    parts = [planned(folder, f"{index}/5") for index in range(1, 6)]
    assert sorted(len(part.todo) for part in parts) == [0, 0, 0, 0, 1]
    (folder / "a.raw").unlink()
    with pytest.raises(UsageError, match="no recording was found"):
        planned(folder, "1/5")


def test_a_shard_keeps_no_entries_of_others_in_memory(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in", ("a.raw", "b.raw")), tmp_path / "out"
    assert run_in(tmp_path, "study", folder, "-d", out, "--report-only").code == 0
    study = Study(Where((folder,), out), Request(report_only=True), shard=shard("1/2"))
    whole, part = ledger_of(replace(study, shard=Shard())), ledger_of(study)
    for name in ("a.raw", "b.raw"):
        assert [entry.asked for entry in whole.entries(name)] == [study.asked()]
        assert bool(part.entries(name)) == study.shard.owns(name)
