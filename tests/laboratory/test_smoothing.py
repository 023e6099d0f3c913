"""`accelcal evaluate smoothing`: Tables 1 and 2 of Grammenos et al. 2018, on noise that is known."""

from __future__ import annotations

import json
from pathlib import Path
from statistics import mean, median, variance

import numpy as np
import pytest

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.exports.rows import width_for
from accelcal_cli.formats import open_recording
from accelcal_cli.laboratory.smoothing import samples_at, variances
from tests.cli.run import run
from tests.recordings import directions, good_raw, still_counts, write_csv

Capture = pytest.CaptureFixture[str]
SMOOTHING = ("evaluate", "smoothing")


@pytest.mark.parametrize(
    ("rate_hz", "width"), [(1, 3), (20, 3), (25, 5), (80, 5), (100, 10), (120, 10), (125, 20), (400, 20)]
)
def test_the_width_is_that_of_table_2(rate_hz: float, width: int) -> None:
    assert width_for(rate_hz) == width


def test_white_noise_becomes_as_much_smaller_as_it_must() -> None:
    """A mean of n samples has 1/n of the variance; a median, about pi/2 of that for larger n."""
    noise = 0.003 * np.random.RandomState(3).standard_normal((200, 500, 3))
    for width in (3, 5, 10, 20):
        found = variances(noise, width)
        assert found.mean == pytest.approx(9e-6 / width, rel=0.1)
        assert 1.2 < found.median / found.mean < np.pi / 2


def test_it_is_a_plain_rolling_mean_and_median() -> None:
    held = np.random.RandomState(4).standard_normal((2, 30, 3))
    for kind, made in ((mean, variances(held, 5).mean), (median, variances(held, 5).median)):
        by_loops = [
            variance([kind(axis[first : first + 5]) for first in range(26)])
            for window in held.tolist()
            for axis in zip(*window, strict=True)
        ]
        assert made == pytest.approx(mean(by_loops))


def test_windows_are_found_again_in_any_chunks(tmp_path: Path) -> None:
    path = good_raw(tmp_path)
    counts = np.fromfile(path, "<i2").reshape(-1, 3)
    first = np.array([0, 100, 4990, 30_000])
    for chunk in (997, 64, 1 << 18):
        with open_recording(path, ReadOptions()) as reader:
            held = samples_at(reader, first, 125, chunk)
        assert all((held[place] == counts[one : one + 125]).all() for place, one in enumerate(first))


def test_a_recording_shows_its_noise(tmp_path: Path, capsys: Capture) -> None:
    """3 mg of noise at 25 Hz, and counts of 3.9 mg."""
    path = good_raw(tmp_path)
    found = json.loads(run(capsys, *SMOOTHING, path, "--json").out)
    expected = 0.003**2 + (1 / 256) ** 2 / 12
    assert found["variance_raw_g2"] == pytest.approx(expected, rel=0.03)
    assert found["width_for_rate"] == 5
    five = found["widths"][1]
    assert five["samples"] == 5 and five["variance_mean_g2"] == pytest.approx(expected / 5, rel=0.06)
    shown = run(capsys, *SMOOTHING, path)
    assert shown.code == 0 and "3.457e-05" in shown.out
    (line,) = [line for line in shown.out.splitlines() if line.endswith("for this rate")]
    assert line.split()[0] == "5"


def test_what_has_no_stillness_is_said(tmp_path: Path, capsys: Capture) -> None:
    moving = np.random.RandomState(1).randint(-500, 500, (3000, 3)).astype(np.int16)
    ran = run(capsys, *SMOOTHING, write_csv(tmp_path / "moving.csv", moving), "-R", "unit=g")
    assert ran.code == 2 and "no still window" in ran.err
    still = write_csv(tmp_path / "still.csv", still_counts(directions(3)))
    assert run(capsys, *SMOOTHING, still, "--segment-seconds", 0.5).code == 2
