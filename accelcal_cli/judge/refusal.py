"""Reasons of refusals: damage, no stillness, or rest that a wrong unit, scale, type or column explains.

A sensor's own errors leave rest within a few tenths of 1 g, and a wrist turns all three axes. `odd_rest` says
how a recording differs from that and what would explain it; the advice to record longer is left out then.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from accelcal_cli.core.reasons import Reason
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Recording
from accelcal_cli.core.results import NEAR_ONE_G, Coverage, Facts, Judgement, Outcome, Rest
from accelcal_cli.core.settings import Settings
from accelcal_cli.core.vocabulary import PER_G, USUAL_UNITS

LONGER = Reason("record_longer")
NOTHING_STILL = Reason("nothing_still")
FAR_FROM_1_G = Reason("still_far_from_1_g")

WIDEST_G = 0.5
"""Range of |a| at rest [g], 5th to 95th percentile, that no sensor's offsets reach."""

STUCK_G, TURNED_G = 0.02, 0.5
"""Range [g] within which an axis is stuck, if another axis turns at rest by more than the second [g]."""

UNITS = {PER_G[unit]: (unit, "g") for unit in USUAL_UNITS if unit != "g"} | {
    1 / PER_G[unit]: ("g", unit) for unit in USUAL_UNITS if unit != "g"
}
"""Unit of the values and the unit that they were read as, by what rest then measures [g]."""

UNIT_TOLERANCE = 0.15
"""Relative distance from an entry of UNITS within which it explains what rest measures."""

NOISE_TIMES = 4
"""Times the limit up to which the quietest window may be rest that a noisy sensor measured."""


def nothing_still(facts: Facts, recording: Recording, settings: Settings) -> tuple[Reason, Reason]:
    """Return the refusal that says what the quietest window measures, and advice."""
    quietest, length_s = facts.quietest, settings.segment_seconds
    if quietest is None and facts.counts.filled_samples > facts.samples / 2:
        share = 100 * facts.counts.filled_samples / facts.samples
        return Reason.of("nothing_but_filled", filled_percent=share), Reason("check_sensor")
    if quietest is None:
        return Reason.of("nothing_measured", seconds=length_s), Reason("shorter_windows_or_longer_gaps")
    spread_g = quietest.spread / recording.lsb_per_g
    deviation_g = quietest.deviation / recording.lsb_per_g
    range_g, limit_g = settings.stillness_threshold_g, settings.stillness_deviation_g
    values: dict[str, Any] = {"windows": facts.windows, "seconds": length_s}
    if range_g is not None and spread_g >= range_g:
        values |= {"quietest": "range", "measured_g": spread_g, "limit_g": range_g}
    else:
        values |= {"quietest": "deviation", "measured_g": deviation_g, "limit_g": limit_g}
    noisy = limit_g is not None and deviation_g < NOISE_TIMES * limit_g
    return Reason.of("nothing_still", **values), Reason("adaptive_rule" if noisy else "shorter_windows")


def strict_if_odd(settings: Settings, facts: Facts, recording: Recording) -> Settings:
    """Return the settings to judge by: nothing is provisional if rest is odd, whose cause can be removed."""
    return settings if _odd_rest_of(facts, recording) is None else replace(settings, strict=True)


def _odd_rest_of(facts: Facts, recording: Recording) -> Reason | None:
    return odd_rest(facts.rest, recording.lsb_per_g, decimal=recording.lsb_per_g >= FLOAT_LSB_PER_G)


def odd_rest(rest: Rest, lsb_per_g: float, *, decimal: bool) -> Reason | None:
    """Return what is odd about rest and what would explain it, or None.

    Args:
        lsb_per_g: counts per g that were assumed.
        decimal: True if the file has decimal numbers in a unit, not counts.
    """
    if not rest.windows:
        return _wrong_size(rest.samples_median_g, "samples", lsb_per_g, decimal)
    if rest.alike:
        return Reason.of("axes_alike", axes=rest.alike)
    odd = _stuck_axis(rest) or _wrong_size(rest.median_g, "rest", lsb_per_g, decimal)
    if odd is None and rest.p95_g - rest.p5_g >= WIDEST_G:
        return Reason.of("rest_scatters", low_g=rest.p5_g, high_g=rest.p95_g)
    return odd


