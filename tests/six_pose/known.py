"""Poses as records, and Bragge et al.'s equations 2 to 4 written out with numpy."""

from __future__ import annotations

import numpy as np

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.six_pose.poses import FACES, Pose, Session, StillState


def fixed3(values: np.ndarray) -> tuple[int, int, int]:
    x, y, z = (round(float(value) * ONE) for value in values)
    return x, y, z


def poses_of(references: np.ndarray, raw_g: np.ndarray, numbers: list[int] | None = None) -> list[Pose]:
    """One state a row; every row is an orientation of its own unless numbered."""
    found = []
    for index, (reference, raw) in enumerate(zip(references, raw_g, strict=True)):
        number = index if numbers is None else numbers[index]
        state = StillState(index * 20_000_000, index * 20_000_000 + 8_000_000, 8, fixed3(raw))
        found.append(Pose(face_of(reference), number, state, fixed3(reference)))
    return found


def face_of(reference: np.ndarray) -> str:
    """The face of an exact axis."""
    axes = np.flatnonzero(reference)
    return FACES[2 * axes[0] + int(reference[axes[0]] < 0)] if len(axes) == 1 else "listed"


def session_of(poses: list[Pose]) -> Session:
    return Session(0, tuple(poses))


def stacked(references: np.ndarray, raw_g: np.ndarray, weights: np.ndarray | None = None) -> tuple:
    """K and O by eq. 2-4: theta = (k11 k21 k31 k12 .. k33 ox oy oz), one H for each measurement."""
    weights = np.ones(len(references)) if weights is None else weights
    blocks = [np.hstack([np.kron(a, np.eye(3)), np.eye(3)]) for a in references]
    root = np.repeat(np.sqrt(weights), 3)
    theta = np.linalg.lstsq(np.vstack(blocks) * root[:, None], raw_g.reshape(-1) * root, rcond=None)[0]
    return theta[:9].reshape(3, 3).T, theta[9:]
