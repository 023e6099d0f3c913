"""Calibrated values that are stored as whole numbers: the same bits come back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.calibration import Transform
from accelcal_cli.core.clock import StampClock
from accelcal_cli.core.recording import Chunk
from accelcal_cli.output.columns import NO_TEMPERATURE_MC, numbers_of_axes
from accelcal_cli.pipeline.export import beyond

ROWS = 20_000
COUNTS = np.random.default_rng(1).integers(-300, 300, (ROWS, 3)).astype(np.int16)
WARM = np.repeat(np.arange(100), ROWS // 100).astype(np.int32) * 37 + 20_000
LOWER = np.array([[1.02, 0, 0], [0.01, 0.98, 0], [0.02, -0.01, 1.01]])
NEARLY_DIAGONAL = np.array([[1.02, 0, 1e-5], [0, 0.98, 0], [0, 0, 1.01]])
OFFSET, SLOPE = np.array([0.01, -0.02, 0.03]), np.array([1e-3, 0, -2e-3])


def transform(gain: Any, slope: Any = (0, 0, 0), steps: float | None = None) -> Transform:
    return Transform(np.array(gain, float), OFFSET, np.array(slope, float), 24.5, 256.0, steps)


@pytest.mark.parametrize(
    ("applied", "axes"),
    [
        (transform(LOWER), "x"),
        (transform(LOWER, SLOPE), "x"),
        (transform(np.diag([1.02, 0.98, 1.01]), SLOPE), "xyz"),
        (transform(NEARLY_DIAGONAL), "yz"),
        (transform(LOWER, SLOPE, steps=4096.0), "xyz"),
        (transform(LOWER, steps=2.0), "xyz"),
        (transform(LOWER, steps=2.0**140), "x"),
        (transform(np.diag([1.02, -0.98, 1.01])), "xyz"),
    ],
)
@pytest.mark.parametrize("warm", [None, WARM])
def test_values_of_the_numbers_have_the_bits_of_the_calibrated_ones(
    applied: Transform, axes: str, warm: Any
) -> None:
    chunk = Chunk(0, COUNTS, StampClock(np.arange(ROWS)), 0, temperature_mc=warm)
    xyz = applied.apply(chunk)
    found = numbers_of_axes(applied, has_temperature=True)
    assert "".join(found) == axes
    held = np.full(ROWS, NO_TEMPERATURE_MC, np.int32) if warm is None else warm
    for name, numbers in found.items():
        whole = numbers.of(chunk, xyz).astype(numbers.dtype)
        values = numbers.values(*((whole, held) if numbers.paired_with else (whole,)))
        expected = xyz["xyz".index(name)]
        assert (values.view(np.uint32) == expected.view(np.uint32)).all()
    if applied.steps_per_g == 2.0:
        assert (np.signbit(xyz[0]) & (xyz[0] == 0)).any()  # zeros with a sign are among them


@pytest.mark.parametrize("range_g", [None, 0.5, 1.0, 1.2, 1.3, 8.0])
def test_samples_beyond_the_range_are_counted(range_g: float | None) -> None:
    applied = transform(LOWER, SLOPE)
    chunk = Chunk(0, COUNTS, StampClock(np.arange(ROWS)), 0, temperature_mc=WARM)
    lengths = np.max(np.abs(applied.apply(chunk)), axis=0)
    expected = 0 if range_g is None else int((lengths > np.float32(range_g)).sum())
    assert beyond(chunk, applied, range_g) == expected
    assert beyond(chunk.part(0, 0), applied, range_g) == 0


def test_values_of_a_text_are_too_fine_for_a_table() -> None:
    fine = Transform(np.eye(3), OFFSET, np.zeros(3), 24.5, 2.0**24)
    assert numbers_of_axes(fine, has_temperature=False) == {}


def test_the_temperature_is_looked_at_only_where_it_counts() -> None:
    found = numbers_of_axes(transform(np.eye(3), SLOPE), has_temperature=True)
    assert [numbers.paired_with for numbers in found.values()] == ["temperature", None, "temperature"]
    found = numbers_of_axes(transform(np.eye(3), SLOPE), has_temperature=False)
    assert [numbers.paired_with for numbers in found.values()] == [None] * 3
