"""`--keep-refused`: raw values of what cannot be calibrated stay in a study, and say what they are."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.cli.run import run
from tests.cli.studies import results, rows, study
from tests.device_recordings import week
from tests.recordings import LSB_PER_G, directions, still_counts, write_raw


@pytest.fixture
def lazy(tmp_path: Path) -> Path:
    """A recording of one posture, beyond the range now and then."""
    counts = still_counts(np.repeat(directions(60)[:1], 60, axis=0))
    counts[100] = 2047
    (tmp_path / "in").mkdir()
    return write_raw(tmp_path / "in/lazy.raw", counts)


def kept(folder: Path) -> Path:
    return folder / "lazy.uncalibrated.parquet"


def test_values_are_the_raw_ones_and_each_row_says_so(lazy: Path, tmp_path: Path) -> None:
    done = run("calibrate", lazy, "--keep-refused", "-d", tmp_path / "out")
    assert (done.code, done.lines[0].split("\t")[1]) == (4, "refused")
    assert done.lines[0].split("\t")[6] == str(kept(tmp_path / "out"))
    table = pq.read_table(kept(tmp_path / "out"))
    counts = np.frombuffer(lazy.read_bytes(), "<i2").reshape(-1, 3)
    xyz = np.stack([table[name].to_numpy() for name in "xyz"], axis=1)
    assert np.array_equal(xyz, (counts / LSB_PER_G).astype(np.float32))
    validity = table["validity"].to_numpy()
    assert np.array_equal(np.flatnonzero(validity != 4), [100])
    assert validity[100] == 4 + 2
    assert b"plus 4: not calibrated" in table.schema.field("validity").metadata[b"unit"]
    said = json.loads(table.schema.metadata[b"accelcal"])
    report = json.loads((tmp_path / "out/lazy.calibration.json").read_text())
    assert (said["outcome"], said["calibration"], said["message"]) == ("refused", None, report["message"])
    assert not (tmp_path / "out/lazy.calibrated.parquet").exists()


def test_it_is_up_to_date_and_without_the_option_it_goes_with_its_report(lazy: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run("calibrate", lazy, "-d", out)
    assert not kept(out).exists()
    for _ in range(2):
        run("calibrate", lazy, "-d", out, "--keep-refused")
        stamp = kept(out).stat().st_mtime_ns
    run("calibrate", lazy, "-d", out, "--keep-refused")
    assert kept(out).stat().st_mtime_ns == stamp
    kept(out).write_bytes(b"mine")
    run("calibrate", lazy, "-d", out, "--keep-refused", code=5)
    assert kept(out).read_bytes() == b"mine"


def test_a_calibrated_file_takes_its_place(tmp_path: Path) -> None:
    path = tmp_path / "lazy.raw"
    write_raw(path, still_counts(np.repeat(directions(60)[:1], 60, axis=0)))
    run("calibrate", path, "--keep-refused")
    assert kept(tmp_path).exists()
    write_raw(path, still_counts(directions(60)))
    assert run("calibrate", path, "--keep-refused").code == 0
    assert not kept(tmp_path).exists()
    assert (tmp_path / "lazy.calibrated.parquet").exists()


def test_a_refused_night_stays_in_a_study(lazy: Path, tmp_path: Path) -> None:
    write_raw(lazy.with_name("good.raw"), still_counts(directions(60)))
    done = study(lazy.parent, "--keep-refused", code=1)
    found = {row["path"]: row for row in rows(tmp_path / "out")}
    assert (found["lazy.raw"]["outcome"], found["lazy.raw"]["parquet"]) == (
        "refused", "lazy.uncalibrated.parquet",
    )  # fmt: skip
    before = results(tmp_path / "out")
    assert "2 unchanged" in study(lazy.parent, "--keep-refused").err
    assert results(tmp_path / "out") == before
    assert done.lines[-1] != ""


def test_borrowed_coefficients_take_its_place_and_give_it_back(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    week(folder / "good.raw")
    week(folder / "short.raw", poses=3, seed=2)
    study(folder, "--keep-refused", "--strict")
    before = results(tmp_path / "out")
    assert "short.uncalibrated.parquet" in before
    study(folder, "--keep-refused", "--strict", "--borrow")
    assert {"short.calibrated.parquet"} <= set(results(tmp_path / "out"))
    assert "short.uncalibrated.parquet" not in results(tmp_path / "out")
    study(folder, "--keep-refused", "--strict")
    assert results(tmp_path / "out") == before


def test_it_is_not_handed_on_as_if_it_were_calibrated(lazy: Path, tmp_path: Path) -> None:
    run("calibrate", lazy, "--keep-refused", "-d", tmp_path)
    done = run("export", kept(tmp_path), "--to", "csv", "-o", tmp_path / "a.csv", code=3)
    assert "holds raw values, since its recording was refused" in done.err
    assert not list(tmp_path.glob("*.csv"))
