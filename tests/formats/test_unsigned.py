"""T10: counts of a converter, which are never negative, lie around their count of 0 g."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.formats.tables.units import FOUND_ZERO, sphere_of_rest, zero_of
from tests.cli.run import exit_code
from tests.formats.make_csv import read, written
from tests.recordings import directions

RATE_HZ, EPOCH_S = 25, 1_709_548_900
GAIN, OFFSET_G = np.array([1.03, 0.98, 1.015]), np.array([0.025, -0.018, 0.030])
NAMED, TURNED, BARE = "time,x,y,z\n", "time;z;x;y\n", ""


def converted(zero: int, lsb: float, bits: int, offset_g: np.ndarray = OFFSET_G) -> np.ndarray:
    held = np.repeat(directions(40) * GAIN + offset_g, 8 * RATE_HZ, axis=0)
    held = held + 0.003 * np.random.RandomState(1).randn(*held.shape)
    return np.clip(np.rint(held * lsb + zero), 0, 2**bits - 1).astype(np.int64)


def as_csv(folder: Path, counts: np.ndarray, head: str = NAMED) -> Path:
    mark, order = (";", [2, 0, 1]) if head is TURNED else (",", [0, 1, 2])
    cells = counts[:, order].tolist()
    rows = (
        mark.join((f"{EPOCH_S + row / RATE_HZ:.3f}", *map(str, values))) for row, values in enumerate(cells)
    )
    return written(folder, head + "\n".join(rows) + "\n")


CONVERTERS = [
    (512, 102, 10, NAMED),
    (128, 21, 8, NAMED),
    (512, 204.8, 10, BARE),
    (2048, 409.6, 12, TURNED),
    (2048, 1000, 12, NAMED),
    (8192, 1024, 14, BARE),
    (32768, 1000, 16, TURNED),
    (32768, 4096, 16, NAMED),
    (32768, 16384, 16, BARE),
    (1 << 23, 1 << 20, 24, NAMED),
]


@pytest.mark.parametrize(("zero", "lsb", "bits", "head"), CONVERTERS)
def test_t10_the_zero_of_a_converter_is_found_and_said(
    tmp_path: Path, zero: int, lsb: float, bits: int, head: str
) -> None:
    counts = converted(zero, lsb, bits)
    path = as_csv(tmp_path, counts, head)
    found = read(path, lsb_per_g=lsb)
    assert np.array_equal(found.counts, counts - zero)
    assert FOUND_ZERO.format(zero) in found.recording.notes
    stated = read(path, lsb_per_g=lsb, zero=zero)
    assert np.array_equal(stated.counts, found.counts)
    assert not any("0 g is at" in note for note in stated.recording.notes)
    assert np.array_equal(read(path, lsb_per_g=lsb, zero=0).counts, counts)


@pytest.mark.parametrize(("zero", "lsb", "bits", "head"), CONVERTERS)
@pytest.mark.parametrize("unit", [None, "counts"])
def test_t10_a_scale_that_nothing_states_is_asked_with_options_to_copy(
    tmp_path: Path, zero: int, lsb: float, bits: int, head: str, unit: str | None
) -> None:
    path = as_csv(tmp_path, converted(zero, lsb, bits), head)
    with pytest.raises(UnreadableError, match=f"counts above 0.*-R zero={zero} --lsb-per-g") as refusal:
        read(path, unit=unit)
    asked = float(str(refusal.value.hint).split("--lsb-per-g ")[1].split(",")[0])
    assert asked == pytest.approx(lsb * GAIN.mean(), rel=0.02)


def test_t10_any_other_zero_is_asked(tmp_path: Path) -> None:
    path = as_csv(tmp_path, converted(338, 68, 10))
    for options in ({}, {"lsb_per_g": 68.0}):
        with pytest.raises(UnreadableError, match=r"-R zero=33[89] --lsb-per-g 68"):
            read(path, **options)
    assert np.array_equal(read(path, lsb_per_g=68.0, zero=338).counts, converted(338, 68, 10) - 338)
    with pytest.raises(UsageError, match=r"about 6[89]"):
        read(path, zero=338)
    with pytest.raises(UsageError, match="-R zero is for counts, not for values in mg"):
        read(path, zero=338, unit="mg")


def test_t10_signed_values_that_happen_to_be_positive_stay_as_they_are(tmp_path: Path) -> None:
    octant = np.abs(directions(200))
    mg = np.rint(1000 * np.repeat(octant, 40, axis=0)).astype(np.int64)
    assert sphere_of_rest(mg.astype(np.float64)) is None
    assert zero_of(mg.astype(np.float64), 1000, tmp_path) is None
    assert read(as_csv(tmp_path, mg)).recording.notes[1] == "unit: mg (judged by the length of gravity)"
    assert np.array_equal(read(as_csv(tmp_path, mg), lsb_per_g=1000).counts, mg)


def test_t10_one_orientation_shows_the_zero_where_the_scale_is_known(tmp_path: Path) -> None:
    """The beginning of a night: rest is 1 g from the middle of only one converter."""
    counts = converted(512, 102, 10)[:200]
    found = read(as_csv(tmp_path, counts), lsb_per_g=102)
    assert np.array_equal(found.counts, counts - 512)


@pytest.mark.parametrize(("zero", "lsb", "bits"), [(512, 102, 10), (2048, 409.6, 12), (32768, 4096, 16)])
def test_t10_its_calibration_is_right_with_offsets_of_almost_half_a_g(
    tmp_path: Path, zero: int, lsb: float, bits: int
) -> None:
    offset_g = np.array([0.4, -0.3, 0.2])
    path = as_csv(tmp_path, converted(zero, lsb, bits, offset_g))
    assert exit_code("calibrate", path, "--report-only", "--lsb-per-g", lsb, "-q") == 0
    calibration = json.loads((tmp_path / "a.calibration.json").read_text())["calibration"]
    assert np.diag(calibration["gain"]) == pytest.approx(1 / GAIN, abs=1e-3)
    assert calibration["offset_g"] == pytest.approx(-offset_g, abs=1e-3)


def test_numbers_beyond_any_converter_do_not_hide_its_zero(tmp_path: Path) -> None:
    counts = converted(512, 102, 10).astype(object)
    counts[::97, 1] = 1 << 600
    path = as_csv(tmp_path, counts)
    with pytest.raises(UnreadableError) as caught:
        read(path)
    assert "512" in str(caught.value)
