"""What rest looks like in a recording that is refused: the picture of a wrong unit, scale, type or column.

A sensor's own errors leave rest within a few tenths of 1 g, and a wrist turns all three axes. `picture` says
how a recording is not like that, and what would explain it: said instead of the advice to record longer.
"""

from __future__ import annotations

from accelcal_cli.core.errors import counted, listed
from accelcal_cli.core.recording import Recording
from accelcal_cli.core.results import Facts, Rest
from accelcal_cli.core.settings import Settings
from accelcal_cli.core.vocabulary import PER_G

NEAR_ONE_G = (0.7, 1.4)
"""Between these is the median of |a| at rest [g] for any sensor whose unit and counts per g are right."""

WIDEST_G = 0.5
"""From the 5th to the 95th percentile, |a| at rest varies by less than this with any sensor's offsets [g]."""

STUCK_G, TURNED_G = 0.02, 0.5
"""An axis that stays within the first while rest turns others by more than the second [g] is none."""

UNITS = {per_g: f"as if values in {unit} were read as g" for unit, per_g in PER_G.items() if unit != "g"} | {
    1 / per_g: f"as if values in g were read as {unit}" for unit, per_g in PER_G.items() if unit != "g"
}
"""What rest measures [g] if the unit is wrong, and how to say so."""

UNIT_TOLERANCE = 0.15
"""Rest that is nearer than this share to an entry of UNITS is explained by it."""

ONE_G = "instead of 1 g"
"""Words of a picture that tells what rest measures."""

NOISE_TIMES = 4
"""A quietest window that scatters by so many times the limit may be rest, measured by a noisy sensor."""


def why_nothing_still(facts: Facts, recording: Recording, settings: Settings) -> tuple[str, str]:
    """What the quietest window of a recording without stillness measures, and advice, ending in `or`."""
    quietest, length = facts.quietest, f"{settings.segment_seconds:g} s"
    if quietest is None:
        return (
            f"nowhere were {length} measured without a gap",
            "give a smaller --segment-seconds or a larger --longest-gap, or ",
        )
    spread_g = quietest.spread / recording.lsb_per_g
    deviation_g = quietest.deviation / recording.lsb_per_g
    range_g, limit_g = settings.stillness_threshold_g, settings.stillness_deviation_g
    if range_g is not None and spread_g >= range_g:
        measured = f"moves by {spread_g:.3g} g (max - min), {range_g:g} g is the limit"
    else:
        measured = f"has a standard deviation of {1000 * deviation_g:.3g} mg"
        measured += "" if limit_g is None else f", {1000 * limit_g:g} mg is the limit"
    found = f"the quietest of {counted(facts.windows, 'window')} of {length} {measured}"
    if limit_g is not None and deviation_g < NOISE_TIMES * limit_g:
        return found, "if that is the sensor's noise, use --stillness adaptive, else "
    return found, "if it rested for shorter times only, give a smaller --segment-seconds, else "


def picture(rest: Rest, lsb_per_g: float, *, decimal: bool) -> str | None:
    """What is odd about rest and what would explain it; None if nothing is.

    Args:
        lsb_per_g: the counts per g that were taken for right.
        decimal: the values arrived as decimal numbers in a unit, not as counts.
    """
    if rest.windows:
        return (
            _alike(rest)
            or _stuck(rest)
            or _size(rest.median_g, "rest measures", lsb_per_g, decimal)
            or _scatter(rest)
        )
    return _size(rest.samples_median_g, "the median of |a| is", lsb_per_g, decimal)


def _alike(rest: Rest) -> str | None:
    if not rest.alike:
        return None
    return f"{listed(rest.alike)} hold the same values throughout: give each axis its own column or field"


def _stuck(rest: Rest) -> str | None:
    spans = dict(
        zip(
            "xyz",
            (high - low for low, high in zip(rest.axis_min_g, rest.axis_max_g, strict=True)),
            strict=True,
        )
    )
    stuck = [axis for axis, span in spans.items() if span < STUCK_G]
    turned = [f"{axis} by {span:.2f} g" for axis, span in spans.items() if span > TURNED_G]
    if not stuck or not turned:
        return None
    at = round(rest.axis_min_g["xyz".index(stuck[0])], 2) + 0.0
    text = f"{stuck[0]} stays at {at:.2f} g at rest while gravity moves {listed(turned)}"
    return f"{text}: check that {stuck[0]} is the right column or field"


def _size(median_g: float | None, what: str, lsb_per_g: float, decimal: bool) -> str | None:
    low, high = NEAR_ONE_G
    if median_g is None or low < median_g < high:
        return None
    if not median_g:
        return f"{what} 0 g: check that the columns or fields are those of the sensor"
    text = f"{what} {median_g:.3g} g {ONE_G}"
    unit = next((why for g, why in UNITS.items() if abs(median_g / g - 1) < UNIT_TOLERANCE), None)
    if unit is not None:
        return f"{text}, {unit}; check the unit (--unit)"
    if decimal:
        return f"{text}; check the unit (--unit) and the columns"
    fits = f"{lsb_per_g * median_g:.4g} counts per g would fit instead of {lsb_per_g:.6g}"
    return f"{text}; {fits}: check --lsb-per-g and the layout"


def _scatter(rest: Rest) -> str | None:
    if rest.p95_g - rest.p5_g < WIDEST_G:
        return None
    text = f"rest measures anything from {rest.p5_g:.2f} to {rest.p95_g:.2f} g"
    return f"{text}, more than scale and offset explain: check the columns, or places and types of the fields"
