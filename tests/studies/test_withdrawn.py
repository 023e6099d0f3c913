"""Whom a person excluded lends nothing, is in no pool, and teaches nobody, unless that is asked for."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.cli.run import run
from tests.cli.studies import rows, study_in
from tests.device_recordings import rest, write_device
from tests.recordings import directions
from tests.studies.pooling import pool_of, study
from tests.studies.test_prior import prior_of, row

STARTS = {"a": "2024-03-01T00:00:00", "b": "2024-02-01T00:00:00", "c": "2024-01-01T00:00:00"}
"""Good recordings of device A1, the nearest to the short one first."""


@pytest.fixture
def here(tmp_path: Path) -> Path:
    """Three good recordings and a short one of a device in `in`."""
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    for seed, (name, start) in enumerate(STARTS.items(), start=1):
        write_device(tmp_path / f"in/{name}.raw", *rest(directions(30), seed=seed), start=start)
    values, heat = rest(directions(26), seed=9)
    write_device(tmp_path / "in/short.raw", values[: 3 * 750], heat[: 3 * 750], start="2024-03-05T00:00:00")
    return tmp_path


def exclude(here: Path, *names: str) -> None:
    text = "recording,use\n" + "".join(f"{name}.raw,no\n" for name in names)
    (here / "out/decisions.csv").write_text(text)


def lender(here: Path, *words: str) -> str:
    study(here, "--borrow", "--report-only", *words, pool=False)
    (short,) = [one for one in rows(here / "out") if one["path"] == "short.raw"]
    return short["borrowed_from"]


def members(here: Path) -> list[str]:
    return [Path(one["path"]).stem for one in pool_of(here / "out")["pool"]["recordings"]]


def test_d11_who_is_excluded_lends_nothing(here: Path) -> None:
    assert lender(here) == "a.raw"
    exclude(here, "a")
    assert (lender(here), lender(here)) == ("b.raw", "b.raw")
    assert lender(here, "--keep-teaching") == "a.raw"
    exclude(here, "a", "b", "c")
    assert lender(here) == ""
    (here / "out/decisions.csv").write_text("recording,use\na.raw,with care\n")
    assert lender(here) == "a.raw"


def test_d11_who_is_excluded_is_in_no_pool_and_gets_nothing_from_one(here: Path) -> None:
    study(here, "--report-only")
    assert members(here) == [*"abc", "short"]
    exclude(here, "a", "short")
    study(here, "--report-only")
    assert members(here) == ["b", "c"]
    assert {one["path"]: bool(one["pool"]) for one in rows(here / "out")} == {
        "a.raw": False, "b.raw": True, "c.raw": True, "short.raw": False,
    }  # fmt: skip
    study(here, "--report-only", "--keep-teaching")
    assert members(here) == ["a", "b", "c", "short"]
    (pooled,) = [one["result"] for one in rows(here / "out") if one["path"] == "short.raw"]
    for result in ("", pooled, "r0123456789"):  # of the pool, of which its own result knows nothing
        (here / "out/decisions.csv").write_text(f"recording,use,result\nshort.raw,yes,{result}\n")
        study(here, "--report-only")
        assert members(here) == ["a", "b", "c", "short"]


@pytest.mark.parametrize("silent", [["d1"], ["d1", "d4"], ["more"]])
def test_d11_who_is_excluded_teaches_nobody(silent: list[str]) -> None:
    more = {f"d{number}": row(f"D{number}", f"d{number}", 0.05) for number in range(5, 9)} | {
        "more": row("D1", "d1b", 0.2)
    }
    kept = {name: one for name, one in more.items() if name not in silent}
    found, expected = prior_of(silent=silent, **more), prior_of(without=silent, **kept)
    assert found == expected != prior_of(**more) and found is not None


@pytest.mark.parametrize("before", [True, False])
def test_d11_who_is_excluded_is_in_no_registry(before: bool, here: Path) -> None:
    """Nor stays there; the file of decisions counts as it is now."""
    study_in(here, "--report-only")
    registry = here / "registry.json"
    words = ("devices", here / "out", "--registry", registry)
    if before:
        assert run(*words).code == 0
    exclude(here, "a")
    ran = run(*words)
    assert ran.code == 0 and "2 good calibrations of 1 device" in ran.err
    assert ("1 removed, which people excluded" in ran.err) == before
    assert "1 recording excluded by people" in ran.err
    held = json.loads(registry.read_text())["devices"]["A1"]
    assert sorted(one["report"]["recording"]["path"] for one in held) == ["b.raw", "c.raw"]
    for more, counts in (((), (3, 1)), (("--keep-teaching",), (4, 0))):
        shown = json.loads(run("devices", here / "out", "--json", *more, "-q").out)
        assert (len(shown["devices"][0]["history"]), shown["excluded"]) == counts
    assert "3 good calibrations" in run(*words, "--keep-teaching").err


def test_r2_the_same_bytes_under_another_name_stay_in_the_registry(here: Path) -> None:
    for suffix in ("raw", "layout.toml"):
        shutil.copy(here / f"in/a.{suffix}", here / f"in/d.{suffix}")
    study_in(here, "--report-only")
    exclude(here, "a")
    run("devices", here / "out", "--registry", here / "registry.json", code=0)
    held = json.loads((here / "registry.json").read_text())["devices"]["A1"]
    assert sorted(one["report"]["recording"]["path"] for one in held) == ["b.raw", "c.raw", "d.raw"]
