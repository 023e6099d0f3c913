"""Files that are cut short: what they announce and do not hold is known to be missing, and is told first."""

from __future__ import annotations

import importlib
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.results import Facts
from accelcal_cli.formats import open_recording
from accelcal_cli.pipeline.facts import FactsObserver
from tests.cli.run import run
from tests.formats import make_gt3x
from tests.formats.expected import Expected
from tests.recordings import directions, still_counts, write_csv

HALF = 6000
"""Rows in the first half."""

ANNOUNCED = {"edf": 332 / 50, "geneactiv": 3840 / 300, "gt3x": 58_825 / 12_000, "parmay": 6, "wav": 8}
"""Bytes of a row (of the unpacked file) in formats whose header says how much they hold."""

SILENT = ("csv", "cwa", "flash", "genea", "raw", "unisens")
"""Formats that cannot know how much is missing, but see that a row or page is incomplete."""


def counts() -> np.ndarray:
    return np.random.RandomState(11).randint(-500, 500, (2 * HALF, 3)).astype(np.int16)


def made(folder: Path, name: str) -> Expected:
    return importlib.import_module(f"tests.formats.make_{name}").make(folder, counts(), 50.0, 256.0)


def cut(path: Path, keep: int) -> None:
    path.write_bytes(path.read_bytes()[:keep])


def facts_of(recording: Expected) -> Facts:
    """What is found, the same for any size of the chunks."""
    found = []
    with open_recording(recording.path, recording.options) as reader:
        for size in (7, 4096):
            observer = FactsObserver(reader.recording, reader.recording.lsb_per_g)
            for chunk in reader.chunks(size):
                observer.see(chunk)
            found.append(observer.result())
    assert found[0].missing_bytes == found[1].missing_bytes and found[0].problems == found[1].problems
    return found[0]


@pytest.mark.parametrize("name", [*ANNOUNCED, *SILENT])
def test_a_whole_file_lacks_nothing(name: str, tmp_path: Path) -> None:
    facts = facts_of(made(tmp_path, name))
    assert (facts.missing_bytes, facts.cut_short, facts.lost_percent()) == (0, False, 0.0)


