"""Recordings in many files: the same bits as from one file, and what is missing, double or damaged."""

from __future__ import annotations

import io
import json
import random
import shutil
import tarfile
import zipfile
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import accelcal
from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import joined
from accelcal_cli.formats import open_recording
from tests.cli.run import run, run_process
from tests.cli.studies import rows, study
from tests.formats import make_cwa
from tests.formats.make_csv import read
from tests.recordings import START, directions, still_counts, write_csv

Capture = pytest.CaptureFixture[str]
SAME = (
    "outcome",
    "calibration",
    "holdout",
    "fit",
    "coverage",
    "calibration_error_mg",
    "models_tried",
    "misfits",
    "change",
)
SIMPLE: dict[str, Any] = {"model": "6"}
"""The model that is fitted soonest, where the rows matter."""

PARTS = 8
HEAD = "HEADER_TIMESTAMP,X,Y,Z\n"
NAME = "GT3XPLUS-AccelerationCalibrated-1x5x0.NEO1D26171071.{:%Y-%m-%d-%H-%M-%S}-000-P0000.sensor.csv"
PART_S = 225


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_csv(tmp_path_factory.mktemp("whole") / "whole.csv", still_counts(directions(60)))


@pytest.fixture(scope="module")
def made(whole: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "S01"
    folder.mkdir()
    lines = whole.read_text().splitlines(keepends=True)[1:]
    number = 25 * PART_S
    for part in range(-(-len(lines) // number)):
        name = NAME.format(datetime.fromisoformat(START) + timedelta(seconds=PART_S * part))
        (folder / name).write_text(HEAD + "".join(lines[number * part : number * (part + 1)]))
    (folder / "GT3XPLUS.NEO1D26171071.2024-03-04.log.csv").write_text("DAY,START,END,FLAG\n1,2,3,4\n")
    return folder


@pytest.fixture
def parts(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made, tmp_path / "S01")


@pytest.fixture(scope="module")
def expected(whole: Path) -> dict[str, Any]:
    return accelcal.calibrate(whole, report_only=True, **SIMPLE).report


def sensor_files(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.sensor.csv"))


def tarred(files: list[Path], path: Path, mode: str, **how: int) -> Path:
    with tarfile.open(path, mode, **how) as tar:
        for file in files:
            tar.add(file, f"some/folder/{file.name}")
    return path


def zipped(files: list[Path], path: Path) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in files:
            archive.write(file, f"some/folder/{file.name}")
    return path


def same(report: dict[str, Any], expected: dict[str, Any]) -> bool:
    return all(json.dumps(report[name]) == json.dumps(expected[name]) for name in SAME)


ARCHIVES: dict[str, Callable[[list[Path], Path], Path]] = {
    ".tar": lambda files, path: tarred(files, path, "w"),
    ".tar.gz": lambda files, path: tarred(files, path, "w:gz"),
    ".tar.bz2": lambda files, path: tarred(files, path, "w:bz2"),
    ".tar.xz": lambda files, path: tarred(files, path, "w:xz", preset=0),
    ".zip": zipped,
}
SOME = [
    pytest.param(suffix, marks=() if suffix in (".tar.gz", ".zip") else pytest.mark.nightly)
    for suffix in ARCHIVES
]
"""Of these whole recordings; `test_cut_anywhere_it_is_read_or_refused` reads some files of all."""


def test_a_folder_has_the_bits_of_one_table(parts: Path, expected: dict[str, Any]) -> None:
    report = accelcal.calibrate(parts, parts=True, report_only=True, **SIMPLE).report
    assert same(report, expected)
    assert report["file_health"] == expected["file_health"] | {"lost_bytes": 0}
    about = report["recording"]
    assert about["device"] == {"model": "GT3XPLUS", "serial": "NEO1D26171071", "firmware": "1.5.0"}
    assert (about["samples"], about["gaps"]) == (expected["recording"]["samples"], [])
    assert about["bytes"] == sum(one.stat().st_size for one in sensor_files(parts))


@pytest.mark.parametrize("suffix", SOME)
def test_so_has_an_archive_in_any_order(
    parts: Path, tmp_path: Path, expected: dict[str, Any], suffix: str
) -> None:
    files = sensor_files(parts)
    random.Random(1).shuffle(files)
    path = ARCHIVES[suffix]([*files, *parts.glob("*.log.csv")], tmp_path / f"S01{suffix}")
    result = accelcal.calibrate(path, report_only=True, **SIMPLE)
    assert same(result.report, expected)
    assert result.write(tmp_path / "out", force=True)[1].name == "S01.calibration.json"


def test_so_has_a_pipe_in_which_the_names_of_the_columns_stand_again(
    parts: Path, tmp_path: Path, expected: dict[str, Any]
) -> None:
    stream = b"".join(one.read_bytes() for one in sensor_files(parts))
    done = run_process(
        "calibrate", "--model", 6, "-", "--json", "--report-only", "-d", tmp_path / "out", stdin=stream
    )
    assert done.code == 0, done.err
    report = json.loads(done.out)
    assert same(report, expected)
    (told,) = report["file_health"]["problems"]
    assert (told["code"], told["count"]) == ("repeated_head", PARTS - 1)
    assert "line 5627 and 6 more lines" in told["message"]


@pytest.mark.parametrize("chunk_samples", [97, pytest.param(700, marks=pytest.mark.nightly), 10**6])
def test_the_rows_are_those_of_one_table_however_they_are_cut(
    parts: Path, whole: Path, chunk_samples: int
) -> None:
    one = read(whole)
    with open_recording(parts, ReadOptions()) as reader:
        chunks = [*reader.chunks(chunk_samples)]
    both = joined(chunks)
    assert np.array_equal(both.counts, one.counts)
    assert np.array_equal(both.time_us, one.times)
    assert len(both.breaks) == 0
    firsts = [chunk.first_sample for chunk in chunks]
    assert firsts == [sum(map(len, chunks[:number])) for number in range(len(chunks))]


def test_a_missing_part_is_a_gap_and_nothing_else(parts: Path) -> None:
    sensor_files(parts)[4].unlink()
    report = accelcal.calibrate(parts, parts=True, report_only=True, **SIMPLE).report
    (gap,) = report["recording"]["gaps"]
    assert gap["seconds"] == pytest.approx(PART_S, abs=0.05)
    (told,) = report["file_health"]["problems"]
    assert told["code"] == "clock_gap"
    assert told["message"].startswith("the time jumps ahead by 225.04 s before part GT3XPLUS")
    assert told["sample"] == 4 * 25 * PART_S


def test_a_part_that_is_there_twice_is_read_once_and_told(parts: Path, expected: dict[str, Any]) -> None:
    third = sensor_files(parts)[3]
    shutil.copy(third, parts / f"again-{third.name}")
    report = accelcal.calibrate(parts, parts=True, report_only=True, **SIMPLE).report
    assert same(report, expected)
    (told,) = report["file_health"]["problems"]
    assert told["code"] == "repeated_part"
    assert "again-GT3XPLUS" in told["message"] or "part GT3XPLUS" in told["message"]
    assert told["message"].endswith("repeats the time of parts before it: all of it left out")


def test_of_parts_that_overlap_the_later_rows_are_left_out(parts: Path, expected: dict[str, Any]) -> None:
    files = sensor_files(parts)
    text = files[5].read_text().splitlines(keepends=True)
    files[6].write_text(HEAD + "".join(text[-100:]) + files[6].read_text().removeprefix(HEAD))
    report = accelcal.calibrate(parts, parts=True, report_only=True, **SIMPLE).report
    assert same(report, expected)
    (told,) = report["file_health"]["problems"]
    assert told["code"] == "repeated_part"
    assert told["message"].endswith("100 rows left out")


def test_a_damaged_part_costs_itself(parts: Path) -> None:
    broken = sensor_files(parts)[5]
    broken.write_bytes(HEAD.encode() + b"\0\1\2 not a table\n" * 50)
    (parts / "notes.txt").write_text("recorded in spring\n")
    report = accelcal.calibrate(parts, parts=True, report_only=True, **SIMPLE).report
    codes = {one["code"]: one for one in report["file_health"]["problems"]}
    assert set(codes) <= {"unreadable_part", "clock_gap"}
    aside = [note for note in report["recording"]["notes"] if note.startswith("no recordings, set aside: ")]
    assert aside
    assert "notes.txt" in aside[0]


@pytest.mark.parametrize("suffix", SOME)
def test_an_archive_cut_short_keeps_the_parts_before(made: Path, tmp_path: Path, suffix: str) -> None:
    files = sensor_files(made)
    path = ARCHIVES[suffix](files, tmp_path / f"S01{suffix}")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 6 // 10] if suffix != ".tar.bz2" else data[: len(data) * 9 // 10])
    try:
        result = accelcal.calibrate(path, report_only=True, **SIMPLE)
    except UnreadableError as error:
        assert "damaged archive: nothing can be unpacked" in error.message
        assert suffix in (".tar.bz2", ".tar.xz"), "all of it is one block"
        return
    (told,) = [one for one in result.report["file_health"]["problems"] if one["code"] == "truncated"]
    number = next(n for n, file in enumerate(files, 1) if told["message"].endswith(file.name))
    assert result.report["recording"]["samples"] == 25 * PART_S * number
    alone = tmp_path / "alone"
    alone.mkdir()
    for file in files[:number]:
        shutil.copy(file, alone)
    assert same(result.report, accelcal.calibrate(alone, parts=True, report_only=True, **SIMPLE).report)


def test_names_longer_than_a_file_system_takes_are_shortened(made: Path, tmp_path: Path) -> None:
    path = tmp_path / "S01.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for file in sensor_files(made):
            archive.write(file, "\N{EURO SIGN}" * 120 + file.name)
    result = accelcal.calibrate(path, report_only=True, **SIMPLE)
    assert result.report["recording"]["samples"] == 25 * PART_S * PARTS


def damaged_part(path: Path, name: str) -> dict[str, Any]:
    """The report of an archive with a part that can be read, and one that cannot."""
    with zipfile.ZipFile(path, "w") as archive:
        rows = "".join(f"{second / 10},0.0,0.0,1.0\n" for second in range(1000))
        archive.writestr("whole.csv", f"time,x,y,z\n{rows}")
        archive.writestr(name, "time,x,y,z\n1,2\n")
    return accelcal.calibrate(path, parts=True, report_only=True).report


@pytest.mark.parametrize("name", ["one.csv", "sub/one.csv", "a b/left/one.csv", "/sub/one.csv", "s/0/1.csv"])
def test_an_error_names_the_member_and_not_where_it_was_unpacked(name: str, tmp_path: Path) -> None:
    path = tmp_path / "S01.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(name, b"")
    with pytest.raises(UnreadableError) as caught:
        accelcal.calibrate(path, report_only=True)
    assert str(caught.value).startswith(f"{path / name.lstrip('/')}, byte 0: the file is empty")
    report_of_one = damaged_part(tmp_path / "S02.zip", name)
    (problem,) = [one for one in report_of_one["file_health"]["problems"] if one["code"] == "unreadable_part"]
    assert f"part {name} cannot be read: " in problem["message"]


def test_parts_of_two_devices_are_no_recording(parts: Path) -> None:
    other = sensor_files(parts)[-1]
    other.rename(parts / other.name.replace("NEO1D26171071", "NEO1D26171072"))
    with pytest.raises(UsageError, match="holds parts of 2 devices \\(NEO1D26171071 and NEO1D26171072\\)"):
        accelcal.calibrate(parts, parts=True)
    pattern = parts / "*NEO1D26171071*.csv"
    report = accelcal.calibrate(pattern, parts=True, report_only=True, **SIMPLE).report
    assert report["recording"]["samples"] == 25 * PART_S * (PARTS - 1)


def test_a_part_of_another_rate_is_left_out(parts: Path) -> None:
    last = sensor_files(parts)[-1]
    lines = last.read_text().splitlines(keepends=True)
    last.write_text("".join([lines[0], *lines[1::2]]))
    report = accelcal.calibrate(parts, parts=True, report_only=True, **SIMPLE).report
    told = {one["code"]: one["message"] for one in report["file_health"]["problems"]}
    assert told["other_part"].endswith("was left out: its sampling rate is not that of the first part")


def test_files_are_named_by_a_list_or_a_pattern(
    parts: Path, capsys: Capture, expected: dict[str, Any]
) -> None:
    out, more = parts.parent / "out", ("--report-only", "--json", "--model", 6)
    listed = run(capsys, "calibrate", "--parts", *sensor_files(parts), "-d", out, *more)
    assert listed.code == 0, listed.err
    assert same(json.loads(listed.out), expected)
    assert json.loads(listed.out)["recording"]["path"].endswith(".sensor.csv")
    pattern = run(capsys, "calibrate", "--parts", parts / "*.sensor.csv", "-d", out, *more)
    assert same(json.loads(pattern.out), expected)
    some = run(capsys, "calibrate", "--parts", *sensor_files(parts)[1:4], "-d", out)
    assert (some.code, "cannot be told from other files by a pattern" in some.err) == (2, True)


def test_a_tar_is_unpacked_whatever_its_members_look_like(tmp_path: Path) -> None:
    """The blocks of a tar file begin where sectors of other formats do."""
    make_cwa.make(tmp_path, np.ones((960, 3), np.int16), 100.0, 256.0)
    (source,) = tmp_path.glob("*.cwa")
    for suffix in (".tar", ".tar.gz"):
        path = ARCHIVES[suffix]([source], tmp_path / f"one{suffix}")
        with open_recording(path, ReadOptions()) as reader, open_recording(source, ReadOptions()) as alone:
            assert reader.recording.format == "cwa"
            assert reader.recording.device == alone.recording.device
            assert sum(map(len, reader.chunks(1000))) == sum(map(len, alone.chunks(1000)))


def test_the_current_folder_may_hold_them(
    parts: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(parts)
    assert run(capsys, "calibrate", "--parts", ".", "--report-only", "--model", 6).code == 0
    assert (parts.parent / "S01.calibration.json").exists()


def test_a_folder_is_taken_for_parts_only_if_asked(parts: Path, capsys: Capture) -> None:
    done = run(capsys, "calibrate", parts)
    assert done.code == 3
    hint = f"accelcal study {parts} -d OUT; if its files are parts of one recording, add --parts"
    assert f"is a folder; to calibrate the recordings in it: {hint}\n" in done.err


def test_every_command_takes_it(parts: Path, capsys: Capture) -> None:
    out = parts.parent / "out"
    words = ("calibrate", "--parts", parts, "-d", out, "--model", 6)
    assert run(capsys, *words).code == 0
    assert "up to date" in run(capsys, *words).err
    assert f"{PARTS} parts, from GT3XPLUS" in run(capsys, "inspect", "--parts", parts).out
    report = out / "S01.calibration.json"
    assert run(capsys, "verify", report, parts, "--values").code == 0
    applied = run(capsys, "apply", "--parts", "--coefficients", report, parts, "-d", parts.parent / "applied")
    assert applied.code == 0, applied.err
    later = sensor_files(parts)[-1]
    later.write_text(later.read_text() + later.read_text().splitlines(keepends=True)[-1])
    assert run(capsys, "verify", report, parts).code == 2, "the recording changed"


def test_a_study_knows_its_sets(
    parts: Path, tmp_path: Path, capsys: Capture, expected: dict[str, Any]
) -> None:
    folder = tmp_path / "in"
    (folder / "S02").mkdir(parents=True)
    shutil.move(parts, folder / "S01")
    tarred(sensor_files(folder / "S01"), folder / "S02/S02.tar.bz2", "w:bz2")
    assert study(capsys, folder, "--model", 6).code == 0
    found = rows(tmp_path / "out")
    whole = "S01/GT3XPLUS-AccelerationCalibrated-1x5x0.NEO1D26171071.*.sensor.csv"
    assert [row["path"] for row in found] == [whole, "S02/S02.tar.bz2"]
    made = "S01/GT3XPLUS-AccelerationCalibrated-1x5x0.NEO1D26171071.sensor.calibration.json"
    assert found[0]["report"] == made
    for row in found:
        assert same(json.loads((tmp_path / "out" / row["report"]).read_text()), expected)
    assert "2 unchanged" in study(capsys, folder, "--model", 6).err
    sensor_files(folder / "S01")[-1].unlink()
    assert "1 unchanged" in study(capsys, folder, "--model", 6).err


def test_results_of_parts_are_pruned_only_once_all_parts_are_gone(
    parts: Path, tmp_path: Path, capsys: Capture
) -> None:
    folder = tmp_path / "in"
    (folder / "S02").mkdir(parents=True)
    shutil.move(parts, folder / "S01")
    tarred(sensor_files(folder / "S01"), folder / "S02/S02.tar.bz2", "w:bz2")
    assert study(capsys, folder, "--model", 6, "--report-only").code == 0
    made = tmp_path / "out/S01/GT3XPLUS-AccelerationCalibrated-1x5x0.NEO1D26171071.sensor.calibration.json"
    left_out = ("--model", 6, "--report-only", "--exclude", "*.sensor.csv", "--prune")
    for part in sensor_files(folder / "S01"):
        assert study(capsys, folder, *left_out).code == 0 and made.exists()
        part.unlink()
    assert study(capsys, folder, *left_out).code == 0 and made.exists()  # its disk may be away
    shutil.rmtree(folder / "S01")
    assert study(capsys, folder, *left_out).code == 0 and not made.exists()


def test_a_workbook_is_no_archive_of_parts(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "a.xlsx"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("[Content_Types].xml", "<Types/>")
        file.writestr("xl/workbook.xml", "<workbook/>")
    ran = run(capsys, "calibrate", path)
    assert (ran.code, ran.out) == (3, "")
    assert "save its sheet as CSV" in ran.err


def test_what_an_archive_says_of_places_is_not_believed(tmp_path: Path, made: Path) -> None:
    path = tmp_path / "S01.tar"
    with tarfile.open(path, "w") as tar:
        for number, file in enumerate(sensor_files(made)):
            data = file.read_bytes()
            info = tarfile.TarInfo(f"../../../{'../' * number}{file.name}")
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
        link = tarfile.TarInfo("link.sensor.csv")
        link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
        tar.addfile(link)
    before = sorted(tmp_path.parent.rglob("*"))
    assert accelcal.calibrate(path, report_only=True, **SIMPLE).outcome == "reduced_model"
    assert sorted(tmp_path.parent.rglob("*")) == before


def cuts(path: Path) -> Iterator[bytes]:
    data = path.read_bytes()
    for stop in range(0, len(data), max(1, len(data) // 7)):
        yield data[:stop]


@pytest.mark.parametrize("suffix", ARCHIVES)
def test_cut_anywhere_it_is_read_or_refused(made: Path, tmp_path: Path, suffix: str) -> None:
    path = ARCHIVES[suffix](sensor_files(made)[:3], tmp_path / f"S01{suffix}")
    for data in cuts(path):
        path.write_bytes(data)
        try:
            with open_recording(path, ReadOptions()) as reader:
                rows = sum(map(len, reader.chunks(10_000)))
        except UnreadableError:
            continue
        assert rows % (25 * PART_S) == 0
