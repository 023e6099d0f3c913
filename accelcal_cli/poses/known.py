"""From the states of a session to twelve parameters and all that is known of them."""

from __future__ import annotations

from collections.abc import Sequence

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.poses import Floats3, KnownFit, Matrix3, PoseError, Session
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.poses.errors import between_norm_mg, pose_errors
from accelcal_cli.poses.solve import Solution, condition_number, solve
from accelcal_cli.poses.uncertainty import uncertainty

FEWEST = 4
"""N of Bragge et al.: with fewer there are more unknowns than equations."""

FEWEST_CHECKED = 2
"""A mean of fewer errors has no confidence interval."""

_LONGER = "rest the device on every face for 10 s, or list the poses with --poses"


def known_fit(session: Session, settings: PoseSettings) -> KnownFit:
    """Solve and measure the errors.

    Raises:
        DivergedError: the poses do not determine the parameters, or leave none to judge them by.
    """
    condition = condition_number(session.poses)
    _require(session, condition, settings)
    solution = solve(session.poses, settings.gravity)
    errors = pose_errors(session.poses, solution.calibration, settings)
    _require_checks(session, errors)
    precision = uncertainty(session.poses, solution)
    return KnownFit(
        calibration=solution.calibration,
        k=_floats(solution),
        o=_offset(solution),
        k_errors=precision.k,
        o_errors=precision.o,
        standard_errors=precision.parameters,
        condition_number=condition,
        worst_direction_mg=precision.worst_direction_mg,
        errors=errors,
        between_norm_mg=between_norm_mg(session.between, solution.calibration, settings.gravity),
    )


def _require(session: Session, condition: float, settings: PoseSettings) -> None:
    """Raise DivergedError unless the matrix [a 1] of the poses has rank 4, and well so."""
    if not session.poses:
        raise DivergedError(_no_poses(session, settings), hint=_LONGER)
    found = session.orientations
    if found < FEWEST or condition > settings.max_condition:
        few = f"{found} pose{'' if found == 1 else 's'}" if found < FEWEST else "the poses"
        raise DivergedError(
            f"{few}{_which(session)} cannot determine twelve parameters: that takes four whose matrix [a 1] "
            "has rank 4, and a fifth to judge by",
            hint=f"{_missing(session)}{_LONGER}",
        )


def _require_checks(session: Session, errors: Sequence[PoseError]) -> None:
    """Raise DivergedError where hardly any orientation could be left out."""
    held = zip(session.poses, errors, strict=True)
    checked = {pose.number for pose, error in held if error.held_out is not None}
    if len(checked) < FEWEST_CHECKED:
        raise DivergedError(
            f"the poses{_which(session)} only just determine twelve parameters and leave none to judge by",
            hint=f"{_missing(session)}{_LONGER}",
        )


def _no_poses(session: Session, settings: PoseSettings) -> str:
    seen = [(len(session.between), "lie between faces"), (session.short, "are too short")]
    told = " and ".join(f"{number} {what}" for number, what in seen if number)
    return f"no still state lies within {settings.face_degrees:g} degrees of a face{told and f'; {told}'}"


def _which(session: Session) -> str:
    return f" ({', '.join(sorted({pose.face for pose in session.poses}))})"


def _missing(session: Session) -> str:
    """A missing face is tolerable while the others determine all and can be left out in turn."""
    return f"missing: {', '.join(session.missing)}; " if session.missing else ""


def _floats(solution: Solution) -> Matrix3:
    first, second, third = ((float(x), float(y), float(z)) for x, y, z in solution.k)
    return first, second, third


def _offset(solution: Solution) -> Floats3:
    x, y, z = solution.o
    return float(x), float(y), float(z)
