"""Which part of a study a machine does."""

from __future__ import annotations

import hashlib

import pytest

from accelcal_cli.core.errors import UsageError
from accelcal_cli.studies.study import Shard, shard

NAMES = [f"site{number % 7}/p{number:03}.cwa" for number in range(400)]


@pytest.mark.parametrize("number", [1, 2, 7, 50])
def test_shards_are_disjoint_complete_and_even(number: int) -> None:
    parts = [[name for name in NAMES if Shard(index, number).owns(name)] for index in range(1, number + 1)]
    assert sorted(name for part in parts for name in part) == sorted(NAMES)
    assert max(map(len, parts)) < 2 * len(NAMES) / number + 10


def test_the_name_alone_decides() -> None:
    first = int(hashlib.sha256(b"a/b.cwa").hexdigest()[:16], 16) % 8 + 1
    assert [index for index in range(1, 9) if Shard(index, 8).owns("a/b.cwa")] == [first]


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
