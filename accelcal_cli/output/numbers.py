"""Numbers as people read them: on pages, at the terminal and in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, log10

from accelcal_cli.core.errors import significant


def number(value: float | None, digits: int = 3) -> str:
    """Write a number for a page: significant digits, at least all before the point; a dash for none."""
    if value is None:
        return "–"
    places = 0 if value == 0 else max(0, digits - 1 - floor(log10(abs(value))))
    text = f"{value:.{min(places, 9)}f}"
    text = text.rstrip("0").removesuffix(".") if "." in text else text
    return text.replace("-", "−") if float(text) else text.removeprefix("-")


def millionths(value: float | None) -> str:
    """Write a coefficient or its standard error for a page, to a millionth; a dash for none."""
    return "–" if value is None else f"{value:.6f}".replace("-", "−")


def figure(value: float | None, digits: int = 3) -> str:
    """Write a number for the terminal: significant digits, zeros at the end included; `-` for none."""
    if value is None:
        return "-"
    return f"{value:.0f}" if abs(value) >= 10**digits else f"{value:#.{digits}g}".rstrip(".")


def formatted(value: float | None, form: str) -> str:
    """Write a number for the terminal by a format; `-` for none."""
    return "-" if value is None else format(value, form)


def mg(value: float | None) -> str:
    """Write an error [mg] in a sentence: three digits, without zeros at the end; `-` for none."""
    return "-" if value is None else f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def percent(value: float | None) -> str:
    """Write R of F eq. 21 [%] with three digits; `-` for none."""
    return figure(None if value is None else significant(value, 3))


def times_smaller(factor: float | None, ci95: Sequence[float | None] | None) -> str:
    """Write how many times smaller an error became, to follow the two errors; nothing if it is not known."""
    if not factor:
        return ""
    low, high = ci95 or (None, None)
    word = "smaller"
    if factor < 1:
        factor, word = 1 / factor, "larger"
        low, high = (None if not end else 1 / end for end in (high, low))
    interval = "" if low is None or high is None else f" (95 % interval {mg(low)} to {mg(high)})"
    return f", {mg(factor)} times {word}{interval}"


def mg_of_two_digits(value: float) -> str:
    """Write an error [mg] where there is little room."""
    return f"{value:.1f}" if value >= 1 else f"{value:.2f}"


def with_error(value: float, error: float) -> str:
    """Write a value and its standard error, this to two significant digits."""
    digits = 2 if error <= 0 else min(6, max(0, 1 - floor(log10(error))))
    return f"{value:+.{digits}f} +- {error:.{digits}f}"
