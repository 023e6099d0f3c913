"""`accelcal study --borrow`: whose coefficients a recording gets, tested on its own stillness."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.cli.run import Ran, run
from tests.cli.studies import results, rows, run_in
from tests.studies.borrowing import DAY, TWENTY_MINUTES, own_errors_mg, record, report

AT = "2024-03-16T09:00:00"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three good recordings of device D7, and short ones: of D7, of another, of none, two falsely of D7."""
    folder = tmp_path_factory.mktemp("borrow") / "in"
    for name, seed, start in (("far", 1, "2024-02-01"), ("near", 2, "2024-03-12"), ("late", 3, "2024-03-25")):
        record(folder / f"good/{name}.raw", days=DAY, seed=seed, start=f"{start}T00:00:00")
    for name, seed, said in (
        ("short", 11, {}),
        ("other", 14, {"serial": "E8"}),
        ("none", 12, {"serial": ""}),
        ("perfect", 15, {"errors": 0.0}),
        ("swapped", 15, {"device": 9}),
    ):
        record(folder / f"{name}.raw", days=TWENTY_MINUTES, seed=seed, start=AT, **said)
    return folder


@pytest.fixture(scope="module")
def out(folder: Path) -> Path:
    out = folder.parent / "out"
    assert run_in(folder, "study", folder, "-d", out, "-j", 1, "--prior", "none", "--borrow").code == 1
    return out


@pytest.fixture(scope="module")
def plain(folder: Path) -> Path:
    out = folder.parent / "plain"
    assert run_in(folder, "study", folder, "-d", out, "-j", 2, "--prior", "none").code == 1
    return out


def line(out: Path, name: str) -> dict[str, str]:
    return next(row for row in rows(out) if row["path"] == name)


def study(folder: Path, out: Path, *words: object) -> Ran:
    return run("study", folder, "-d", out, "-j", 2, "--prior", "none", *words)


def test_the_nearest_one_lends_and_the_error_is_that_of_ones_own_windows(folder: Path, out: Path) -> None:
    found, lent = report(out, "short"), report(out, "good/near")
    assert found["outcome"] == "borrowed"
    assert found["calibration"] == lent["calibration"]
    before, after, postures = own_errors_mg(folder / "short.raw", lent["calibration"])
    assert found["holdout"]["before_mg"]["mean"] == pytest.approx(before, abs=1e-4)
    assert found["holdout"]["after_mg"]["mean"] == pytest.approx(after, abs=1e-4)
    assert found["holdout"]["postures"] == postures
    assert after < 1 < before
    used = found["coefficients"]
    assert used["recording_sha256"] == lent["recording"]["sha256"]
    assert used["path"] == "good/near.calibration.json"
    row = line(out, "short.raw")
    assert (row["outcome"], row["exit_code"], row["borrowed_from"]) == ("borrowed", "0", "good/near.raw")
    assert (row["own_outcome"], row["own_after_mg"]) == ("refused", "")
    assert row["own_message"].startswith("The device was still in only ")
    assert row["parquet"] == "short.calibrated.parquet" and (out / row["parquet"]).exists()


def test_it_is_what_apply_makes_of_it_and_can_be_verified(folder: Path, out: Path, tmp_path: Path) -> None:
    lent = out / "good/near.calibration.json"
    assert run("apply", "--coefficients", lent, folder / "short.raw", "-d", tmp_path).code == 0
    made, found = report(tmp_path, "short"), report(out, "short")
    apart = {name for name in found if made[name] != found[name]}
    assert apart == {"coefficients", "provenance"}
    again = run("verify", "--values", out / "short.calibration.json", folder / "short.raw")
    assert (again.code, again.lines[0].split("\t")[1]) == (0, "identical")


def test_another_device_or_an_unknown_one_lends_nothing(out: Path, plain: Path) -> None:
    for name in ("other", "none"):
        assert report(out, name)["outcome"] == "refused"
        assert line(out, f"{name}.raw") == line(plain, f"{name}.raw")


@pytest.mark.parametrize(
    ("name", "why"), [("perfect", "which is not less"), ("swapped", "the limit is 10 mg")]
)
def test_coefficients_that_make_it_worse_are_refused_and_the_own_result_stays(
    folder: Path, out: Path, plain: Path, name: str, why: str
) -> None:
    own, path = report(plain, name), folder / f"{name}.raw"
    assert {**report(out, name), "provenance": 0} == {**own, "provenance": 0}
    row = line(out, path.name)
    assert (row["outcome"], row["borrowed_from"], row["exit_code"]) == ("refused", "", "4")
    assert row["cautions"].split()[-1] == "borrowed_nothing"
    said = row["message"].removeprefix(own["message"] + " Borrowed nothing: w").split(" W")
    for lender, part in zip(("near", "late", "far"), said, strict=True):
        before, after, postures = own_errors_mg(path, report(out, f"good/{lender}")["calibration"])
        assert after > 10
        start = f"ith the coefficients of {lender}.raw: "
        assert part.startswith(start) and part.endswith(f"{why}.")
        told = re.match(r"([\d.]+) mg become ([\d.]+) mg in (\d+) orientations", part.removeprefix(start))
        assert told is not None
        assert [float(one) for one in told.groups()] == pytest.approx([before, after, postures], abs=0.06)


def test_the_table_says_so_and_a_rerun_does_nothing(folder: Path, out: Path) -> None:
    counts = json.loads((out / "study.json").read_text())
    assert counts["outcomes"] == {"borrowed": 1, "calibrated": 3, "refused": 4}
    assert counts["settings"]["borrow"] is True
    held = {path: path.stat().st_mtime_ns for path in out.rglob("*.cal*")}
    again = study(folder, out, "--borrow")
    assert "8 unchanged" in again.err
    assert len(again.lines) == 8
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*.cal*")} == held
    states = {row.split("\t")[1] for row in study(folder, out, "--borrow", "--dry-run").lines}
    assert states == {"borrowed", "calibrated", "refused"}


def test_without_borrowing_it_goes_back_and_forth(folder: Path, out: Path, plain: Path) -> None:
    held = results(out)
    assert "7 unchanged" in study(folder, out).err
    assert results(out) == results(plain)
    assert "5 unchanged" in study(folder, out, "--borrow").err
    assert results(out) == held


@pytest.mark.nightly
def test_shards_do_their_own_part_and_collected_they_borrow(folder: Path, out: Path, tmp_path: Path) -> None:
    parts = tmp_path / "parts"
    for number in (2, 1):
        assert "borrowed" not in study(folder, parts, "--shard", f"{number}/2", "--borrow").out
    assert "5 unchanged" in study(folder, parts, "--collect", "--borrow").err
    whole = {name: held for name, held in results(parts).items() if "-of-" not in name}
    assert whole == results(out)
    for number in (1, 2):
        owned = len(rows(parts, f"study.{number}-of-2"))
        words = ("--shard", f"{number}/2", "--borrow")
        assert f"{owned} unchanged" in study(folder, parts, *words).err
    assert "8 unchanged" in study(folder, parts, "--collect", "--borrow").err
