"""`sensor = "each"`: a study makes a recording of each sensor or person of a file."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

import accelcal
from accelcal_cli.core.formats import EACH as EVERY
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.pipeline.jobs import Request
from accelcal_cli.studies.discovery import job_at
from accelcal_cli.studies.records import Item
from accelcal_cli.studies.sensors import wants_each
from tests.cli.run import Ran, report_of, run
from tests.cli.studies import results, rows
from tests.recordings import LSB_PER_G, RATE_HZ, directions, still_counts, write_csv

EACH = '["*.csv"]\nsensor = "each"\n'
SEEDS = {"A": 1, "B": 2, "C": 3}


def one_sensor(path: Path, value: str, poses: int = 30) -> Path:
    """The recording of a sensor alone."""
    return write_csv(path, still_counts(directions(poses), seed=SEEDS.get(value, 9)))


def table(path: Path, *values: str, poses: int = 30) -> Path:
    """Sensors in turn, each with its value in the last column."""
    lines = [one_sensor(path, value, poses).read_text().splitlines() for value in values]
    turns = zip(*(one[1:] for one in lines), strict=True)
    in_turn = (f"{line},{value}" for turn in turns for line, value in zip(turn, values, strict=True))
    path.write_text("\n".join([f"{lines[0][0]},sensor", *in_turn]) + "\n")
    return path


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table of two sensors, a table of one without such a column, and the study of both."""
    folder = tmp_path_factory.mktemp("each") / "in"
    folder.mkdir()
    table(folder / "table.csv", "A", "B")
    one_sensor(folder / "alone.csv", "C")
    (folder / "study.toml").write_text(EACH)
    return folder


@pytest.fixture(scope="module")
def base(made: Path) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(made.parent)
        table_of = accelcal.study("in", "out", jobs=1, progress=False)
    assert table_of["path"].tolist() == ["alone.csv", "table.csv [A]", "table.csv [B]"]
    return made.parent


