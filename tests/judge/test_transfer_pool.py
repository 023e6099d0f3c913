"""Whether a recording is one of those that it is calibrated with: both limits, on both sides."""

from __future__ import annotations

import pytest

from accelcal_cli.judge.model_ladder import of_postures
from accelcal_cli.judge.verdict import SEEN, worse


@pytest.mark.parametrize(
    ("before", "after", "why"),
    [
        (5.0, 3.9, None),
        (3.0, 3.9, None),
        (3.0, 4.1, "1.00 mg are usual in the pool"),
        (5.0, 4.1, None),
        (30.0, 9.9, None),
        (30.0, 10.0, "10 mg is the limit"),
    ],
)
def test_larger_than_before_and_than_three_times_the_usual_and_a_mg_or_beyond_the_limit(
    before: float, after: float, why: str | None
) -> None:
    held = of_postures(SEEN, 4, ((before, after), (before, after)))
    found = worse(held, usual_mg=1.0, limit_mg=10.0)
    changed = f"{before:.1f} mg become {after:.2f} mg on 2 postures of its own"
    assert found == (None if why is None else f"{changed}, {why}")
