"""Nothing real vanishes: each file of a study is a row, or is named with the reason why it is left out."""

from __future__ import annotations

import gzip
import json
import signal
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import open_recording
from accelcal_cli.studies import discovery
from tests.cli.run import Ran, run
from tests.cli.studies import study_folder

STAMPS = [f"2024-03-04T10:{second // 60:02d}:{second % 60:02d}" for second in range(3600)]
SAMPLES = "".join(f"{stamp},0.01,{0.5 + number % 7 / 100:.2f},0.86\n" for number, stamp in enumerate(STAMPS))
NO_VALUES = {
    text: "".join(f"{stamp},{text},{text},{text}\n" for stamp in STAMPS) for text in ("NaN", "", "NA")
}
HEAD = "time,x,y,z\n"


def rows(head: str, row: str, number: int = 60) -> str:
    return head + "\n" + "".join(row.format(i=i, stamp=STAMPS[i]) + "\n" for i in range(number))


TABLES = """
part2_summary.csv epochs
"ID","filename","calendar_date","N valid hours","ENMO_fullRecording"
"{i}","a.cwa","2024-03-04",20.{i},31.{i}
part4_nightsummary.csv epochs
"ID","night","sleeponset","wakeup","SptDuration","guider"
"{i}",1,22.{i},30.{i},8.{i},"HDCZA"
part5_daysummary.csv epochs
ID,weekday,window_number,dur_spt_sleep_min,ACC_day_mg,FRAG_mean
{i},Monday,1,400.{i},30.{i},5.{i}
metalong.csv epochs
timestamp,nonwearscore,clippingscore,lightmean,temperaturemean,EN
{stamp}+0100,0,0,12.{i},25.{i},1.0{i}
angles.csv epochs
timenum,ENMO,MAD,angle_x,angle_y,angle_z
{i},.0{i},.0{i},1.{i},2.{i},3.{i}
biobank-epoch.csv epochs
time,samples,enmoTrunc,xMean,yMean,zMean,xStd,yStd,zStd,temp
{stamp}.000+0000 [Europe/London],3000,.1,.2,.3,.4,.1,.1,.1,25.{i}
agcounts.csv epochs
timestamp,Axis1,Axis2,Axis3,Vector.Magnitude
{stamp},{i},{i},{i},{i}
diary.csv other_quantities
id,date,bed_time,sleep_onset,wake_time,nap_minutes,quality
{i},2024-03-04,22:10,22:30,06:{i:02d},{i},3
people.csv other_quantities
participant,age,weight_kg,height_cm,sex
{i},4{i},7{i}.5,17{i}.5,F
gps.csv other_quantities
time,lat,lon,altitude,speed
{stamp},51.{i},7.{i},100.{i},1.{i}
magnet.csv other_quantities
time,mag_x,mag_y,mag_z
{stamp},5{i}.5,7{i}.1,1{i}.2
"""
"""Three lines each: its name and why it is left out, its head, and its rows."""

OTHERS = {
    "notes.txt": ("no_numbers", "recorded in spring\n"),
    "picture.jpg": ("other_kind", "\xff\xd8\xff\x00\x01"),
    "scan.pdf": ("other_kind", "%PDF-1.7\n1 0 obj\n"),
    "people.xlsx": ("other_kind", "PK\x03\x04" + "\0" * 26 + "[Content_Types].xml" + "\0" * 99),
    "login.csv": ("other_kind", "<!DOCTYPE html><html><head></head></html>\n"),
    "noise.xyz": ("no_format", "\x01\x00\xfe\x00\x01"),
    "a.cwa.crdownload": ("unfinished_copy", SAMPLES),
    "b.csv.part": ("unfinished_copy", HEAD + SAMPLES),
    "c.tmp": ("unfinished_copy", HEAD + SAMPLES),
    "steps.agd": ("epochs", "SQLite format 3\0" + "\0" * 99 + "epochlength"),
    "lab.db": ("database", "SQLite format 3\0" + "\0" * 99),
}
LINES = TABLES.strip().splitlines()
OTHERS |= {
    said.split()[0]: (said.split()[1], rows(head, row))
    for said, head, row in zip(LINES[::3], LINES[1::3], LINES[2::3], strict=True)
}


