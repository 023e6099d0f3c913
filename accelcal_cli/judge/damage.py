"""Refusing a recording of which damage has left too little, and what to do about it."""

from __future__ import annotations

from dataclasses import replace

from accelcal_cli.core.facts import Facts
from accelcal_cli.core.judgement import Coverage, Judgement, Outcome
from accelcal_cli.judge.verdict import LONGER

CUT_SHORT = "truncated"
"""Code of the problem that all readers tell of a file that breaks off."""

COPY_AGAIN = "the file is cut short: copy it again from the device"


def too_damaged(facts: Facts, max_percent: float) -> str | None:
    """Why a recording is refused; None where damage has taken no larger share than `max_percent`."""
    share = facts.lost_percent()
    if share <= max_percent:
        return None
    return (
        f"{share:.1f} % of the recording is lost to damage ({facts.lost_bytes} bytes), "
        f"{max_percent:g} % is the limit; copy it again from the device, or allow more with --max-damage"
    )


def advised(verdict: Judgement, facts: Facts) -> Judgement:
    """A refusal's advice, if the file was cut short: the rest may still be on the device."""
    if all(problem.code != CUT_SHORT for problem in facts.problems):
        return verdict
    return replace(verdict, message=verdict.message.replace(LONGER, f"{COPY_AGAIN}, or {LONGER}"))


def damage_verdict(facts: Facts, max_percent: float, seen: Coverage) -> Judgement | None:
    """The refusal of a recording that is too damaged; None for any other."""
    text = too_damaged(facts, max_percent)
    return None if text is None else Judgement(Outcome.REFUSED, text, seen, ())
