"""Recordings of phones, whose stamps jitter and skip: their still windows, and what is said of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk
from accelcal_cli.pipeline import inspect
from accelcal_cli.pipeline.survey import open_marked
from tests.cli.run import run
from tests.recordings import directions, still_counts, write_csv
from tests.six_pose.made import six_faces

Numbers = np.ndarray
LATE_US = 130_000
"""Three periods and more at 25 Hz: a stamp so late comes after a gap, and the next one goes back."""


def late(times_us: Numbers) -> Numbers:
    """Every 50th stamp comes late."""
    times_us[20::50] += LATE_US
    return times_us


def lossy(times_us: Numbers) -> Numbers:
    """Seven rows are lost before every 50th one: 200 ms of nothing, and 320 ms from row to row."""
    times_us += 280_000 * (np.arange(len(times_us)) // 50)
    return times_us


def recording(folder: Path, stamps: Callable[[Numbers], Numbers] | None, name: str = "a.csv") -> Path:
    """The good recording with other stamps."""
    path = write_csv(folder / name, still_counts(directions(12)))
    return path if stamps is None else restamped(path, stamps)


def restamped(path: Path, stamps: Callable[[Numbers], Numbers], period_us: int = 40_000) -> Path:
    """A table with other stamps, which its rows had every so many microseconds."""
    header, *lines = path.read_text().splitlines()
    times = stamps(period_us * np.arange(len(lines), dtype=np.int64)) + 1_709_510_400_000_000
    rows = [line.split(",", 1)[1] for line in lines]
    lines = [f"{time},{row}" for time, row in zip(times.tolist(), rows, strict=True)]
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


def calibrated(path: Path, *words: object) -> dict[str, Any]:
    ran = run("calibrate", "--report-only", "--json", "-q", "--force", path, *words)
    report: dict[str, Any] = json.loads(ran.out)
    return report


@pytest.mark.parametrize(
    ("stamps", "jumps"),
    [(late, {"gaps": 180, "gap_seconds": 30.6, "backward": 180}),
     (lossy, {"gaps": 179, "gap_seconds": 57.28, "backward": 0})],
)  # fmt: skip
def test_the_same_rows_give_the_same_calibration_however_their_stamps_jitter(
    tmp_path: Path, stamps: Callable[[Numbers], Numbers], jumps: dict[str, float]
) -> None:
    even = calibrated(recording(tmp_path, None, "even.csv"))
    found = calibrated(recording(tmp_path, stamps))
    for key in ("calibration", "fit", "calibration_error_mg", "coverage"):
        assert found[key] == even[key]
    assert found["recording"]["sample_rate_hz"] == 25.0
    clock = found["file_health"]["clock"]
    assert {key: clock[key] for key in jumps} == jumps, "nothing is hidden"
    assert clock["rate_hz_measured"] == 25.0
    assert found["settings"]["longest_gap_s"] == 0.5
    assert found["recording"]["notes"][-1].startswith("its times jitter or skip a little: ")
    assert found["recording"]["notes"][-1].endswith("windows span them (--longest-gap)")


def test_a_look_tells_of_it(tmp_path: Path) -> None:
    ran = run("inspect", recording(tmp_path, late))
    assert "its times jitter or skip a little: 360 short gaps and steps back in what was read; " in ran.out


def test_windows_end_at_every_gap_if_that_is_asked_for(tmp_path: Path) -> None:
    path = recording(tmp_path, lossy)
    for seconds in (0, 0.319):
        found = calibrated(path, "--longest-gap", seconds)
        assert (found["outcome"], found["fit"]["windows"]["complete"]) == ("refused", 0)
        assert not any("jitter" in note for note in found["recording"]["notes"])
    assert calibrated(path, "--longest-gap", 0.32)["outcome"] == "calibrated"


def test_a_report_that_lacks_the_setting_is_verified_without_gaps(tmp_path: Path) -> None:
    path = recording(tmp_path, lossy)
    calibrated(path, "--longest-gap", 0)
    report = tmp_path / "a.calibration.json"
    held = json.loads(report.read_text())
    del held["settings"]["longest_gap_s"]
    held["accelcal_version"] = "0.1.0"
    report.write_text(json.dumps(held))
    ran = run("verify", "--json", report, path)
    assert (ran.code, json.loads(ran.out)["settings_assumed"]) == (0, ["longest_gap_s"])


def test_no_window_spans_two_pieces_of_a_look(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inspect, "PREVIEW_SAMPLES", 1150)
    monkeypatch.setattr(inspect, "SMALL_BYTES", 0)
    border = looked_at(recording(tmp_path, lambda times_us: times_us))[1].first_sample

    def late_there(times_us: Numbers) -> Numbers:
        times_us[border] += LATE_US
        return times_us

    path = recording(tmp_path, late_there)
    pieces = looked_at(path)
    assert pieces[1].clock_jumps.tolist() == [0, 1]
    ran = run("inspect", "--json", path)
    windows = sum(len(piece) // 125 for piece in pieces)
    assert json.loads(ran.out)["read"]["windows"] == windows < 9000 // 125


def looked_at(path: Path) -> list[Chunk]:
    """The pieces of a table that a look at it reads."""
    with open_marked(path, ReadOptions()) as reader:
        return list(reader.preview(inspect.PREVIEW_SAMPLES, inspect.PREVIEW_PIECES))


def test_a_session_on_six_faces_goes_on_too(tmp_path: Path) -> None:
    path = six_faces(tmp_path)
    even = json.loads(run("six-pose", path, "--json").out)
    found = json.loads(run("six-pose", restamped(path, late, 20_000), "--json", "--force").out)
    assert found["calibration"] == even["calibration"]
    assert found["fit"]["windows"] == even["fit"]["windows"]
    assert "jitter" in found["recording"]["notes"][-1]