def _stuck_axis(rest: Rest) -> Reason | None:
    spans = {
        axis: high - low for axis, low, high in zip("xyz", rest.axis_min_g, rest.axis_max_g, strict=True)
    }
    stuck = [axis for axis, span in spans.items() if span < STUCK_G]
    turned = {axis: span for axis, span in spans.items() if span > TURNED_G}
    if not stuck or not turned:
        return None
    at_g = round(rest.axis_min_g["xyz".index(stuck[0])], 2) + 0.0
    return Reason.of("axis_stuck", axis=stuck[0], at_g=at_g, others=list(turned), by_g=list(turned.values()))


def _wrong_size(median_g: float | None, of: str, lsb_per_g: float, decimal: bool) -> Reason | None:
    low, high = NEAR_ONE_G
    if median_g is None or low < median_g < high:
        return None
    if not median_g:
        return Reason.of("gravity_is_zero", of=of)
    unit = next((pair for g, pair in UNITS.items() if abs(median_g / g - 1) < UNIT_TOLERANCE), None)
    if unit is not None:
        return Reason.of("wrong_unit", of=of, median_g=median_g, unit=unit[0], read_as=unit[1])
    if decimal:
        return Reason.of("not_1_g", of=of, median_g=median_g)
    values = {"median_g": median_g, "lsb_per_g": lsb_per_g, "fits": lsb_per_g * median_g}
    return Reason.of("wrong_counts_per_g", of=of, **values)


WRONG_SIZE = ("gravity_is_zero", "wrong_unit", "not_1_g", "wrong_counts_per_g")
"""Codes of rest that is far from 1 g."""


def advised(verdict: Judgement, facts: Facts, recording: Recording, settings: Settings) -> Judgement:
    """Return a refusal with numbers, and advice that fits odd rest or a file that was cut short."""
    if verdict.outcome is not Outcome.REFUSED:
        return verdict
    odd = _odd_rest_of(facts, recording)
    if odd is not None and verdict.reason.code == "provisional":
        values = {name: verdict.reason.values[name] for name in ("error_mg", "low_mg", "high_mg", "limit_mg")}
        reason = Reason.of("calibration_error_over_limit", **values)
        if odd.code in WRONG_SIZE:
            reason = Reason.of(FAR_FROM_1_G.code, median_g=facts.rest.median_g)
        verdict = replace(verdict, reason=reason)
    if odd is not None and odd.code in WRONG_SIZE:
        return replace(verdict, notes=(*verdict.notes, odd), advice=())
    if verdict.reason == NOTHING_STILL:
        reason, advice = nothing_still(facts, recording, settings)
        verdict = replace(verdict, reason=reason, advice=(advice, LONGER))
    elif verdict.reason == FAR_FROM_1_G:
        reason = Reason.of(FAR_FROM_1_G.code, median_g=facts.rest.median_g)
        verdict = replace(verdict, reason=reason, advice=(Reason("check_unit"),))
    if odd is not None:
        return replace(verdict, notes=(*verdict.notes, odd), advice=())
    if facts.cut_short:
        return replace(verdict, advice=(Reason("copy_again"), *verdict.advice))
    return verdict


def damage_verdict(facts: Facts, max_percent: float, coverage: Coverage) -> Judgement | None:
    """Return the refusal of a recording that lost more than `max_percent` to damage, or None.

    What is missing does not count: it says nothing against what is there.
    """
    share = facts.damaged_percent()
    if share <= max_percent:
        return None
    why = Reason.of("damaged", lost_percent=share, lost_bytes=facts.damaged_bytes, limit_percent=max_percent)
    advice = (Reason("copy_again"), Reason("allow_damage"))
    return Judgement(Outcome.REFUSED, why, coverage, (), advice=advice)