@pytest.mark.parametrize("name", ANNOUNCED)
def test_verdicts_12_bytes_known_to_be_missing_are_lost(name: str, tmp_path: Path) -> None:
    recording = made(tmp_path, name)
    cut(recording.path, recording.path.stat().st_size // 2 + 3)
    facts = facts_of(recording)
    absent = (2 * HALF - facts.samples) * ANNOUNCED[name]
    assert facts.cut_short
    assert facts.missing_bytes + facts.damaged_bytes == pytest.approx(absent, rel=0.01)
    assert facts.lost_percent() == pytest.approx(100 * (1 - facts.samples / (2 * HALF)), abs=0.6)
    assert facts.damaged_percent() < 5


@pytest.mark.parametrize("name", SILENT)
def test_a_cut_of_unknown_length_is_told_without_an_amount(name: str, tmp_path: Path) -> None:
    recording = made(tmp_path, name)
    path = next(recording.path.parent.glob("acc*.bin")) if name == "unisens" else recording.path
    cut(path, path.stat().st_size // 2 + 4)
    facts = facts_of(recording)
    assert (facts.missing_bytes, facts.cut_short) == (0, True)


def test_more_records_than_announced_are_no_cut(tmp_path: Path) -> None:
    recording = made(tmp_path, "edf")
    data = recording.path.read_bytes()
    recording.path.write_bytes(data[:236] + b"239".ljust(8) + data[244:])
    facts = facts_of(recording)
    assert ([one.code for one in facts.problems], facts.cut_short) == (["wrong_count"], False)


@pytest.mark.parametrize("ending", ["", "\n"])
def test_a_table_whose_last_line_has_all_its_cells_is_not_cut_short(ending: str, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "a.csv", still_counts(directions(3)))
    path.write_text(path.read_text().rstrip("\n") + ending)
    facts = facts_of(Expected(path, counts(), 25.0, None))
    assert not facts.cut_short
    assert facts.problems == ()
    cut(path, path.stat().st_size - 12)
    assert facts_of(Expected(path, counts(), 25.0, None)).cut_short


def test_rows_of_an_hdf5_file_that_are_lost_are_not_counted_twice(tmp_path: Path) -> None:
    recording = made(tmp_path, "hdf5")
    size = recording.path.stat().st_size
    cut(recording.path, size - 5000)
    try:
        facts = facts_of(recording)
    except Exception as error:  # the description may lie at the end
        pytest.skip(str(error))
    assert facts.cut_short
    assert facts.lost_bytes <= (2 * HALF - facts.samples) * 6 + 5000


def link(path: Path, poses: int = 60) -> Path:
    rows = still_counts(directions(poses))
    rows = np.repeat(rows, 2, axis=0)[: len(rows) * 2 // 50 * 50]
    return make_gt3x.make(path, rows, 50.0, 256.0).path


def test_verdicts_12_a_gt3x_cut_to_half_is_used_with_care(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = link(tmp_path)
    with zipfile.ZipFile(whole) as archive:
        size = archive.getinfo("log.bin").file_size
        parts = {one.filename: archive.read(one) for one in archive.infolist()}
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(parts):  # info.txt before log.bin, so that it stays
            archive.writestr(name, parts[name])
    cut(whole, whole.stat().st_size // 2)
    ran = run(capsys, "calibrate", whole, "--html", "-d", tmp_path / "out")
    assert ran.code == 0, ran.err
    report = json.loads((tmp_path / "out" / "recording.calibration.json").read_text())
    health, first = report["file_health"], report["cautions"][0]
    assert 0.4 * size < health["missing_bytes"] < 0.7 * size
    assert health["lost_bytes"] >= health["missing_bytes"]
    assert health["lost_percent"] == pytest.approx(100 * health["lost_bytes"] / size, rel=0.02)
    assert first["code"] == "cut_short"
    assert first["values"]["missing_bytes"] == health["missing_bytes"]
    assert first["values"]["missing_percent"] == pytest.approx(health["lost_percent"], rel=0.01)
    page = (tmp_path / "out" / "recording.html").read_text()
    assert "Use with care" in page and "The file is cut short: at least" in page and "Good:" not in page
    quiet = run(capsys, "calibrate", whole, "-q", "-d", tmp_path / "again")
    assert "The file is cut short" in quiet.err


@pytest.mark.parametrize("limit", [0, 50])
def test_what_is_missing_is_no_damage(limit: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two thirds are missing and nothing is damaged: no limit on damage refuses it."""
    recording = make_wav_of(tmp_path)
    cut(recording, (recording.stat().st_size // 3 - 1024) // 8 * 8 + 1024)
    ran = run(
        capsys,
        "calibrate",
        recording,
        "-R",
        f"max_damage={limit}",
        "--report-only",
        "-d",
        tmp_path / "o",
        "--json",
    )
    report = json.loads(ran.out)
    assert ran.code == 0 and report["file_health"]["lost_percent"] > 60
    assert report["cautions"][0]["code"] == "cut_short"


def make_wav_of(folder: Path) -> Path:
    wav = importlib.import_module("tests.formats.make_wav")
    path: Path = wav.make(folder, still_counts(directions(150)), 25.0, 256.0).path
    return path


def test_half_a_recording_of_zeros_is_used_with_care(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = still_counts(directions(60))
    rows = np.concatenate([rows, np.zeros_like(rows)])
    path = write_csv(tmp_path / "a.csv", rows)
    ran = run(capsys, "calibrate", path, "--html")
    report = json.loads((tmp_path / "a.calibration.json").read_text())
    assert ran.code == 0 and report["cautions"][0] == {
        "code": "filled_share",
        "values": {"filled_percent": 50.0, "filled_samples": len(rows) // 2},
    }
    assert "50.0 % of the samples are filled" in (tmp_path / "a.html").read_text()
    assert "  caution      50.0 % of the samples are filled" in run(capsys, "inspect", path).out


def test_zeros_alone_are_refused_as_such(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = np.zeros((5000, 3), np.int16)
    rows[:200] = still_counts(directions(1))[:1]
    ran = run(capsys, "calibrate", write_csv(tmp_path / "a.csv", rows), "--json", "--unit", "g")
    report = json.loads(ran.out)
    assert (ran.code, report["outcome"]) == (4, "refused")
    assert report["reason"] in ("nothing_but_filled", "too_few_orientations", "constant_values")
