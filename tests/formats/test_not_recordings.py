"""Files that are no recordings: each is told for what it is, with what to give instead."""

from __future__ import annotations

import gzip
import shutil
import subprocess
from pathlib import Path

import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import find_format, open_recording

EPOCHS = {
    "fitbit.json": '[{\n  "dateTime" : "06/24/95 16:00:00",\n  "value" : "0"\n},{\n',
    "watch.mtn": '\ufeff<?xml version="1.0" encoding="UTF-8"?><motionfile><log2 major="2" minor="1">\r\n',
    "motionware.csv": "MotionWatch 8 data\nDate,Time,Activity\n01/02/2020,00:00:00,4\n",
    "actiware.csv": '\ufeff"Actiware Export File  (Version 05.00 )"\r\n"Filename:",""\r\n',
    "dutch.csv": "\ufeffActiware-exportbestand (versie 05.00),,,\nBestandsnaam:,C:\\a.csv,,\n",
    "watch.AWD": "NAME\n01-Jan-2018\n08:30\n4\n0\nV00000\nF\n0\n0\n",
    "old.AWD": "tempdemo\r\n30-Jan-2001\r\n18:11:00 \r\n 4 \r\n00\r\nT4460210140\r\n",
    "actical.csv": "Actical List Export File  (Version 03.00),,,\nFilename:,,,\n",
    "trust.txt": "+---+ Condor Instruments Report +---+\r\nSOFTWARE_VERSION : 1.0.13\r\n",
    "daqtix.csv": "Start: 2000-01-27 19:00:00 GMT\nStore rate:,1,1\nBinning mode:,Sum,Average\n",
    "mesa.csv": "mesaid,line,linetime,offwrist,activity,marker\n1,1,00:00:00,1,3,0\n",
    "biobank.csv": "time,acc,light,moderate-vigorous,sedentary\n2014-05-07 13:29:50+0100,63.1,0.0,0.0,1.0\n",
    "tal.txt": "Data; Hora; Evento; Luminosidade; Atividade\n2000/1/1; 00:00:00; 1; 0; 0;\n",
    "fitabase.csv": "Id,ActivityMinute,Steps\n1,4/12/2016 12:00:00 AM,0\n2,4/12/2016 12:01:00 AM,0\n",
    "agd.csv": "Date,Time,Axis1,Axis2,Axis3,Steps\n6/27/2012,10:54:00,1,2,3,0\n" * 9,
    "counts.agd": "SQLite format 3\0" + "\0" * 400 + "CREATE TABLE data (dataTimestamp INTEGER, axis1 REAL)",
    "renamed.db": "SQLite format 3\0" + "\0" * 400 + "epochcount5394\nepochlength10",
}


def error_of(folder: Path, name: str, text: str, **options: object) -> UnreadableError:
    path = folder / name
    path.write_text(text, "utf-8", newline="")
    with pytest.raises(UnreadableError) as caught:
        find_format(path, ReadOptions(**options))  # type: ignore[arg-type]
    assert str(path) in str(caught.value)
    return caught.value


@pytest.mark.parametrize("name", EPOCHS)
def test_epochs_are_told_in_one_line(tmp_path: Path, name: str) -> None:
    error = error_of(tmp_path, name, EPOCHS[name])
    assert error.message.endswith("epochs, not raw acceleration")
    assert error.hint
    assert "\n" not in str(error)


def test_counts_of_actigraph_name_the_file_to_give(tmp_path: Path) -> None:
    assert ".gt3x" in str(error_of(tmp_path, "counts.agd", EPOCHS["counts.agd"]))


def test_another_database_is_told_too(tmp_path: Path) -> None:
    assert "an SQLite database" in str(error_of(tmp_path, "a.sqlite", "SQLite format 3\0" + "\0" * 99))