STAND_FOR_ONE = {
    "a.7z": b"7z\xbc\xaf\x27\x1c\0\4" + bytes(99),
    "b.rar": b"Rar!\x1a\7\1\0" + bytes(99),
    "c.csv.lz4": b"\x04\x22\x4d\x18" + bytes(99),
    "d.csv": b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 12345\n",
    "e.csv.xz": b"\xfd7zXZ\0" + bytes(99),
}


def study(folder: Path, *words: object) -> Ran:
    return run("study", folder, "-d", folder.parent / "out", "-j", 1, "--report-only", *words)


def left_out(out: Path) -> dict[str, str]:
    found = json.loads((out / "study.json").read_text())["files_left_out"]
    assert all(one["message"] for one in found)
    return {one["path"]: one["code"] for one in found}


def test_u2_s5_what_is_left_out_is_named_by_what_it_is(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in", ("a.raw",))
    for name, (_, text) in OTHERS.items():
        (folder / name).write_bytes(text.encode("latin-1"))
    (folder / "gone.csv").write_text(HEAD + SAMPLES)
    wanted = {name: code for name, (code, _) in OTHERS.items()}
    wanted |= {"gone.csv": "excluded", "readme.txt": "no_numbers"}
    shown = study(folder, "--dry-run", "--exclude", "gone.*").err.splitlines()
    named = [line.removeprefix("accelcal: ").split(": ")[0] for line in shown if "left out" in line]
    assert sorted(named) == sorted(wanted)
    ran = study(folder, "-v", "--exclude", "gone.*")
    assert ran.code == 0, ran.err
    assert left_out(tmp_path / "out") == wanted
    assert all(f"{name}: left out: " in ran.err for name in wanted)
    again = study(folder, "--exclude", "gone.*")
    assert (again.code, left_out(tmp_path / "out")) == (0, wanted), "from the ledger"
    assert run("report", tmp_path / "out").code == 0
    page = (tmp_path / "out" / "study.html").read_text()
    assert all(name in page for name in OTHERS) and "gone.csv" not in page


@pytest.mark.parametrize("text", NO_VALUES)
def test_t2_a_table_that_begins_without_values_is_read(tmp_path: Path, text: str) -> None:
    before = NO_VALUES[text].replace("2024-03-04", "2024-03-03")
    (tmp_path / "a.csv").write_text(HEAD + before + SAMPLES)
    assert len(before) > 65_536
    with open_recording(tmp_path / "a.csv", ReadOptions()) as reader:
        assert (reader.recording.rate_hz, reader.recording.start_us) == (1.0, 1709546400_000_000)
        assert sum(len(chunk) for chunk in reader.chunks(1000)) == len(STAMPS)


@pytest.mark.parametrize("comment", ["# a line of words\n", "# 1, 2, 3\n", "\n"])
@pytest.mark.parametrize("lines", [5000, 60_000])
def test_t2_a_table_with_a_long_head_is_read(tmp_path: Path, comment: str, lines: int) -> None:
    with gzip.open(tmp_path / "a.csv.gz", "wt") as file:
        file.write(comment * lines + HEAD + SAMPLES)
    with open_recording(tmp_path / "a.csv.gz", ReadOptions()) as reader:
        assert reader.recording.start_us == 1709546400_000_000
        assert sum(len(chunk) for chunk in reader.chunks(1000)) == len(STAMPS)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be"])
@pytest.mark.parametrize("packed", [False, True])
def test_t2_utf_16_is_read(tmp_path: Path, encoding: str, packed: bool) -> None:
    mark = "\ufeff" if encoding == "utf-16-be" else ""
    data = (mark + "# M\u00fcller\r\n" + (HEAD + SAMPLES).replace("\n", "\r\n")).encode(encoding)
    path = tmp_path / ("a.csv.gz" if packed else "a.csv")
    path.write_bytes(gzip.compress(data) if packed else data)
    plain = tmp_path / "plain.csv"
    plain.write_text(HEAD + SAMPLES)
    counts = []
    for one in (path, plain):
        with open_recording(one, ReadOptions()) as reader:
            assert reader.recording.start_us == 1709546400_000_000
            counts.append([chunk.counts.tolist() for chunk in reader.chunks(100)])
    assert counts[0] == counts[1]


def test_t2_what_may_be_a_recording_is_a_row(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in", ("a.raw",))
    (folder / "empty.cwa").touch()
    (folder / "vague.csv").write_text(rows("a,b,c,d", "0.{i},0.{i},0.{i},0.{i}"))
    (folder / "channels.csv").write_text(rows("time,channel1,channel2,channel3", "{stamp},0.{i},0.{i},0.{i}"))
    (folder / "head.csv").write_text(HEAD)
    (folder / "nothing.csv").write_text(HEAD + NO_VALUES["NaN"])
    with zipfile.ZipFile(folder / "one.zip", "w") as archive:
        archive.writestr("SUB01/one.csv", HEAD + SAMPLES)
    with zipfile.ZipFile(folder / "photos.zip", "w") as archive:
        archive.writestr("photo.jpg", "x")
    assert study(folder).code == 1
    table = (tmp_path / "out" / "study.csv").read_text()
    for name in ("empty.cwa", "vague.csv", "channels.csv", "head.csv", "nothing.csv", "one.zip"):
        assert f"\n{name}," in table, name
    assert left_out(tmp_path / "out") == {
        "photos.zip": "archive_without_recordings",
        "readme.txt": "no_numbers",
    }
    assert "in its first 16 MB" in table


def test_t2_the_cases_are_rows_of_a_study(tmp_path: Path) -> None:
    cases = Path(__file__).resolve().parents[3] / "shared" / "data" / "cases"
    if not cases.is_dir():
        pytest.skip(f"no {cases}")
    (tmp_path / "in").mkdir()
    names = [next(cases.glob(f"{number}_*")).name for number in ("04", "06", "34")]
    for name in names:
        (tmp_path / "in" / name).symlink_to(cases / name)
    assert study(tmp_path / "in", "-R", "max_damage=50").code == 0
    table = (tmp_path / "out" / "study.csv").read_text()
    assert all(f"\n{name}," in table for name in names)


def test_pages_of_accelcal_are_not_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "walk.csv").write_text(HEAD + SAMPLES)
    run("calibrate", "data/walk.csv", "--html")
    assert (folder / "walk.html").is_file()
    (folder / "other.html").write_text("<!doctype html>\n<p>not of accelcal</p>\n")
    ran = run("study", "data", "-d", "out", "--dry-run", "-v")
    assert "other.html" in ran.err
    assert "walk.html" not in ran.err


def test_t7_what_stands_for_a_recording_fails_by_its_name(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in", ("a.raw",))
    (folder / "readme.txt").unlink()
    for name, data in STAND_FOR_ONE.items():
        (folder / name).write_bytes(data)
    ran = study(folder)
    assert ran.code == 1 and not left_out(tmp_path / "out")
    lines = {line.split(": ")[1].rpartition("/")[2]: line for line in ran.err.splitlines()}
    words = ("7z x ", "unrar x ", "unlz4 -k ", "git lfs pull --include ", "copy it again from its source")
    assert all(
        word in lines[name.rpartition("/")[2]] for name, word in zip(STAND_FOR_ONE, words, strict=True)
    )


def spins(*_: object) -> None:
    while True:
        pass


def fills_memory(*_: object) -> None:
    held = [bytearray(1 << 26)]
    while True:
        held.append(bytearray(len(held[-1]) * 2))


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are Linux's")
@pytest.mark.parametrize("look", [spins, fills_memory])
def test_h6_a_file_that_takes_too_much_to_look_into_is_left_to_its_worker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, look: Callable[..., None]
) -> None:
    (tmp_path / "notes.txt").write_text("recorded in spring\n")
    monkeypatch.setattr(discovery, "LONGEST_LOOK_S", 0.3)
    monkeypatch.setattr(discovery, "LARGEST_LOOK_BYTES", 1 << 28)
    item, options = discovery.files(discovery.Where((tmp_path,), tmp_path / "out"), [])[0], ReadOptions()
    why = discovery.why_left_out(item, options, asked_for=False)
    assert why is not None and why.code == "no_numbers"
    handler = signal.getsignal(signal.SIGALRM)
    monkeypatch.setattr(discovery, "probe_file", look)
    assert discovery.why_left_out(item, options, asked_for=False) is None
    assert signal.getsignal(signal.SIGALRM) is handler and signal.getitimer(signal.ITIMER_REAL)[0] == 0
