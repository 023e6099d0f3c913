"""Recordings that wait (`--settle`) while others of their device change: what may be half there is left."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.cli.studies import results, rows
from tests.device_recordings import rest, week, write_device
from tests.recordings import directions
from tests.studies.pooling import pool_of, study

SETTLE = ("--settle", 3600)
PARTS = {"a/one": (0, 7), "a/two": (7, 13), "b/three": (13, 19), "b/four": (19, 26)}


def settled(path: Path) -> None:
    """As if nothing had come for long."""
    os.utime(path, (1_700_000_000, 1_700_000_000))


def write(here: Path, name: str) -> None:
    """A part of what device A1 recorded."""
    values, _ = rest(directions(26), seed=3)
    first, end = PARTS[name]
    path = here / f"in/{name}.raw"
    path.parent.mkdir(parents=True, exist_ok=True)
    settled(write_device(path, values[first * 750 : end * 750]))


def outputs(here: Path, name: str) -> tuple[bytes, bytes]:
    at = here / "out" / name
    return at.with_name(f"{at.name}.calibrated.parquet").read_bytes(), at.with_name(
        f"{at.name}.calibration.json"
    ).read_bytes()


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three of four parts, pooled."""
    base = tmp_path_factory.mktemp("waiting")
    for name in list(PARTS)[:3]:
        write(base, name)
    assert study(base).code == 0
    return base


@pytest.mark.nightly
def test_a_pool_waits_for_a_member_that_is_being_copied(here: Path) -> None:
    """A new member would make another pool, but one of the old ones is half there."""
    before, made = {name: outputs(here, name) for name in list(PARTS)[:3]}, pool_of(here / "out")
    held = {row["path"]: row for row in rows(here / "out")}
    path = here / "in/a/one.raw"
    whole = path.read_bytes()
    path.write_bytes(whole[:600])
    write(here, "b/four")
    states = [line.split("\t")[1] for line in study(here, *SETTLE, "--dry-run").lines]
    assert states == ["calibrated"] * 2 + ["todo", "calibrated"]
    for unchanged in (3, 4):
        assert f"{unchanged} unchanged" in study(here, *SETTLE).err
        found = {row["path"]: row for row in rows(here / "out")}
        assert found.pop("b/four.raw")["outcome"] == "refused"
        assert found == held
        assert {name: outputs(here, name) for name in before} == before
        assert pool_of(here / "out") == made
    path.write_bytes(whole)
    settled(path)
    assert study(here, *SETTLE).code == 0
    assert len(pool_of(here / "out")["pool"]["recordings"]) == 4
    study(here, out="other")
    assert results(here / "out") == results(here / "other")


def test_without_pools_what_is_being_copied_is_not_begun(here: Path) -> None:
    """Its own result was replaced by the pool's, and to put it back it would have to be read."""
    before = outputs(here, "a/one")
    (here / "in/a/one.raw").write_bytes((here / "in/a/one.raw").read_bytes()[:600])
    for words in ((), ("--borrow",)):
        assert "1 not started" in study(here, *SETTLE, *words, pool=False).err
        assert outputs(here, "a/one") == before
        assert [row["path"] for row in rows(here / "out")] == ["a/two.raw", "b/three.raw"]


def test_a_borrower_that_is_being_copied_is_left_alone_when_a_nearer_lender_comes(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    settled(week(tmp_path / "in/far.raw", start="2024-01-01T00:00:00"))
    short = week(tmp_path / "in/short.raw", poses=3, start="2024-03-01T00:00:00")
    settled(short)
    assert study(tmp_path, "--borrow", pool=False).code == 0
    held, before = rows(tmp_path / "out")[-1], outputs(tmp_path, "short")
    assert held["borrowed_from"] == "far.raw"
    short.write_bytes(short.read_bytes()[:1200])
    settled(week(tmp_path / "in/near.raw", seed=2, start="2024-02-01T00:00:00"))
    study(tmp_path, "--borrow", *SETTLE, pool=False)
    assert rows(tmp_path / "out")[-1] == held
    assert outputs(tmp_path, "short") == before
    settled(short)
    study(tmp_path, "--borrow", *SETTLE, pool=False)
    assert rows(tmp_path / "out")[-1]["sha256"] != held["sha256"]