@pytest.mark.parametrize(
    "header",
    [
        "x,y,z,weight",
        "x;y;z;temperature_c;posture",
        "meanx,meany,meanz",
        "time,x,y,z,samples,counts_per_g,spread_x",
    ],
)
def test_a_table_of_points_names_fit(tmp_path: Path, header: str) -> None:
    row = header.replace(",", "0.1,").replace(";", "0.1;")
    assert "accelcal fit" in str(error_of(tmp_path, "points.csv", f"{header}\n{row}\n{row}\n"))


@pytest.mark.parametrize(
    "header",
    ["time,x,y,z", "time,acc_x,acc_y,acc_z,steps", "Activity,X [g],Y [g],Z [g]", "ax,ay,az,activity"],
)
def test_columns_of_x_y_and_z_are_samples(tmp_path: Path, header: str) -> None:
    path = tmp_path / "raw.csv"
    path.write_text(f"Recorded with a MotionWatch\n{header}\n" + "0,0,1,0\n" * 30)
    assert find_format(path, ReadOptions()).name == "csv"


@pytest.mark.parametrize("options", [{"unit": "mg"}, {"columns": ("2", "3", "4")}, {"format": "csv"}])
def test_who_says_how_to_read_it_is_heard(tmp_path: Path, options: dict[str, object]) -> None:
    path = tmp_path / "agd.csv"
    path.write_text(EPOCHS["agd.csv"])
    assert find_format(path, ReadOptions(**options)).name == "csv"  # type: ignore[arg-type]


JSON = {
    "acc.json": (
        '{"items":[{"timestamp":9.5,"x":0.1,"y":0.2,"z":0.9},{"timestamp":9.52,"x":0.1,"y":0.2,"z":0.9}]}',
        "ResearchKit",
        "time,x,y,z\n9.5,0.1,0.2,0.9\n9.52,0.1,0.2,0.9\n",
    ),
    "move sense.json": (
        '{"data":[{"acc":{"Timestamp":7,"ArrayAcc":[{"x":1.5,"y":2.5,"z":9.5},{"x":1,"y":2,"z":9}]}}]}',
        "Movesense",
        "time_ms,x,y,z\n7,1.5,2.5,9.5\n7,1,2,9\n",
    ),
    "lines.jsonl": (
        '{"Body":{"Timestamp":7,"ArrayAcc":[{"x":1.5,"y":2.5,"z":9.5}]},"Uri":"a"}\n' * 2,
        "Movesense",
        "time_ms,x,y,z\n7,1.5,2.5,9.5\n7,1.5,2.5,9.5\n",
    ),
}


@pytest.mark.parametrize("name", JSON)
def test_48_9_json_of_phones_comes_with_the_command_that_makes_a_table(tmp_path: Path, name: str) -> None:
    text, what, table = JSON[name]
    error = error_of(tmp_path, name, text)
    assert what in error.message
    if table is not None and shutil.which("jq") and shutil.which("sh"):
        command = (error.hint or "").split("`")[1]
        subprocess.run(["sh", "-c", command], check=True, cwd=tmp_path)
        assert (tmp_path / f"{name}.csv").read_text() == table


def test_48_9_an_activpal_recording_says_what_to_export(tmp_path: Path) -> None:
    (tmp_path / "a.datx").write_bytes(bytes(range(256)) * 8)
    with pytest.raises(
        UnreadableError, match=r"an activPAL's recording.*uncompressed raw acceleration as csv"
    ):
        find_format(tmp_path / "a.datx", ReadOptions())


def test_t20_a_workbook_is_to_be_saved_as_csv(tmp_path: Path) -> None:
    path = tmp_path / "a.xls"
    path.write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600))
    with pytest.raises(UnreadableError, match="save its sheet as CSV"):
        find_format(path, ReadOptions())


@pytest.mark.parametrize(
    "above",
    [
        ";Deadband, 0, counts\n;DeadbandTimeout, 0, sec\n",
        "# resolution, 12, counts\n# steps, 0\n",
        "Steps,0\nCounts,1.5\n\n",
        "% steps, calories, none\n",
    ],
)
@pytest.mark.parametrize("names", ["time,x,y,z", "Headers, time,Ax,Ay,Az"])
def test_t7_a_setting_above_the_names_is_no_name_of_epochs(tmp_path: Path, above: str, names: str) -> None:
    path = tmp_path / "raw.csv"
    path.write_text(above + names + "\n" + "".join(f"{n / 50},0.1,0.2,0.97\n" for n in range(99)))
    assert find_format(path, ReadOptions()).name == "csv"


