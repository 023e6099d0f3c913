"""The report's sections on known orientations: the poses, and the model in its authors' convention."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from accelcal_cli.core.arithmetic import to_float
from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.results import Outcome
from accelcal_cli.output.report import rounded, significant, summary_json
from accelcal_cli.six_pose.poses import (
    Integers3,
    Pose,
    PoseError,
    Session,
    SixPoseFit,
    Uncertainty,
    VectorErrors,
)
from accelcal_cli.six_pose.roll import AXES, Figures, Rolled
from accelcal_cli.six_pose.spans import Origin
from accelcal_cli.six_pose.verdict import NOTHING_HELD_OUT

EQUATION = "z = K a + O"


def poses_json(session: Session, fit: SixPoseFit) -> list[dict[str, Any]]:
    """The `poses` list, in the order of time."""
    return [_pose(session, fit, pose, error) for pose, error in zip(session.poses, fit.errors, strict=True)]


def _pose(session: Session, fit: SixPoseFit, pose: Pose, error: PoseError) -> dict[str, Any]:
    state = pose.state
    return {
        "face": pose.face,
        **_place(session, state.file, state.start_us, state.end_us),
        "windows": pose.state.windows,
        "mean_raw_g": _in_g(pose.state.raw),
        "reference_g": _in_g(pose.reference),
        "raw_mg": round(error.raw, 4),
        "residual_mg": None if fit.precision is None else round(error.residual, 4),
        "held_out_mg": rounded(error.held_out),
        "held_out_norm_mg": rounded(error.held_out_norm),
        "held_out_tilt_degrees": rounded(error.tilt_degrees),
        "repeat_mg": rounded(error.repeat),
    }


def _place(session: Session, file: int, start_us: int, end_us: int) -> dict[str, Any]:
    """Where a stretch is: the file, if there are several, and seconds from its first sample."""
    name = session.name(file)
    times = {"start_s": start_us, "end_s": end_us}
    return ({} if name is None else {"file": name}) | {
        key: round(session.seconds(time_us, file), 6) for key, time_us in times.items()
    }


def _in_g(values: Integers3) -> list[float]:
    return [to_float(value) for value in values]


def known_json(
    session: Session,
    fit: SixPoseFit,
    outcome: Outcome,
    vectors: VectorErrors | None,
    rolls: Sequence[Rolled] = (),
) -> dict[str, Any]:
    """The `known_orientations` object; K and O are null where they were refused.

    Args:
        vectors: None where nothing was held out.
    """
    refused = outcome is Outcome.REFUSED
    return {
        "equation": EQUATION,
        "K": None if refused else [list(row) for row in fit.k],
        "O": None if refused else list(fit.o),
        "standard_errors": None if refused or fit.precision is None else _errors(fit.precision),
        "holdout_vector_mg": vectors
        and {"before": summary_json(vectors.before), "after": summary_json(vectors.after)},
        "repeat_spread_mg": rounded(_repeat_spread(fit)),
        "orientations": session.orientations,
        "missing_faces": list(session.missing),
        "left_out": {
            "between_faces": len(session.between),
            "between_faces_norm_mg": rounded(fit.between_norm_mg),
            "short": session.short,
        },
        **({} if vectors is not None else {"unchecked": NOTHING_HELD_OUT}),
        **({"rolls": [_roll(session, one) for one in rolls]} if rolls else {}),
        **({"files": [_file(one) for one in session.files]} if session.files else {}),
    }


def _roll(session: Session, roll: Rolled) -> dict[str, Any]:
    """One of `rolls`; what follows a calibration is null where there is none."""
    before, after = roll.before, roll.after
    return {
        "axis": AXES[roll.axis],
        **_place(session, roll.file, *roll.ends_us),
        "samples": roll.samples,
        "level_mg": {"before": _level(before), "after": after and _level(after)},
        "length_g": {
            "before": rounded(before.length_g),
            "after": rounded(None if after is None else after.length_g),
        },
    }


def _level(figures: Figures) -> dict[str, float]:
    return {"mean": round(1000 * figures.mean_g, 4), "sd": round(1000 * figures.sd_g, 4)}


def _file(origin: Origin) -> dict[str, Any]:
    """One of `files`."""
    own_us = origin.first_us - origin.moved_us
    return {
        "name": origin.name,
        "start_time": iso_time(own_us, origin.offset_s) if origin.dated else None,
        "samples": (origin.end_sample or 0) - origin.first_sample,
        "problems": origin.problems,
        "lost_bytes": origin.lost_bytes,
    }


def _errors(known: Uncertainty) -> dict[str, Any]:
    k = [[significant(value) for value in row] for row in known.k]
    return {"K": k, "O": [significant(value) for value in known.o]}


def _repeat_spread(fit: SixPoseFit) -> float | None:
    """The largest distance of a state from the mean of its orientation; None without repeated ones."""
    return max((error.repeat for error in fit.errors if error.repeat is not None), default=None)
