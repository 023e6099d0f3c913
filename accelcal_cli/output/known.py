"""Sections of a report on known orientations: the poses, and the model in its authors' convention."""

from __future__ import annotations

from typing import Any

from accelcal_cli.core.fixed import to_float
from accelcal_cli.core.judgement import Outcome
from accelcal_cli.core.poses import Integers3, KnownFit, Matrix3, Pose, PoseError, Session, VectorErrors
from accelcal_cli.output.sections import significant, summary_json

EQUATION = "z = K a + O"


def poses_json(session: Session, fit: KnownFit) -> list[dict[str, Any]]:
    """The `poses` list, in the order of time."""
    return [_pose(session, pose, error) for pose, error in zip(session.poses, fit.errors, strict=True)]


def _pose(session: Session, pose: Pose, error: PoseError) -> dict[str, Any]:
    return {
        "face": pose.face,
        "start_s": _seconds(pose.state.start_us, session),
        "end_s": _seconds(pose.state.end_us, session),
        "windows": pose.state.windows,
        "mean_raw_g": _in_g(pose.state.raw),
        "reference_g": _in_g(pose.reference),
        "raw_mg": round(error.raw, 4),
        "residual_mg": round(error.residual, 4),
        "held_out_mg": _rounded(error.held_out),
        "held_out_norm_mg": _rounded(error.held_out_norm),
        "held_out_tilt_degrees": _rounded(error.tilt_degrees),
        "repeat_mg": _rounded(error.repeat),
    }


def _seconds(time_us: int, session: Session) -> float:
    return round((time_us - session.first_us) / 1e6, 6)


def _in_g(values: Integers3) -> list[float]:
    return [to_float(value) for value in values]


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 4)


def known_json(session: Session, fit: KnownFit, outcome: Outcome, vectors: VectorErrors) -> dict[str, Any]:
    """The `known_orientations` object; K and O are null where they were refused."""
    refused = outcome is Outcome.REFUSED
    return {
        "equation": EQUATION,
        "K": None if refused else [list(row) for row in fit.k],
        "O": None if refused else list(fit.o),
        "standard_errors": None if refused else _errors(fit.k_errors, fit.o_errors),
        "holdout_vector_mg": {"before": summary_json(vectors.before), "after": summary_json(vectors.after)},
        "repeat_spread_mg": _rounded(vectors.repeat_spread),
        "orientations": session.orientations,
        "missing_faces": list(session.missing),
        "left_out": {
            "between_faces": len(session.between),
            "between_faces_norm_mg": _rounded(fit.between_norm_mg),
            "short": session.short,
        },
    }


def _errors(k: Matrix3, o: tuple[float, float, float]) -> dict[str, Any]:
    return {
        "K": [[significant(value) for value in row] for row in k],
        "O": [significant(value) for value in o],
    }
