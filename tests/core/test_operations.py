"""Table 1 of Farago, Maczak, Gingl 2024, and the times that its section II.C derives from it."""

from __future__ import annotations

import pytest

from accelcal_cli.core.points import (
    Arithmetic,
    Operations,
    predicted_charge_mc,
    predicted_seconds,
)

PAPER = Operations(90_150, 90_150)
"""50 iterations with 18 points: 50 (18 * 100 + 3) of each."""


@pytest.mark.parametrize(
    ("name", "arithmetic", "by_hand"),
    [
        ("ATmega328", "integer", 90_150 * 125 / 16e6),  # 28 + 97 = 125 cycles: 0.704 s
        ("ATmega328", "float", 90_150 * 283 / 16e6),  # 123 + 160: 1.595 s
        ("ARM Cortex-M3", "integer", 90_150 * 28 / 80e6),  # 14 + 14: 31.6 ms
        ("ARM Cortex-M3", "float", 90_150 * 164 / 80e6),  # 96 + 68: 185 ms
        ("ARM Cortex-M4", "integer", 90_150 * 13 / 80e6),  # 7 + 6: 14.6 ms
        ("ARM Cortex-M4", "float", 90_150 * 22 / 80e6),  # 11 + 11: 24.8 ms
    ],
)
def test_the_papers_case_by_hand(name: str, arithmetic: Arithmetic, by_hand: float) -> None:
    found = predicted_seconds(PAPER, arithmetic)
    assert found is not None
    assert found[name] == pytest.approx(by_hand, rel=1e-12)


def test_the_times_of_section_2c() -> None:
    whole, real = predicted_seconds(PAPER, "integer"), predicted_seconds(PAPER, "float")
    assert whole is not None and real is not None
    assert round(whole["ATmega328"], 2) == 0.70
    assert whole["ARM Cortex-M3"] < 0.040
    assert real["ARM Cortex-M4"] < 0.030


def test_additions_and_multiplications_cost_their_own() -> None:
    added = predicted_seconds(Operations(16_000_000, 0), "integer")
    multiplied = predicted_seconds(Operations(0, 16_000_000), "integer")
    assert added is not None and multiplied is not None
    assert (added["ATmega328"], multiplied["ATmega328"]) == (28, 97)
    assert (added["ARM Cortex-M4"], multiplied["ARM Cortex-M4"]) == (1.4, 1.2)


def test_charge_is_time_times_current() -> None:
    """0.704 s at 9.2 mA: 6.48 mC; 31.6 and 14.6 ms at 8.45 mA: 0.267 and 0.124 mC."""
    charge = predicted_charge_mc(PAPER, "integer")
    assert charge is not None
    assert [round(value, 3) for value in charge.values()] == [6.480, 0.267, 0.124]
    assert predicted_charge_mc(Operations(), "integer") is None


def test_what_was_not_counted_has_no_time() -> None:
    assert predicted_seconds(Operations(), "float") is None
