"""Refusing a recording of which damage has left too little."""

from __future__ import annotations

from accelcal_cli.core.facts import Facts
from accelcal_cli.core.judgement import Coverage, Judgement, Outcome


def too_damaged(facts: Facts, max_percent: float) -> str | None:
    """Why a recording is refused; None where damage has taken no larger share than `max_percent`."""
    share = facts.lost_percent()
    if share <= max_percent:
        return None
    return (
        f"{share:.1f} % of the recording is lost to damage ({facts.lost_bytes} bytes), "
        f"{max_percent:g} % is the limit; copy it again from the device, or allow more with --max-damage"
    )


def damage_verdict(facts: Facts, max_percent: float, seen: Coverage) -> Judgement | None:
    """The refusal of a recording that is too damaged; None for any other."""
    text = too_damaged(facts, max_percent)
    return None if text is None else Judgement(Outcome.REFUSED, text, seen, ())
