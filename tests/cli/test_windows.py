"""`calibrate --windows`: every still window in a table, and back into `fit`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from accelcal_cli.output import windows as output
from accelcal_cli.pipeline.calibrate import OwnCalibration
from tests.cli.run import Ran, assert_one_line, exit_code, nightly, run
from tests.recordings import (
    LSB_PER_G,
    RATE_HZ,
    directions,
    good_csv,
    good_raw,
    still_counts,
    straightened,
    write_raw,
)

WINDOW = 125
"""Samples in 5 s."""


def made(path: Path, table: Path, *words: object) -> tuple[Ran, dict]:
    ran = run("calibrate", path, "--json", "-q", "--windows", table, *words)
    return ran, json.loads(ran.out) if ran.out else {}


def still(report: dict) -> int:
    """How many windows were still, by the report."""
    window_uses = ("used", "implausible", "constant_left_out", "temperature_left_out", "saturated_left_out")
    return sum(report["fit"]["windows"][fate] for fate in window_uses)


def read(path: Path) -> pd.DataFrame:
    return pd.read_csv(path) if path.suffix == ".csv" else pd.read_parquet(path)


@pytest.mark.parametrize(
    ("name", "words", "fitting"),
    [
        ("recording.bin", (), ()),
        nightly("recording.bin", ("--stillness", "adaptive"), ()),
        nightly("recording.bin", ("--latitude", 60), ("--latitude", 60)),
        nightly("recording.bin", ("--no-temperature",), ("--no-temperature",)),
        nightly("night.h5", ("--prior", "none"), ("--prior", "none")),
        nightly("evening.csv.gz", ("--segment-seconds", 10), ()),
    ],
)
@pytest.mark.parametrize("suffix", ["csv", nightly("parquet")])
def test_fit_reads_them_back_to_the_same_integers(
    tmp_path: Path, name: str, words: tuple[object, ...], fitting: tuple[object, ...], suffix: str
) -> None:
    table = tmp_path / f"all.{suffix}"
    source = Path(__file__).parents[2] / "sample_data" / name
    ran, report = made(source, table, "-d", tmp_path, "--report-only", *words)
    assert ran.code == 0, ran.err
    again = json.loads(run("fit", table, "--json", *fitting).out)
    assert again["calibration"]["fixed_point"] == report["calibration"]["fixed_point"]
    report["coverage"]["subsets_full_after_h"] = None  # a table does not say when its windows were
    for key in ("holdout", "coverage", "calibration_error_mg", "models_tried"):
        assert again[key] == report[key], key
    held = read(table)
    assert len(held) == again["recording"]["samples"] == still(report)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_the_numbers_are_those_of_the_samples(tmp_path: Path, suffix: str) -> None:
    """By hand: means, spreads, times, and |a| before and after with the report's coefficients."""
    counts = still_counts(directions(60))
    path = write_raw(tmp_path / "good.raw", counts)
    table = tmp_path / f"all.{suffix}"
    ran, report = made(path, table, "--chunk-samples", 777)
    assert ran.code == 0
    held = read(table)
    windows = counts[: len(counts) // WINDOW * WINDOW].reshape(-1, WINDOW, 3)
    assert held["first_sample"].tolist() == [WINDOW * k for k in range(len(windows))]
    assert set(held["samples"]) == {WINDOW} and set(held["counts_per_g"]) == {LSB_PER_G}
    mean_g = windows.mean(axis=1) / LSB_PER_G
    np.testing.assert_allclose(held[["x", "y", "z"]], mean_g, rtol=1e-12)
    spread_g = (windows.max(axis=1) - windows.min(axis=1)) / LSB_PER_G
    assert (held[["spread_x", "spread_y", "spread_z"]].to_numpy() == spread_g).all()
    start = pd.Timestamp("2024-03-04") + pd.to_timedelta(np.arange(len(windows)) * WINDOW / RATE_HZ, unit="s")
    assert (pd.to_datetime(held["time"]).to_numpy() == start.to_numpy("datetime64[us]")).all()
    own = report["calibration"]
    gain, offset = np.array(own["gain"]), np.array(own["offset_g"])
    np.testing.assert_allclose(held["raw_g"], np.linalg.norm(mean_g, axis=1), rtol=1e-12)
    after = np.linalg.norm((straightened(own, mean_g) + offset) @ gain.T, axis=1)
    np.testing.assert_allclose(held["calibrated_g"], after, rtol=1e-12)
    assert held["temperature_c"].isna().all()
    assert set(held["role"]) == {"fit"} and held["point"].max() + 1 == report["fit"]["points"]
    assert held["posture"].nunique() == report["fit"]["postures"]
    assert set(held["fold"]) == set(range(5))
    assert (held.groupby("posture")["fold"].nunique() == 1).all(), "no posture is split"


def test_what_is_left_out_is_there_with_the_reason(tmp_path: Path) -> None:
    counts = still_counts(directions(60))
    counts[: 2 * WINDOW] = (0, 0, 2)
    counts[750 : 750 + WINDOW] = counts[750]
    path = write_raw(tmp_path / "good.raw", counts)
    ran, report = made(path, tmp_path / "all.csv")
    assert ran.code == 0
    held = read(tmp_path / "all.csv")
    assert held["role"].iloc[:3].tolist() == ["implausible", "implausible", "fit"]
    assert held["role"].iloc[6] == "constant"
    assert held[held["role"] != "fit"][["point", "posture", "fold"]].isna().all(axis=None)
    counted = report["fit"]["windows"]
    assert (held["role"] == "fit").sum() == counted["used"]
    assert (held["role"] == "constant").sum() == counted["constant_left_out"]
    assert (held["role"] == "implausible").sum() == counted["implausible"]


def test_a_refused_recording_has_them_too(tmp_path: Path) -> None:
    path = write_raw(tmp_path / "few.raw", still_counts(directions(3)))
    ran, _ = made(path, tmp_path / "all.parquet", "--strict")
    assert ran.code == 4
    held = read(tmp_path / "all.parquet")
    assert len(held) == 18 and held["calibrated_g"].isna().all() and held["raw_g"].notna().all()


def test_profile_paper_tells_its_two_sets(tmp_path: Path) -> None:
    path = write_raw(tmp_path / "good.raw", still_counts(directions(120)))
    ran, report = made(path, tmp_path / "all.csv", "--profile", "paper")
    assert ran.code in (0, 4)
    roles = read(tmp_path / "all.csv")["role"].value_counts()
    assert roles["fit"] == 18 and roles["control"] == 18
    assert roles.sum() == still(report)


def test_times_are_utc_where_the_zone_is_known(tmp_path: Path) -> None:
    path = good_raw(tmp_path)
    for suffix in ("csv", "parquet"):
        made(
            path, tmp_path / f"all.{suffix}", "--timezone", "+02:00", "--report-only", "--model", 6, "--force"
        )
    assert read(tmp_path / "all.csv")["time"].iloc[0] == "2024-03-04T00:00:00.000000+02:00"
    assert read(tmp_path / "all.parquet")["time"].iloc[0] == pd.Timestamp("2024-03-03T22:00:00Z")


def test_of_the_same_recording_they_are_written_again(tmp_path: Path) -> None:
    path, table = good_raw(tmp_path), tmp_path / "all.csv"
    made(path, table, "--model", 6)
    first = table.read_bytes()
    table.unlink()
    ran, _ = made(path, table, "--model", 6, "--chunk-samples", 99)
    assert (ran.code, table.read_bytes() == first) == (0, True)
    assert made(path, table, "--model", 6)[0].code == 0, "one of ours is replaced"


def test_a_table_says_whose_it_is(tmp_path: Path) -> None:
    _, report = made(good_raw(tmp_path), tmp_path / "all.parquet")
    about = json.loads(pq.read_schema(tmp_path / "all.parquet").metadata[b"accelcal"])
    assert about["recording"] == report["recording"] and about["calibration"] == report["calibration"]


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("all.txt", "--windows all.txt is neither .parquet nor .csv"),
        ("-", "not written to standard output"),
        ("good.csv", "good.csv would be overwritten"),
        ("good.calibrated.parquet", "good.calibrated.parquet would be overwritten"),
        ("all.csv", "several recordings"),
    ],
)
def test_where_they_cannot_go_is_said_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, table: str, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    content = good_csv(tmp_path).read_bytes()
    paths = ["good.csv", "b.csv"][: 1 + (said == "several recordings")]
    assert_one_line(run("calibrate", *paths, "--windows", table), said, code=2)
    assert (tmp_path / "good.csv").read_bytes() == content and len(list(tmp_path.iterdir())) == 1


