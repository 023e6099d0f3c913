"""What puts a sensor right that changed: at single samples in fixed point, and at many in floats."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import Correction

FLAT = (ONE, ONE, ONE)
HALF = (ONE // 2, ONE, 2 * ONE)
JUMPS = Correction((0, 100), (FLAT, HALF), ((0, 0, 0), (ONE // 4, 0, -ONE // 8)), lines=False)
LINES = Correction((0, 100, 300), (FLAT,) * 3, ((0, 0, 0), (ONE, 0, 0), (ONE, -ONE, 0)), lines=True)


@pytest.mark.parametrize(("sample", "knot"), [(0, 0), (99, 0), (100, 1), (10**9, 1)])
def test_jumps_stay_until_the_next_knot(sample: int, knot: int) -> None:
    assert JUMPS.at(sample) == (JUMPS.stretch[knot], JUMPS.shift[knot])


@pytest.mark.parametrize(
    ("sample", "shift"), [(0, (0, 0, 0)), (25, (0.25, 0, 0)), (200, (1, -0.5, 0)), (301, (1, -1, 0))]
)
def test_lines_go_from_knot_to_knot_and_stay_behind_the_last(sample: int, shift: tuple[float, ...]) -> None:
    assert LINES.at(sample) == (FLAT, tuple(round(value * ONE) for value in shift))


@given(st.lists(st.integers(0, 1000), min_size=1, max_size=30), st.sampled_from([JUMPS, LINES]))
def test_many_samples_are_as_one_by_one(samples: list[int], correction: Correction) -> None:
    """Whether or not they lie between the same knots."""
    where = np.array(sorted(samples), np.int64)
    stretch, shift = (np.broadcast_to(part, (len(where), 3)) for part in correction.values(where))
    for number, sample in enumerate(where.tolist()):
        one = correction.values(np.array([sample], np.int64))
        assert stretch[number].tolist() == one[0][0].tolist()
        assert shift[number].tolist() == one[1][0].tolist()
        exact = correction.at(sample)
        assert stretch[number] == pytest.approx(np.array(exact[0]) / ONE, abs=2 / ONE)
        assert shift[number] == pytest.approx(np.array(exact[1]) / ONE, abs=2 / ONE)


def test_the_unit_of_shifts_changes_and_that_of_stretches_does_not() -> None:
    local_g = Fraction(998, 1000)
    standard = JUMPS.in_standard_g(local_g)
    assert standard.stretch == JUMPS.stretch
    assert standard.shift[1] == (round(ONE * 0.2495), 0, round(-ONE * 0.12475))
    assert np.abs(np.array(standard.in_local_g(local_g).shift) - JUMPS.shift).max() <= 1
