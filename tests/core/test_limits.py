"""CPUs and memory that this process was given."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from accelcal_cli.core import system


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine of 16 CPUs and 8 GB, with this process two cgroups deep and nothing limited."""
    own = tmp_path / "groups" / "batch" / "job"
    own.mkdir(parents=True)
    (tmp_path / "cgroup").write_text("0::/batch/job\n")
    (tmp_path / "meminfo").write_text("MemTotal: 16000000 kB\nMemAvailable:   8000000 kB\n")
    monkeypatch.setattr(system, "CGROUPS", tmp_path / "groups")
    monkeypatch.setattr(system, "PROCESS", tmp_path / "cgroup")
    monkeypatch.setattr(system, "MEMORY", tmp_path / "meminfo")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _process: set(range(16)), raising=False)
    monkeypatch.delenv("SLURM_CPUS_PER_TASK", raising=False)
    return own


def test_without_limits_all_cpus_are_used(machine: Path) -> None:
    (machine / "cpu.max").write_text("max 100000\n")
    (machine / "memory.max").write_text("max\n")
    (machine / "memory.current").write_text("5\n")
    assert system.cpus() == 16
    assert system.available_bytes() == 8_192_000_000
    assert system.workers(100) == 16
    assert system.workers(3) == 3


@pytest.mark.parametrize(("text", "number"), [("250000 100000", 3), ("50000 100000", 1), ("nonsense", 16)])
def test_the_quota_is_rounded_up(machine: Path, text: str, number: int) -> None:
    (machine / "cpu.max").write_text(text)
    assert system.cpus() == number


def test_the_quota_of_a_group_around_counts_too(machine: Path) -> None:
    (machine / "cpu.max").write_text("800000 100000")
    (machine.parent / "cpu.max").write_text("200000 100000")
    assert system.cpus() == 2


def test_slurm_is_heard(machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLURM_CPUS_PER_TASK", "4")
    assert system.cpus() == 4


def test_a_group_with_little_memory_left_gets_fewer_workers(machine: Path) -> None:
    (machine / "memory.max").write_text("1300000000")
    (machine / "memory.current").write_text("300000000")
    assert system.workers(100) == 3
    (machine / "memory.current").write_text("1400000000")
    assert system.workers(100) == 1


def test_a_machine_that_tells_nothing_has_its_cpus(machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "MEMORY", machine / "absent")
    monkeypatch.setattr(system, "PROCESS", machine / "absent")
    assert system.available_bytes() is None
    assert system.workers(100) == 16


@pytest.mark.parametrize(("number", "each"), [(1, 16), (5, 3), (16, 1), (40, 1)])
def test_workers_share_the_cpus(machine: Path, number: int, each: int) -> None:
    assert system.threads(number) == each
