"""`accelcal simulate`: every format holds the same counts, and its truth is found again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import all_encoders, open_recording
from tests.cli.run import assert_one_line, little_room, run

Capture = pytest.CaptureFixture[str]
FORMATS = [encoder.name for encoder in all_encoders()]
SMALL = ("--days", 0.02, "--rate", 50, "--seed", 4, "-q")
SLOWEST = {"gt3x": 30}
"""Rates of devices that do not record at 12.5 Hz."""


def read_g(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    with open_recording(path, ReadOptions()) as reader:
        chunks = list(reader.chunks(5000))
        counts = np.concatenate([chunk.counts for chunk in chunks]) / reader.recording.lsb_per_g
    times = np.concatenate([chunk.clock.times(0, len(chunk)) for chunk in chunks])
    warm = [chunk.temperature_mc for chunk in chunks if chunk.temperature_mc is not None]
    return counts, times, np.concatenate(warm) if warm else None


@pytest.mark.nightly
def test_all_formats_hold_the_same_samples_and_times(tmp_path: Path, capsys: Capture) -> None:
    held = []
    for name in FORMATS:
        ran = run(capsys, "simulate", tmp_path / name, "--format", name, *SMALL)
        assert ran.code == 0, ran
        held.append(read_g(Path(ran.lines[0].split("\t")[0])))
    for counts, times, _ in held[1:]:
        np.testing.assert_array_equal(counts, held[0][0])
        assert np.abs(times - held[0][1]).max() <= 1
    assert len(held[0][0]) == round(0.02 * 86_400 * 50)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.nightly] * (name != "gt3x")) for name in FORMATS]
)
def test_the_truth_is_found_again(tmp_path: Path, capsys: Capture, name: str) -> None:
    words = ("--days", 0.4, "--rate", SLOWEST.get(name, 12.5), "--seed", 6, "--truth", 2, "-q", "--json")
    truth = json.loads(run(capsys, "simulate", tmp_path / "a", "--format", name, *words).out)
    path = next(
        p for p in tmp_path.iterdir() if p.name.startswith("a.") and p.suffix not in (".json", ".toml")
    )
    report = json.loads(run(capsys, "calibrate", path, "--report-only", "--json", "--no-temperature").out)
    assert np.abs(np.array(report["calibration"]["gain"]) - truth["sensor"]["gain"]).max() < 2.5e-4
    assert np.abs(np.array(report["calibration"]["offset_g"]) - truth["sensor"]["offset_g"]).max() < 2.5e-4


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path, capsys: Capture) -> None:
    for name in FORMATS:
        run(capsys, "simulate", tmp_path / f"one-{name}", "--format", name, *SMALL)
        run(capsys, "simulate", tmp_path / f"two-{name}", "--format", name, *SMALL)
        ones = sorted(tmp_path.glob(f"one-{name}*"))
        for one in ones:
            two = one.with_name(one.name.replace("one-", "two-"))
            assert one.read_bytes() == two.read_bytes(), one


@pytest.mark.parametrize("option", ["--seed", "--truth"])
def test_the_largest_seed_is_taken_and_the_next_one_told(
    tmp_path: Path, capsys: Capture, option: str
) -> None:
    words = ("simulate", tmp_path / "a", "--format", "hdf5", "--gyro", "--days", 0.003, "-q", option)
    assert run(capsys, *words, 4_000_000_000).code == 0
    ran = run(capsys, *words, 4_000_000_001)
    assert ran.code == 2 and "is not in the range 0<=x<=4000000000" in ran.err


def test_existing_files_are_kept_without_force(tmp_path: Path, capsys: Capture) -> None:
    run(capsys, "simulate", tmp_path / "a", *SMALL)
    ran = run(capsys, "simulate", tmp_path / "a", *SMALL)
    assert ran.code == 5
    assert_one_line(ran, "exists already", "--force")
    assert run(capsys, "simulate", tmp_path / "a", *SMALL, "--force").code == 0


def test_impossible_wishes(tmp_path: Path, capsys: Capture) -> None:
    for words in (("--format", "nothing"), ("--lsb-per-g", 9000), ("--days", 0), ("--days", 1e-9)):
        assert run(capsys, "simulate", tmp_path / "a", *words, "-q").code == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (("cwa", "--rate", 85.7), "an Axivity AX3 does not record at 85.7 Hz; use --rate 100"),
        (("geneactiv", "--rate", 120), "a GENEActiv does not record at 120 Hz; use --rate 100"),
        (("gt3x", "--rate", 25), "an ActiGraph does not record at 25 Hz; use --rate 30"),
        (("gt3x", "--lsb-per-g", 341), "use --lsb-per-g 256 --range-g 8 or --lsb-per-g 341 --range-g 6"),
        (("geneactiv", "--days", 0.00003), "nothing to simulate; raise --days"),
    ],
)
def test_what_the_device_cannot_record_is_refused(
    tmp_path: Path, capsys: Capture, words: tuple[object, ...], hint: str
) -> None:
    ran = run(capsys, "simulate", tmp_path / "a", "--format", *words, "-q")
    assert ran.code == 2
    assert_one_line(ran, hint)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "rate", "true_rate", "unit"),
    [("geneactiv", 66.7, 200 / 3, 300), ("gt3x", 90, 90, 90), ("cwa", 100, 100, 1)],
)
def test_a_recording_ends_with_a_whole_page_or_second(
    tmp_path: Path, capsys: Capture, name: str, rate: float, true_rate: float, unit: int
) -> None:
    words = ("--format", name, "--rate", rate, "--days", 0.001257, "-q", "--json")
    truth = json.loads(run(capsys, "simulate", tmp_path / "a", *words).out)
    wanted = round(0.001257 * 86_400 * true_rate)
    assert (truth["rate_hz"], truth["samples"]) == (true_rate, wanted - wanted % unit)
    (path,) = (path for path in tmp_path.iterdir() if path.suffix != ".json")
    counts, times, _ = read_g(path)
    assert len(counts) == truth["samples"]
    assert abs((times[-1] - times[0]) / 1e6 - (len(counts) - 1) / true_rate) < 2e-5


@pytest.mark.parametrize("name", FORMATS)
def test_a_full_disk_leaves_nothing(tmp_path: Path, capsys: Capture, name: str) -> None:
    with little_room(20_000):
        ran = run(capsys, "simulate", tmp_path / "a", "--format", name, "--days", 0.05, "-q")
    assert ran.code == 5, ran
    assert ran.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_layout_of_ones_own_is_kept(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "a.layout.toml").write_text("mine")
    assert run(capsys, "simulate", tmp_path / "a", "--format", "raw", *SMALL).code == 5
    assert (tmp_path / "a.layout.toml").read_text() == "mine"