@pytest.fixture
def here(base: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy, in which commands are run."""
    monkeypatch.chdir(shutil.copytree(base, tmp_path / "study"))
    return tmp_path / "study"


def study(here: Path, *words: object) -> Ran:
    return run("study", "in", "-d", "out", "-j", 1, *words)


def paths(here: Path) -> list[str]:
    return [row["path"] for row in rows(here / "out")]


def test_t1_each_sensor_of_a_table_is_a_recording(here: Path, tmp_path: Path) -> None:
    """With the coefficients of the same rows in a file of their own, to the bit."""
    sensors = {row["path"]: (row["sensor"], row["report"]) for row in rows(here / "out")}
    assert sensors == {
        "alone.csv": ("", "alone.calibration.json"),
        "table.csv [A]": ("sensor=A", "table.A.calibration.json"),
        "table.csv [B]": ("sensor=B", "table.B.calibration.json"),
    }
    for value in ("A", "B"):
        assert run("calibrate", one_sensor(tmp_path / f"{value}.csv", value)).code == 0
        alone, ours = tmp_path / f"{value}.calibration.json", here / f"out/table.{value}.calibration.json"
        assert report_of(ours)["calibration"] == report_of(alone)["calibration"]
        assert report_of(ours)["settings"]["input"]["sensor"] == f"sensor={value}"
        ran = run("verify", ours, here / "in/table.csv", "--values")
        assert (ran.code, ran.out.split("\t")[1]) == (0, "identical")
    assert report_of(here / "out/alone.calibration.json")["settings"]["input"]["sensor"] is None


def test_t1_a_rerun_does_nothing_with_and_without_the_ledger(here: Path) -> None:
    before = results(here / "out")
    assert study(here).code == 0 and results(here / "out") == before
    shown = study(here, "--dry-run")
    assert [line.split("\t")[:2] for line in shown.lines] == [
        [f"in/{name}", state]
        for name, state in (
            ("alone.csv", "calibrated"),
            ("table.csv [A]", "calibrated"),
            ("table.csv [B]", "calibrated"),
        )
    ]
    assert (study(here, "-q").out, results(here / "out")) == ("", before)
    (here / "out/study.ledger").unlink()
    (here / "out/table.B.calibration.json").unlink()  # as a killed run leaves it
    assert study(here).code == 0 and results(here / "out") == before
    assert "3 unchanged" in study(here).err


def test_t1_a_sensor_that_vanishes_is_listed_and_pruned(here: Path) -> None:
    table(here / "in/table.csv", "A", "C")
    assert study(here).code == 0 and paths(here) == ["alone.csv", "table.csv [A]", "table.csv [C]"]
    (orphan,) = json.loads((here / "out/study.json").read_text())["orphans"]
    assert (orphan["report"], orphan["code"]) == ("table.B.calibration.json", "sensor_gone")
    assert orphan["values"] == {"source": "table.csv", "sensor": "sensor=B"}
    assert study(here, "--prune").code == 0
    assert not list((here / "out").glob("table.B.*")) and len(list((here / "out").glob("table.A.*"))) == 3


def test_t1_a_renamed_table_takes_its_sensors_along(here: Path) -> None:
    assert study(here, "--force").code == 0  # the reports name the files of this folder
    (here / "in/table.csv").rename(here / "in/new.csv")
    assert study(here).code == 0
    found = {
        one["report"]: one["values"]["now"]
        for one in json.loads((here / "out/study.json").read_text())["orphans"]
    }
    assert found == {"table.A.calibration.json": "new.csv [A]", "table.B.calibration.json": "new.csv [B]"}


def test_t1_a_table_that_cannot_be_read_keeps_what_was_made_of_its_sensors(here: Path) -> None:
    text = (here / "in/table.csv").read_text()
    (here / "in/table.csv").write_text("time,x,y,z,sensor\n1,2,3,4\n")
    assert study(here, "--prune").code == 1 and paths(here) == ["alone.csv", "table.csv"]
    assert json.loads((here / "out/study.json").read_text())["orphans"] == []
    again = study(here)  # it is looked into again
    assert (
        again.code == 1
        and "2 recordings (1 unchanged): 1 calibrated, 1 failed" in again.err
        and study(here, "-q").err == ""
    )
    (here / "in/table.csv").write_text(text)
    assert study(here).code == 0 and paths(here) == ["alone.csv", "table.csv [A]", "table.csv [B]"]


def test_t1_a_copy_of_a_table_is_a_copy_of_the_same_sensor(here: Path) -> None:
    shutil.copy(here / "in/table.csv", here / "in/zcopy.csv")
    assert study(here).code == 0
    copies = {row["path"]: row["copy_of"] for row in rows(here / "out") if row["copy_of"]}
    assert copies == {"zcopy.csv [A]": "table.csv [A]", "zcopy.csv [B]": "table.csv [B]"}


def test_t1_a_sensor_that_fails_is_named(here: Path) -> None:
    for name in ("A", "B"):
        (here / f"out/table.{name}.calibration.json").write_text("not ours")
    ran = study(here, "--json")
    failed = [one["values"]["path"] for one in map(json.loads, ran.lines) if one["outcome"] == "failed"]
    assert (ran.code, sorted(failed)) == (1, ["in/table.csv [A]", "in/table.csv [B]"])
    sensors = {row["path"]: row["sensor"] for row in rows(here / "out") if row["outcome"] == "failed"}
    assert sensors == {"table.csv [A]": "sensor=A", "table.csv [B]": "sensor=B"}


def test_t1_what_is_left_for_later_keeps_the_sensors_that_it_had(here: Path) -> None:
    before = results(here / "out")
    study(here)
    table(here / "in/table.csv", "A", "B", "C")
    for words in (("--include", "alone.csv"), ("--settle", 600)):
        assert study(here, *words).code == 0
        assert [row["path"] for row in rows(here / "out")] == ["alone.csv", "table.csv [A]", "table.csv [B]"]
        assert results(here / "out").keys() == before.keys()
    assert study(here).code == 0 and "table.csv [C]" in paths(here)


def test_t1_each_by_the_command_and_one_by_name(here: Path) -> None:
    """A sensor that the command names is the only one; `each` there is for the tables that have several."""
    (here / "in/study.toml").unlink()
    assert study(here, "--sensor", "each").code == 0
    assert paths(here) == ["alone.csv", "table.csv [A]", "table.csv [B]"]
    (here / "in/alone.csv").unlink()
    (here / "in/table.toml").write_text('sensor = "each"\n')
    ran = run("study", here / "in", "-d", here / "one", "-j", 1, "--sensor", "B")
    assert ran.code == 0 and [row["path"] for row in rows(here / "one")] == ["table.csv"]
    assert report_of(here / "one/table.calibration.json")["settings"]["input"]["sensor"] == "B"
    assert run("calibrate", here / "in/table.csv", "-d", here / "x", "--sensor", "sensor=A").code == 0


@pytest.mark.parametrize("words", [("calibrate",), ("inspect",)])
def test_t1_each_outside_a_study_names_the_command(here: Path, words: tuple[str]) -> None:
    ran = run(*words, here / "in/table.csv", "--sensor", "each", code=2)
    assert f"use accelcal study {here / 'in'} -d OUT --sensor each, or name one with --sensor" in ran.err


def test_t1_names_of_outputs_are_apart_whatever_the_values_are(tmp_path: Path) -> None:
    values = ("a", "A", "left/wrist", "left wrist", "left_wrist", "ü.1", "..", "all", "each", "x" * 60)
    (tmp_path / "in").mkdir()
    table(tmp_path / "in/t.csv", *values, poses=12)
    words = ("study", tmp_path / "in", "-d", tmp_path / "out", "-j", 1, "--sensor", "each", "--report-only")
    run(*words)
    found = rows(tmp_path / "out")
    assert {row["sensor"] for row in found} == {f"sensor={value}" for value in values}
    names = [row["report"] for row in found]
    assert len({name.casefold() for name in names}) == len({row["path"] for row in found}) == len(values)
    assert {"t.A.calibration.json", "t.left_wrist.calibration.json", "t.ü.1.calibration.json"} <= {*names}
    assert all((tmp_path / "out" / name).parent == tmp_path / "out" for name in names)
    assert f"{len(values)} unchanged" in run(*words).err


def test_t1_forty_people_in_one_table(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    table(tmp_path / "in/t.csv", *(f"P{number:02d}" for number in range(40)), poses=3)
    words = ("study", tmp_path / "in", "-d", tmp_path / "out", "-j", 2, "--sensor", "each", "--report-only")
    run(*words)
    assert [row["sensor"] for row in rows(tmp_path / "out")] == [f"sensor=P{n:02d}" for n in range(40)]
    assert "40 unchanged" in run(*words).err


@pytest.mark.parametrize(("name", "read"), [("a.csv.gz", True), ("a.h5", True), ("a.cwa", False)])
def test_t1_no_sensors_are_looked_for_where_a_format_has_one(name: str, read: bool) -> None:
    item = Item(name, job_at(Path(name), Path("out/a")), ((1, 1),))
    assert wants_each(item, Request(ReadOptions(sensor=EVERY))) == read
    assert not wants_each(item, Request())


def test_t1_shards_and_the_whole_have_the_same_recordings(here: Path) -> None:
    before = results(here / "out")
    shutil.rmtree(here / "out")
    for part in ("1/2", "2/2"):
        study(here, "--shard", part)
    assert study(here, "--collect").code == 0
    shards = {name for name in results(here / "out") if "-of-2" in name}
    assert {name: one for name, one in results(here / "out").items() if name not in shards} == before


def test_t1_outputs_of_all_rows_give_way_and_those_of_one_stay(here: Path) -> None:
    shutil.rmtree(here / "out")
    for words, stays in ((("--sensor", "all"), False), (("--sensor", "A"), True)):
        run("calibrate", here / "in/table.csv", "-d", here / "out", *words)
        assert study(here, "--force").code == 0
        assert (here / "out/table.calibration.json").exists() == stays


def with_serial(path: Path, *values: str, poses: int, seed: int) -> Path:
    """An HDF5 table of sensors in turn, whose serial they share."""
    count = len(still_counts(directions(poses)))
    own = [still_counts(directions(poses), seed=seed + number) + 40 * number for number in range(len(values))]
    with h5py.File(path, "w") as file:
        xyz = np.stack(own, axis=1).reshape(-1, 3) / LSB_PER_G
        times = np.repeat(1.7e9 + 1e6 * seed + np.arange(count) / RATE_HZ, len(values))
        for name, column in (("time", times), *zip("xyz", xyz.T, strict=True)):
            file.create_dataset(name, data=column).attrs["units"] = "s" if name == "time" else "g"
        file.create_dataset("sensor", data=[*values] * count)
        file.attrs["serial"] = "X7"
    return path


def test_t1_sensors_with_the_serial_of_their_file_are_pooled_and_borrow_by_sensor(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    with_serial(tmp_path / "in/mon.h5", "A", "B", poses=60, seed=1)
    with_serial(tmp_path / "in/tue.h5", "A", "B", poses=60, seed=5)
    with_serial(tmp_path / "in/wed.h5", "B", poses=4, seed=9)
    words = ("study", tmp_path / "in", "-d", tmp_path / "out", "-j", 1, "--sensor", "each")
    run(*words, "--pool", "device")
    pools = json.loads((tmp_path / "out/study.json").read_text())["pools"]
    assert {one["device_serial"]: one["recordings"] for one in pools.values()} == {
        "X7 (sensor A)": 2,
        "X7 (sensor B)": 2,
    }
    found = {row["path"]: row["pool"] for row in rows(tmp_path / "out")}
    assert found["mon.h5 [A]"] == found["tue.h5 [A]"] != found["mon.h5 [B]"] == found["tue.h5 [B]"]
    assert "5 unchanged" in run(*words, "--pool", "device").err
    for value in ("A", "B"):
        assert run("verify", tmp_path / f"out/mon.{value}.calibration.json").code == 0
