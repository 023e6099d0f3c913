"""Whether a recording is one of those that it is calibrated with."""

from __future__ import annotations

from accelcal_cli.core.judgement import Holdout

ODD_TIMES, ODD_MG = 3.0, 1.0
"""Errors on a recording's own windows that speak against it are larger than before, and larger than so many
times the pool's median and so many mg more."""

SEEN = "own points, which are among those that were fitted"


def worse(held: Holdout, usual_mg: float, limit_mg: float) -> str | None:
    """Why a pool's coefficients are not for a recording, or None.

    Args:
        held: errors on the recording's own windows.
        usual_mg: median of the pool's held-out errors; some recordings' postures are worse than others,
            and where a raw error happens to be small none can be smaller.
    """
    before, after = held.before.mean, held.after.mean
    changed = f"{before:.1f} mg become {after:.2f} mg on {held.postures} postures of its own"
    if after > before and after > ODD_TIMES * usual_mg + ODD_MG:
        return f"{changed}, {usual_mg:.2f} mg are usual in the pool"
    return f"{changed}, {limit_mg:g} mg is the limit" if after >= limit_mg else None