@pytest.mark.parametrize("names", ["date,time,counts", "# time;steps", '"Id","ActivityMinute","Steps"'])
def test_t7_names_of_epochs_below_settings_still_tell(tmp_path: Path, names: str) -> None:
    text = f"Subject,7\nEpoch,60\n{names}\n" + "2024-03-04,00:00:00,5\n" * 20
    assert "a table of epochs" in str(error_of(tmp_path, "a.csv", text))


POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n"
OPEN_DOCUMENT = b"mimetypeapplication/vnd.oasis.opendocument.spreadsheet"
KINDS = {
    "night.7z": (b"7z\xbc\xaf\x27\x1c\0\4", "is a 7z archive; unpack it first: 7z x "),
    "night.csv": (b"Rar!\x1a\7\0", "is a RAR archive; unpack it first: unrar x "),
    "night.cwa": (
        b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n",
        "; fetch that: `git lfs pull --include ",
    ),
    "night.gt3x": (POINTER, "is a git-lfs pointer"),
    "night.lz4": (b"\x04\x22\x4d\x18@@", "is packed with LZ4; unpack it first: unlz4 -k "),
    "a.npy": (b"\x93NUMPY\1\0v\0{'descr'", "is a NumPy array (.npy); make an .npz of it: python3 -c "),
    "page.csv": (b"\xef\xbb\xbf\n<html lang='de'><body>", "is a web page (HTML)"),
    "page.gt3x": (b"<!-- a\nb --><!doctype HTML>", "is a web page (HTML)"),
    "table.xlsx": (b"PK\3\4" + bytes(26) + b"docProps/app.xml<x>", "save its sheet as CSV"),
    "table.ods": (
        b"PK\3\4" + bytes(26) + b"mimetypeapplication/vnd.oasis.opendocument.spreadsheet",
        "a workbook",
    ),
    "table.csv": (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600), "save its sheet as CSV"),
    "data.rds": (gzip.compress(b"X\n\0\0\0\3\0\4"), "is a data file of R"),
    "data.sav": (b"$FL2@(#) SPSS DATA FILE", "is a data file of SPSS"),
    "scan.pdf": (b"%PDF-1.4\n", "is a PDF document; give the recording itself"),
    "film.mp4": (b"\0\0\0\x20ftypisom", "is a video or a sound"),
    "a.json": (
        b'{"kind": "report", "schema_version": 4, "accelcal_version": "1"}',
        "accelcal (report)",
    ),
    "b.json": (
        b'{\n "kind": "quality",\n "schema_version": 4,\n "accelcal_version": "1"}',
        "(quality); give",
    ),
    "old.json": (
        b'{"accelcal_version": "0.3.0", "schema_version": 3}',
        "accelcal (document)",
    ),
    "study.csv": (
        b"path,use,why,accelcal_version,result\na.csv,yes,,1.0.0,x\n",
        "accelcal (table)",
    ),
}


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("options", [ReadOptions(), ReadOptions(unit="g", rate_hz=25.0)])
def test_t14_other_kinds_are_told_with_what_to_do(tmp_path: Path, name: str, options: ReadOptions) -> None:
    data, words = KINDS[name]
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(UnreadableError) as caught:
        open_recording(path, options)
    said = str(caught.value)
    assert words in said and "from its device" not in said and "FILE" not in said
    assert str(path) in said.partition(": ")[2] or not words.endswith(" ")


def test_t14_text_is_told_as_text(tmp_path: Path) -> None:
    said = str(error_of(tmp_path, "notes.txt", "recorded in spring\nby nobody\n"))
    assert "is text without rows of three or more numbers; name its format" in said and "device" not in said
