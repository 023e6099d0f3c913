"""The words of a refusal: damage, no stillness, or rest that a wrong unit, scale, type or column explains.

A sensor's own errors leave rest within a few tenths of 1 g, and a wrist turns all three axes. `odd_rest` says
how a recording differs from that and what would explain it, instead of the advice to record longer.
"""

from __future__ import annotations

from dataclasses import replace

from accelcal_cli.core.errors import counted, listed
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Recording
from accelcal_cli.core.results import Coverage, Facts, Judgement, Outcome, Rest
from accelcal_cli.core.settings import Settings
from accelcal_cli.core.vocabulary import PER_G

LONGER = "record longer, with more turns of the wrist"
DISAGREE = "check that the device is sound, and that what is taken for rest is rest (--stillness)"
NOTHING_STILL = "no still window was found"
NO_STILLNESS = f"{NOTHING_STILL}; {LONGER}"
FAR_OFF = "still windows measure far from 1 g"
FAR_FROM_1_G = f"{FAR_OFF}; check the unit with --unit and --lsb-per-g"

CUT_SHORT = "truncated"
"""Code of the problem that all readers report for a file that breaks off."""

COPY_AGAIN = "the file is cut short: copy it again from the device"

NEAR_ONE_G = (0.7, 1.4)
"""Bounds of the median of |a| at rest [g] for any sensor whose unit and counts per g are right."""

WIDEST_G = 0.5
"""Range of |a| at rest [g], 5th to 95th percentile, that no sensor's offsets reach."""

STUCK_G, TURNED_G = 0.02, 0.5
"""Range [g] within which an axis is stuck, if another axis turns at rest by more than the second [g]."""

UNITS = {per_g: f"as if values in {unit} were read as g" for unit, per_g in PER_G.items() if unit != "g"} | {
    1 / per_g: f"as if values in g were read as {unit}" for unit, per_g in PER_G.items() if unit != "g"
}
"""Sentences for wrong units, by what rest then measures [g]."""

UNIT_TOLERANCE = 0.15
"""Relative distance from an entry of UNITS within which it explains what rest measures."""

ONE_G = "instead of 1 g"
"""Words of a message that already says what rest measures."""

NOISE_TIMES = 4
"""Times the limit up to which the quietest window may be rest that a noisy sensor measured."""


def why_nothing_still(facts: Facts, recording: Recording, settings: Settings) -> tuple[str, str]:
    """Return what the quietest window measures, and advice that ends in `or` or `else`."""
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


def odd_rest(rest: Rest, lsb_per_g: float, *, decimal: bool) -> str | None:
    """Return what is odd about rest and what would explain it, or None.

    Args:
        lsb_per_g: counts per g that were assumed.
        decimal: True if the file has decimal numbers in a unit, not counts.
    """
    if not rest.windows:
        return _wrong_size(rest.samples_median_g, "the median of |a| is", lsb_per_g, decimal)
    if rest.alike:
        return f"{listed(rest.alike)} hold the same values throughout: give each axis its own column or field"
    return (
        _stuck_axis(rest) or _wrong_size(rest.median_g, "rest measures", lsb_per_g, decimal) or _scatter(rest)
    )


def _stuck_axis(rest: Rest) -> str | None:
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


def _wrong_size(median_g: float | None, what: str, lsb_per_g: float, decimal: bool) -> str | None:
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


def advised(verdict: Judgement, facts: Facts, recording: Recording, settings: Settings) -> Judgement:
    """Return a refusal with numbers, and advice that fits odd rest or a file that was cut short."""
    if verdict.outcome is not Outcome.REFUSED:
        return verdict
    odd = odd_rest(facts.rest, recording.lsb_per_g, decimal=recording.lsb_per_g >= FLOAT_LSB_PER_G)
    if odd is None or ONE_G not in odd:
        verdict = replace(verdict, message=_with_numbers(verdict.message, facts, recording, settings))
    if odd is not None:
        return replace(verdict, message=f"{verdict.message.split('; ')[0]}; {odd}")
    if all(problem.code != CUT_SHORT for problem in facts.problems):
        return verdict
    return replace(verdict, message=verdict.message.replace(LONGER, f"{COPY_AGAIN}, or {LONGER}"))


def _with_numbers(message: str, facts: Facts, recording: Recording, settings: Settings) -> str:
    """Add to a refusal for lack of stillness near 1 g what was measured instead, and the limit."""
    if message == NO_STILLNESS:
        found, advice = why_nothing_still(facts, recording, settings)
        return f"{NOTHING_STILL}: {found}; {advice}{LONGER}"
    if message == FAR_FROM_1_G:
        return message.replace(FAR_OFF, f"{FAR_OFF} (typically {facts.rest.median_g:.3g} g)")
    return message


def damage_verdict(facts: Facts, max_percent: float, coverage: Coverage) -> Judgement | None:
    """Return the refusal of a recording that lost more than `max_percent` to damage, or None."""
    share = facts.lost_percent()
    if share <= max_percent:
        return None
    text = (
        f"{share:.1f} % of the recording is lost to damage ({facts.lost_bytes} bytes), "
        f"{max_percent:g} % is the limit; copy it again from the device, or allow more with --max-damage"
    )
    return Judgement(Outcome.REFUSED, text, coverage, ())