def test_anothers_file_is_kept_without_force(tmp_path: Path) -> None:
    path, table = good_raw(tmp_path), tmp_path / "all.csv"
    table.write_text("mine\n")
    ran, _ = made(path, table)
    assert ran.code == 5 and table.read_text() == "mine\n"
    assert_one_line(ran, "was not written by accelcal", "--force")
    assert made(path, table, "--force")[0].code == 0 and len(read(table)) > 100


@pytest.fixture(scope="module")
def windows(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The table of a good recording."""
    folder = tmp_path_factory.mktemp("windows")
    words = ("--report-only", "-q", "--windows", folder / "all.csv")
    assert exit_code("calibrate", good_raw(folder), *words) == 0
    return folder / "all.csv"


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("samples", "12.5", "line 5: has no whole number of samples"),
        ("samples", "0", "line 5: has no whole number of samples"),
        ("samples", "1000000000000", "line 5: samples is '1000000000000'"),
        ("counts_per_g", "255.0", "line 5: has no counts_per_g like that of the first row"),
        ("spread_y", "wide", "line 5: spread_y is 'wide'"),
        ("temperature_c", "warm", "line 2: temperature_c is ''"),
    ],
)
def test_a_changed_table_is_refused(
    windows: Path, tmp_path: Path, column: str, value: str, said: str
) -> None:
    held = pd.read_csv(windows, dtype=str, keep_default_na=False)
    held.loc[3, column] = value
    held.to_csv(tmp_path / "changed.csv", index=False)
    assert_one_line(run("fit", tmp_path / "changed.csv"), said, code=3)


def test_rows_may_be_taken_out(tmp_path: Path) -> None:
    made(good_raw(tmp_path), tmp_path / "all.parquet", "--report-only")
    held = read(tmp_path / "all.parquet")
    held[held["posture"] % 2 == 0].to_parquet(tmp_path / "half.parquet")
    report = json.loads(run("fit", tmp_path / "half.parquet", "--json").out)
    assert report["outcome"] == "calibrated" and report["fit"]["postures"] == 30
    held.astype(object).assign(samples=[None, *held["samples"][1:]]).to_parquet(tmp_path / "null.parquet")
    assert_one_line(run("fit", tmp_path / "null.parquet"), "null.parquet, line 1: samples is 'nan'", code=3)
    (tmp_path / "cut.parquet").write_bytes((tmp_path / "all.parquet").read_bytes()[:2000])
    assert_one_line(run("fit", tmp_path / "cut.parquet"), "cut.parquet", code=3)


def test_sums_beyond_exact_integers_are_refused(windows: Path, tmp_path: Path) -> None:
    held = read(windows).assign(counts_per_g=float(1 << 24))
    held.loc[3, "samples"] = 1 << 30
    held.to_csv(tmp_path / "changed.csv", index=False)
    assert_one_line(run("fit", tmp_path / "changed.csv"), "line 5: has no possible number of samples", code=3)


def test_a_calibrated_recording_is_no_table_of_windows(tmp_path: Path) -> None:
    run("calibrate", good_raw(tmp_path), "--model", 6)
    ran = run("fit", tmp_path / "good.calibrated.parquet")
    assert_one_line(ran, "holds a recording, not its still windows", "calibrate --windows", code=3)


def test_of_a_changing_recording_none_are_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = good_raw(tmp_path)
    plain = OwnCalibration.verdict

    def growing(*words: object) -> object:
        with path.open("ab") as file:
            file.write(bytes(6))
        return plain(*words)

    monkeypatch.setattr(OwnCalibration, "verdict", growing)
    ran, _ = made(path, tmp_path / "all.csv")
    assert ran.code == 3 and not (tmp_path / "all.csv").exists()
    assert_one_line(ran, "changed while it was read")


@pytest.mark.parametrize("number", [nightly(1), 100])
def test_the_table_does_not_depend_on_how_many_are_written_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    path, tables = good_raw(tmp_path), []
    for name, at_once in (("whole", output.WRITTEN_AT_ONCE), ("parts", number)):
        monkeypatch.setattr(output, "WRITTEN_AT_ONCE", at_once)
        for suffix in ("csv", "parquet"):
            tables.append(tmp_path / f"{name}.{suffix}")
            made(path, tables[-1], "--report-only", "--force", "--model", 6)
    assert tables[0].read_bytes() == tables[2].read_bytes()
    whole, parts = (pq.ParquetFile(table) for table in (tables[1], tables[3]))
    assert parts.read().equals(whole.read(), check_metadata=True)
    assert whole.num_row_groups == 1
    assert parts.num_row_groups == -(-whole.metadata.num_rows // number) > 1
