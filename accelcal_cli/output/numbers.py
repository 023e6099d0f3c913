"""Numbers as people read them: on pages, at the terminal and in sentences."""

from __future__ import annotations

from math import floor, log10


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


def mg_of_two_digits(value: float) -> str:
    """Write an error [mg] where there is little room."""
    return f"{value:.1f}" if value >= 1 else f"{value:.2f}"


def with_error(value: float, error: float) -> str:
    """Write a value and its standard error, this to two significant digits."""
    digits = 2 if error <= 0 else min(6, max(0, 1 - floor(log10(error))))
    return f"{value:+.{digits}f} +- {error:.{digits}f}"
