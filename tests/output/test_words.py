"""Numbers for people, and what an outcome means."""

from __future__ import annotations

import pytest

from accelcal_cli.core.results import Outcome
from accelcal_cli.output.words import OUTCOMES, figure, formatted, mg, number, outcome_words, with_error


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (3.00234, 0.00278, "+3.0023 +- 0.0028"),
        (-151.04, 0.12, "-151.04 +- 0.12"),
        (5.0, 1.26, "+5.0 +- 1.3"),
        (41.3, 12.2, "+41 +- 12"),
        (412.6, 123.4, "+413 +- 123"),
        (1.0, 1e-12, "+1.000000 +- 0.000000"),
        (1.0, 0.0, "+1.00 +- 0.00"),
    ],
)
def test_an_error_has_two_digits(value: float, error: float, text: str) -> None:
    assert with_error(value, error) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (0.0, "0"),
        (-0.0, "0"),
        (-0.01234, "−0.0123"),
        (1.5, "1.5"),
        (123456.7, "123457"),
        (2.0, "2"),
    ],
)
def test_a_number_on_a_page(value: float | None, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize(
    ("value", "sentence", "cell"),
    [
        (None, "-", "-"),
        (0.5, "0.5", "0.500"),
        (123.4, "123", "123"),
        (1234.5, "1234", "1234"),
        (99.96, "100", "100"),
    ],
)
def test_a_number_at_the_terminal(value: float | None, sentence: str, cell: str) -> None:
    assert (mg(value), figure(value)) == (sentence, cell)
    assert formatted(value, ".1f") == ("-" if value is None else f"{value:.1f}")


def test_every_outcome_has_its_words() -> None:
    assert {str(one) for one in Outcome} == OUTCOMES.keys() - {"failed"}
    assert [name for name, words in OUTCOMES.items() if not words.usable] == ["refused", "failed"]
    assert outcome_words("another").result == "another"
