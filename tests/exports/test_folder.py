"""A folder for another tool: which recordings, which values, gaps, zones, and what the script says."""

from __future__ import annotations

import ast
import csv
import gzip
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from accelcal_cli.exports.folder import Group
from tests.cli.run import Ran, exit_code, run
from tests.device_recordings import week
from tests.recordings import RATE_HZ, directions, still_counts

Capture = pytest.CaptureFixture[str]
RSCRIPT = shutil.which("Rscript")
NEEDS_R = pytest.mark.skipif(RSCRIPT is None, reason="Rscript is not installed")
GAP_S = 4000


def table(path: Path, *, start: str, zone: str = "", heat: bool = False, gap: bool = False) -> Path:
    """A CSV recording that can be calibrated, whose times have an offset from UTC or none."""
    xyz = still_counts(directions(60)) / 256
    seconds = np.arange(len(xyz)) / RATE_HZ
    seconds[len(xyz) // 2 :] += GAP_S * gap
    times = pd.Timestamp(start) + pd.to_timedelta(np.rint(seconds * 1e6), unit="us")
    found = pd.DataFrame({"time": times.strftime("%Y-%m-%dT%H:%M:%S.%f") + zone})
    found[list("xyz")] = xyz
    if heat:
        found["temperature"] = np.round(20 + np.arange(len(xyz)) / len(xyz), 3)
    path.parent.mkdir(parents=True, exist_ok=True)
    found.to_csv(path, index=False)
    return path


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of five: two of one name, one with a gap, one with temperature, and one that is refused."""
    here = tmp_path_factory.mktemp("study")
    table(here / "in/a/night.csv", start="2024-03-04T22:00:00", zone="+00:00", gap=True)
    table(here / "in/b/night.csv", start="2024-03-04T23:00:00")
    table(here / "in/warm.csv", start="2024-07-04T22:00:00", zone="+00:00", heat=True)
    week(here / "in/few.raw", poses=1)
    assert exit_code("study", here / "in", "-d", here / "out", "-j", 2, "-q") == 1
    return here / "out"


def rows_of(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


def exported(capsys: Capture, study: Path, tmp_path: Path, *words: object, form: str = "ggir") -> Ran:
    return run(capsys, "export", study, "--to", form, "-d", tmp_path / "to", *words)


def test_p3_usable_ones_are_exported_and_others_said(study: Path, tmp_path: Path, capsys: Capture) -> None:
    done = exported(capsys, study, tmp_path)
    assert done.code == 1
    assert sorted(Path(line).name for line in done.lines) == ["a-night.csv", "b-night.csv", "warm.csv"]
    (line,) = [line for line in done.err.splitlines() if line.endswith("; skipped")]
    assert "few.calibration.json: refused: " in line
    assert f"3 of 4 recordings exported to {tmp_path / 'to'}; next: Rscript " in done.err
    rows = rows_of(tmp_path / "to/coefficients.csv")
    assert [row["filename"] for row in rows] == ["night.csv", "warm.csv"]
    assert "not in coefficients.csv: another recording has the name night.csv" in done.err
    again = exported(capsys, study, tmp_path)
    assert again.code == 5 and "night.csv: is there already; use --force to replace it" in again.err
    assert exported(capsys, study, tmp_path, "--force", "-q").err.count("\n") == 2


def test_p3_all_ways_to_name_recordings_are_the_same(study: Path, tmp_path: Path, capsys: Capture) -> None:
    given = {
        "folder": [study],
        "summary": [study / "study.json"],
        "pattern": [f"{study}/*/*.calibration.json", f"{study}/*.calibration.json"],
        "reports": sorted(study.rglob("*.calibration.json")),
        "files": sorted(study.rglob("*.calibrated.parquet")),
        "twice": [study, study / "study.json", *study.rglob("*.calibrated.parquet")],
    }
    contents = {}
    for name, inputs in given.items():
        words = ("export", *inputs, "--to", "ggir", "-d", tmp_path / name, "-q")
        assert run(capsys, *words).code == (0 if name == "files" else 1)
        contents[name] = {
            path.relative_to(tmp_path / name).as_posix(): path.read_bytes()
            for path in (tmp_path / name).rglob("*.*")
        }
    assert len(contents["folder"]) == 5
    assert all(found == contents["folder"] for found in contents.values())


def test_p3_coefficients_are_without_the_refused(study: Path, tmp_path: Path, capsys: Capture) -> None:
    for form, lines in (("biobank", 3), ("omconvert", 3), ("json", 3)):
        done = run(capsys, "export", study, "--to", form, "-q")
        assert (done.code, len(done.lines), done.err.count("skipped")) == (1, lines, 1)
    done = run(capsys, "export", study, "--to", "ggir", "-o", tmp_path / "c.csv", "-q")
    assert done.code == 2 and "of the same name, night.csv" in done.err
    reports = [study / "warm.calibration.json", study / "few.calibration.json"]
    done = run(capsys, "export", *reports, "--to", "ggir", "-q", "-o", tmp_path / "c.csv")
    assert done.code == 1 and "few.calibration.json" in done.err
    assert [row["filename"] for row in rows_of(tmp_path / "c.csv")] == ["warm.csv"]


def test_what_ggir_gets_is_what_the_parquet_has(study: Path, tmp_path: Path, capsys: Capture) -> None:
    for words in ((), ("--gzip",)):
        exported(capsys, study, tmp_path, "--force", *words, "-j", len(words) + 1)
        for path in (tmp_path / "to").rglob("*night.csv*" if words else "*/*.csv"):
            raw = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
            found = np.genfromtxt(raw.decode().splitlines()[1:], delimiter=",")
            stem = path.name.removesuffix(".gz").removesuffix(".csv").replace("-", "/")
            ours = pq.read_table(study / f"{stem}.calibrated.parquet").to_pandas()
            us = ours["time"].dt.tz_localize(None).astype("datetime64[us]").astype(np.int64)
            assert np.array_equal(np.rint(found[:, 0] * 1e6).astype(np.int64), us)
            for number, axis in enumerate("xyz", 1):
                assert found[:, number].astype(np.float32).tobytes() == ours[axis].to_numpy().tobytes()
            if stem == "warm":
                assert found[:, 4].astype(np.float32).tobytes() == ours["temperature"].to_numpy().tobytes()
            assert (np.diff(us) > 1e6 * GAP_S).sum() == (stem == "a/night")


def test_groups_are_what_one_call_of_ggir_can_take(study: Path, tmp_path: Path, capsys: Capture) -> None:
    exported(capsys, study, tmp_path)
    folders = {path.parent.name for path in (tmp_path / "to").rglob("*/*.csv")}
    assert folders == {"25hz_8g_even_UTC", "25hz_8g_temperature_even_UTC"}
    script = (tmp_path / "to/run_ggir.R").read_text()
    assert all(f'folder = "{name}"' in script for name in folders) and "@" not in script
    group = Group(12.5, 8.0, True, True, "Europe/Berlin")
    assert group.folder == "12.5hz_8g_temperature_Europe-Berlin"
    assert "rate = 12, range = 8" in group.in_r() and "uneven = TRUE" in group.in_r()


def test_ggir_does_not_leave_out_small_tables(study: Path, tmp_path: Path, capsys: Capture) -> None:
    """By default it skips files below 2 MB, and stops at a folder that has no larger one."""
    exported(capsys, study, tmp_path)
    assert "minimumFileSizeMB = 0," in (tmp_path / "to/run_ggir.R").read_text()


@pytest.mark.parametrize(
    ("stated", "zone", "ahead_h"),
    [
        ("Europe/Berlin", "Europe/Berlin", 0),
        ("UTC", "UTC", 0),
        ("+02:00", "Etc/GMT-2", 0),
        ("-05:00", "Etc/GMT+5", 0),
        ("+05:30", "UTC", 5.5),
        (None, "UTC", 0),
    ],
)
def test_zones_have_names_that_r_knows(
    tmp_path: Path, capsys: Capture, stated: str | None, zone: str, ahead_h: float
) -> None:
    """A zone without a name is the device's clock, written as if it were UTC."""
    path = table(tmp_path / "a.csv", start="2024-03-04T10:00:00")
    words = [] if stated is None else ["--timezone", stated]
    assert run(capsys, "calibrate", path, *words, "-q").code == 0
    done = run(capsys, "export", tmp_path / "a.calibrated.parquet", "--to", "ggir", "-d", tmp_path / "to")
    (place,) = map(Path, done.lines)
    assert place.parent.name.endswith(zone.replace("/", "-"))
    assert f'zone = "{zone}"' in (tmp_path / "to/run_ggir.R").read_text()
    first = float(place.read_text().splitlines()[1].split(",")[0])
    ours = pq.read_table(tmp_path / "a.calibrated.parquet")["time"][0].as_py().replace(tzinfo=None)
    assert first == (ours - pd.Timestamp(0)).total_seconds() + 3600 * ahead_h


def test_a_folder_for_each_other_tool(study: Path, tmp_path: Path, capsys: Capture) -> None:
    names = {"biobank": "run_accprocess.sh", "actipy": "run_actipy.py", "skdh": "run_skdh.py", "csv": None}
    for form, script in names.items():
        folder = tmp_path / form
        done = run(capsys, "export", study, "--to", form, "-d", folder, "-q")
        assert done.code == 1 and len(done.lines) == 3
        found = sorted(path.name for path in folder.iterdir())
        data = sorted(name for name in found if name.endswith((".csv", ".npz")))
        extra = {"biobank": ["coefficients.txt"]}.get(form, []) + ([script] if script else [])
        assert len(data) == 3 and sorted(found) == sorted(data + extra)
        if script and script.endswith(".py"):
            text = (folder / script).read_text()
            (held,) = [node.value for node in ast.parse(text).body if isinstance(node, ast.Assign)]
            assert sorted(ast.literal_eval(held)) == data
    lines = (tmp_path / "biobank/run_accprocess.sh").read_text().splitlines()
    assert 'process ./warm.csv UTC "$@"' in lines
    assert (
        (tmp_path / "biobank/warm.csv").read_text().splitlines()[1].startswith("2024-07-04 22:00:00.000000,")
    )
    done = run(capsys, "export", study, "--to", "omconvert", "-d", tmp_path / "om")
    assert done.code == 2 and "--to omconvert writes no folder of recordings; choose one of" in done.err


def test_a_damaged_file_does_not_stop_the_others(study: Path, tmp_path: Path, capsys: Capture) -> None:
    shutil.copytree(study, tmp_path / "out")
    broken = tmp_path / "out/warm.calibrated.parquet"
    broken.write_bytes(broken.read_bytes()[:5000])
    (tmp_path / "out/a/night.calibrated.parquet").unlink()
    done = run(capsys, "export", tmp_path / "out", "--to", "ggir", "-d", tmp_path / "to")
    assert done.code == 1 and len(done.lines) == 1
    assert done.err.count("; skipped") == 3 and "1 of 4 recordings exported" in done.err
    assert "calibrate night.csv without --report-only" in done.err


def test_options_that_mean_nothing_and_empty_folders(study: Path, tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "empty").mkdir()
    for words, text in (
        ([tmp_path / "empty", "--to", "ggir", "-d", tmp_path / "x"], "holds no reports of recordings"),
        (
            [study, "--to", "ggir", "-d", tmp_path / "x", "-o", tmp_path / "y"],
            "-o names one file, and -d a folder",
        ),
        ([study, "--to", "csv", "-o", tmp_path / "y"], "several recordings need a folder"),
        ([study, "--to", "ggir", "--gzip"], "--gzip is for a folder of recordings"),
        ([f"{tmp_path}/*.no", "--to", "ggir"], "matches no report"),
    ):
        done = run(capsys, "export", *words)
        assert done.code == 2 and text in done.err and done.err.count("\n") == 1


def in_r(code: str) -> str:
    assert RSCRIPT is not None
    done = subprocess.run(
        [RSCRIPT, "--vanilla", "-e", code], check=False, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


STUB = """
library <- function(...) NULL
GGIR <- function(...) {
  a <- list(...)
  for (f in dir(a$datadir, full.names = TRUE)) {
    columns <- c(a$rmc.col.time, a$rmc.col.acc, a$rmc.col.temp)
    P <- read.csv(f, skip = a$rmc.firstrow.acc - 1, header = FALSE)[, columns]
    stopifnot(all(sapply(P, is.numeric)), a$rmc.unit.time == "UNIXsec", !a$do.cal, a$rmc.sf == 25)
    local <- format(as.POSIXct(P[1, 1], origin = "1970-01-01", tz = a$desiredtz), "%Y-%m-%dT%H:%M:%S")
    cat(basename(f), local, nrow(P), ncol(P), a$rmc.dynamic_range, a$rmc.doresample, "\\n")
    writeBin(as.numeric(as.matrix(P[, 2:4])), paste0(f, ".doubles"))
  }
}
"""


@NEEDS_R
def test_the_script_runs_in_r_and_reads_the_values(study: Path, tmp_path: Path, capsys: Capture) -> None:
    """With a stand-in for GGIR that reads tables as its read.myacc.csv does, by the arguments it is given."""
    exported(capsys, study, tmp_path)
    out = in_r(f"{STUB}\nsource({json.dumps(str(tmp_path / 'to/run_ggir.R'))}, chdir = TRUE)")
    rows = len(pq.read_table(study / "warm.calibrated.parquet"))
    assert sorted(out.splitlines()) == [
        f"a-night.csv 2024-03-04T22:00:00 {rows} 4 8 FALSE ",
        f"b-night.csv 2024-03-04T23:00:00 {rows} 4 8 FALSE ",
        f"warm.csv 2024-07-04T22:00:00 {rows} 5 8 FALSE ",
    ]
    for path in (tmp_path / "to").rglob("*.doubles"):
        stem = path.name.removesuffix(".csv.doubles").replace("-", "/")
        ours = pq.read_table(study / f"{stem}.calibrated.parquet").to_pandas()[list("xyz")].to_numpy()
        found = np.fromfile(path).reshape(3, -1).T.astype(np.float32)
        assert found.tobytes() == np.ascontiguousarray(ours).tobytes()


@NEEDS_R
def test_ggir_rescales_by_our_coefficients(study: Path, tmp_path: Path, capsys: Capture) -> None:
    """`scale(data, center = -offset, scale = 1/scale)` and the term of the temperature: R/g.getmeta.R."""
    report = study / "warm.calibration.json"
    run(capsys, "export", report, "--to", "ggir", "-q", "-o", tmp_path / "c.csv")
    points = np.random.RandomState(1).uniform(-1, 1, (50, 3))
    np.savetxt(
        tmp_path / "points.csv", np.column_stack([points, 20 + points[:, 0]]), delimiter=",", fmt="%.17g"
    )
    out = in_r(f"""
      setwd({json.dumps(str(tmp_path))}); b <- read.csv("c.csv")
      p <- as.matrix(read.csv("points.csv", header = FALSE))
      of <- function(name) as.numeric(b[1, paste0(name, c(".x", ".y", ".z"))])
      d <- scale(p[, 1:3], center = -of("offset"), scale = 1 / of("scale"))
      d <- d + scale(p[, c(4, 4, 4)], center = rep(b$meantempcal, 3), scale = 1 / of("temperature.offset"))
      cat(sprintf("%.17g", d), sep = "\\n")""")
    found = np.array([float(line) for line in out.split()]).reshape(3, -1).T
    simple = json.loads(report.read_text())["without_misalignment"]["calibration"]
    line = simple["temperature"] or {"slope_g_per_c": [0, 0, 0], "reference_c": 0.0}
    warmth = np.outer(20 + points[:, 0] - line["reference_c"], line["slope_g_per_c"])
    expected = (points + simple["offset_g"] + warmth) @ np.array(simple["gain"]).T
    assert np.abs(found - expected).max() < 1e-9


def has_ggir() -> bool:
    words = [RSCRIPT, "-e", "library(GGIR)"]
    return RSCRIPT is not None and not subprocess.run(words, check=False, capture_output=True).returncode


@pytest.mark.nightly
def test_ggir_itself_gives_the_enmo_of_the_parquet(tmp_path: Path, capsys: Capture) -> None:
    """Epochs of 5 s by GGIR, with their times in the recording's zone; GGIR rounds to 0.1 mg."""
    if not has_ggir():
        pytest.skip("the R package GGIR is not installed")
    words = ("--format", "gt3x", "--days", 0.7, "--rate", 30, "--seed", 9, "-q")
    (tmp_path / "in").mkdir()
    assert run(capsys, "simulate", tmp_path / "in/a.gt3x", *words).code == 0
    assert run(capsys, "calibrate", tmp_path / "in/a.gt3x", "--timezone", "Europe/Berlin", "-q").code == 0
    parquet = tmp_path / "in/a.calibrated.parquet"
    assert run(capsys, "export", parquet, "--to", "ggir", "-d", tmp_path / "to", "-q").code == 0
    done = subprocess.run([str(RSCRIPT), str(tmp_path / "to/run_ggir.R")], check=False, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()[-1000:]
    (made,) = (tmp_path / "to/results").rglob("meta_a.csv.RData")
    out = in_r(f"load({json.dumps(str(made))}); s <- M$metashort; cat(paste(s$timestamp, s$ENMO), sep='\\n')")
    found = pd.DataFrame([line.split() for line in out.splitlines()], columns=["time", "enmo"])
    ours = pq.read_table(parquet).to_pandas()
    enmo = np.maximum(np.sqrt(ours["x"] ** 2 + ours["y"] ** 2 + ours["z"] ** 2) - 1, 0)
    means = enmo.groupby(ours["time"].dt.floor("5s")).mean()
    times = pd.to_datetime(found["time"], utc=True)
    assert found["time"][0].endswith(("+0100", "+0200")) and len(found) > 10_000
    assert np.abs(found["enmo"].astype(float).to_numpy() - means[times].to_numpy()).max() < 6e-5
