"""The policy of time zones (docs/time.md) holds in each command that reads or writes times."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path
from zoneinfo import ZoneInfo

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import all_encoders, open_recording
from tests.cli.run import nightly, run
from tests.cli.studies import rows, study_in
from tests.device_recordings import donor, rest, week, write_device
from tests.recordings import START, directions

ZONE = "Europe/Berlin"
LOCAL = datetime.fromisoformat(START)
THERE = LOCAL.replace(tzinfo=ZoneInfo(ZONE))
GIVEN, FORCED = ("--timezone", ZONE), ("--timezone", ZONE, "-R", "force_timezone=true")

CASES = pytest.mark.parametrize(
    ("start", "words", "zone"),
    [(START, (), "unknown"), (START, GIVEN, "UTC"), (f"{START}Z", FORCED, "UTC")],
    ids=["no zone", "--timezone", "-R force_timezone"],
)
"""How a recording states its start, what the user says, and what its times then are in."""

STUDIES = pytest.mark.parametrize(
    ("start", "words", "zone"),
    [(START, GIVEN, "UTC"), nightly(START, (), "unknown"), nightly(f"{START}Z", FORCED, "UTC")],
    ids=["--timezone", "no zone", "-R force_timezone"],
)


def few(path: Path, start: str, first: int = 0, poses: int = 7) -> Path:
    """A recording of device A1 that is too short to be calibrated alone."""
    values, heat = rest(directions(26), seed=3, warm=True)
    at = slice(first * 750, (first + poses) * 750)
    return write_device(path, values[at], heat[at], start=start)


def check_times(stem: Path, zone: str) -> None:
    """What the Parquet file and the report beside it say of the first sample."""
    table = pq.read_table(stem.with_name(stem.name + ".calibrated.parquet"), columns=["time"])
    assert table.schema.metadata[b"time_zone"] == zone.encode()
    assert table.schema.field("time").type == pa.timestamp("us", None if zone == "unknown" else "UTC")
    assert table["time"][0].as_py() == (LOCAL if zone == "unknown" else THERE)
    about = json.loads(stem.with_name(stem.name + ".calibration.json").read_text())["recording"]
    assert about["time_zone"] == zone
    assert datetime.fromisoformat(about["start_time"]) == (LOCAL if zone == "unknown" else THERE)


@CASES
def test_apply(tmp_path: Path, start: str, words: tuple[str, ...], zone: str) -> None:
    path = few(tmp_path / "a.raw", start)
    run("apply", "--coefficients", donor(tmp_path, warm=True), path, *words, code=0)
    check_times(tmp_path / "a", zone)
    assert run("verify", tmp_path / "a.calibration.json", path, "--values").code == 0


def test_apply_refuses_a_zone_that_contradicts_the_file(tmp_path: Path) -> None:
    path = few(tmp_path / "a.raw", f"{START}Z")
    ran = run("apply", "--coefficients", donor(tmp_path, warm=True), path, *GIVEN, code=2)
    assert f"states its time zone, UTC, which is not {ZONE}" in ran.err
    assert not (tmp_path / "a.calibrated.parquet").exists()


@STUDIES
def test_study_with_pool(tmp_path: Path, start: str, words: tuple[str, ...], zone: str) -> None:
    names = ("one", "two", "three", "four")
    (tmp_path / "in").mkdir()
    for name, first in zip(names, (0, 7, 13, 19), strict=True):
        few(tmp_path / f"in/{name}.raw", start, first)
    ran = study_in(tmp_path, "--pool", "device", *words, jobs=1)
    assert ran.code == 0, ran.err
    assert {line["outcome"] for line in rows(tmp_path / "out")} <= {"calibrated", "reduced_model"}
    for name in names:
        check_times(tmp_path / "out" / name, zone)
    summary = json.loads((tmp_path / "out/study.json").read_text())
    assert summary["time_zones"] == {zone: len(names)}


@STUDIES
def test_study_with_borrow(tmp_path: Path, start: str, words: tuple[str, ...], zone: str) -> None:
    (tmp_path / "in").mkdir()
    week(tmp_path / "in/good.raw", warm=True, start=start)
    few(tmp_path / "in/short.raw", start)
    ran = study_in(tmp_path, "--prior", "none", "--borrow", *words, jobs=1)
    assert ran.code == 0, ran.err
    assert {line["path"]: line["outcome"] for line in rows(tmp_path / "out")}["short.raw"] == "borrowed"
    for name in ("good", "short"):
        check_times(tmp_path / "out" / name, zone)


def test_study_names_the_recordings_whose_zone_contradicts_the_users(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    few(tmp_path / "in/stated.raw", f"{START}Z")
    few(tmp_path / "in/none.raw", START)
    assert study_in(tmp_path, *GIVEN, "--pool", "device", "--borrow", jobs=1).code != 0
    told = {line["path"]: line["message"] for line in rows(tmp_path / "out")}
    assert f"states its time zone, UTC, which is not {ZONE}" in told["stated.raw"]
    assert "time zone" not in told["none.raw"]


def test_fit_has_no_times(tmp_path: Path) -> None:
    points = tmp_path / "points.csv"
    lines = ["x,y,z", *(",".join(map(repr, row)) for row in (directions(60) * 1.01).tolist())]
    points.write_text("\n".join(lines) + "\n")
    about = json.loads(run("fit", points, "--json").out)["recording"]
    assert (about["start_time"], about["timezone"], about["time_zone"]) == (None, None, None)
    assert run("fit", points, *GIVEN).code == 2


@pytest.mark.parametrize("name", sorted(encoder.name for encoder in all_encoders()))
def test_simulate_writes_a_start_that_reads_back_as_its_truth_says(tmp_path: Path, name: str) -> None:
    """In each format the same clock; where the format can say so, of no zone."""
    ran = run("simulate", tmp_path / "s", "--format", name, "--days", 0.002, "--rate", 50)
    path = Path(ran.out.split("\t")[0])
    with open_recording(path, ReadOptions()) as reader:
        about = reader.recording
    assert str(iso_time(about.start_us, None)).startswith(f"{START}.000")
    assert about.timezone is None
    with open_recording(path, ReadOptions(timezone=ZONE)) as reader:
        assert reader.recording.timezone == ZONE
