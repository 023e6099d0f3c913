"""How probable a deviation is by chance."""

from __future__ import annotations

from math import atan, erfc, pi, sqrt


def normal(deviation: float) -> float:
    """Probability that a normal variable is as far from 0 as so many standard deviations, or farther."""
    return erfc(abs(deviation) / sqrt(2))


def two_sided(t: float, freedom: int) -> float:
    """The same of Student's t with `freedom` (1 or more) degrees of freedom.

    The finite sums of Abramowitz, Stegun, Handbook of Mathematical Functions (1964), 26.7.3 and 26.7.4.
    """
    angle = atan(abs(t) / sqrt(freedom))
    cosine2 = freedom / (freedom + t * t)
    sine = abs(t) / sqrt(freedom + t * t)
    if freedom % 2:
        inside = 2 / pi * (angle + sine * _sum(sqrt(cosine2), cosine2, range(3, freedom, 2)))
        return max(0.0, 1 - (2 / pi * angle if freedom == 1 else inside))
    return max(0.0, 1 - sine * _sum(1.0, cosine2, range(2, freedom, 2)))


def _sum(first: float, factor: float, numbers: range) -> float:
    """first (1 + factor (n0 - 1) / n0 (1 + factor (n1 - 1) / n1 (...)))."""
    total = term = first
    for number in numbers:
        term *= factor * (number - 1) / number
        total += term
    return total
