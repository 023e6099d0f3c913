"""Finding the six faces: still windows of one orientation become states, states near an axis poses."""

from __future__ import annotations

from math import cos, radians

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.fixed import to_fixed
from accelcal_cli.core.poses import FACES, Integers3, Pose, Session, TimedWindows
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.poses._states import state, unit

BETWEEN = -1


def find_faces(still: TimedWindows, first_us: int, lsb_per_g: float, settings: PoseSettings) -> Session:
    """The states of a session, each on the face whose axis it shows most of.

    A state is a run of adjacent still windows on one face that keep within a few degrees of their
    mean: taking the device up ends it, putting it down again begins another. Its first and last
    window may hold the beginning of a movement and are left out where there are others.
    """
    directions = unit(still.windows.sums / still.windows.samples[:, np.newaxis])
    faces = faces_of(directions, settings.face_degrees)
    local_g = to_fixed(settings.gravity.local_g())
    shortest_us = settings.min_state_seconds * 1e6
    poses, between, short = [], [], 0
    for at in runs(still, directions, faces, settings.state_degrees):
        found = state(still, at[1:-1] if len(at) > 2 else at, lsb_per_g)
        face = int(faces[at[0]])
        if int(still.end_us[at[-1]] - still.start_us[at[0]]) < shortest_us:
            short += 1
        elif face == BETWEEN:
            between.append(found)
        else:
            poses.append(Pose(FACES[face], face, found, reference(face, local_g)))
    return Session(first_us, tuple(poses), tuple(between), short)


def faces_of(directions: NDArray[np.float64], degrees: float) -> NDArray[np.int64]:
    """The face (index of FACES) that each unit vector (m, 3) is near, or BETWEEN."""
    axis = np.abs(directions).argmax(axis=1)
    largest = directions[np.arange(len(directions)), axis]
    face = 2 * axis + (largest < 0)
    return np.where(np.abs(largest) >= cos(radians(degrees)), face, BETWEEN)


def runs(
    still: TimedWindows, directions: NDArray[np.float64], faces: NDArray[np.int64], degrees: float
) -> list[list[int]]:
    """Indices of the windows of each state."""
    near = cos(radians(degrees))
    end = still.windows.first_sample + still.windows.samples
    found: list[list[int]] = []
    total = np.zeros(3)
    for index, direction in enumerate(directions):
        before = index - 1
        adjacent = index > 0 and still.windows.first_sample[index] == end[before]
        if adjacent and faces[index] == faces[before] and _cosine(total, direction) >= near:
            found[-1].append(index)
            total = total + direction
        else:
            found.append([index])
            total = direction
    return found


def _cosine(total: NDArray[np.float64], direction: NDArray[np.float64]) -> float:
    return float((total * direction).sum() / np.sqrt((total * total).sum()))


def reference(face: int, local_g: int) -> Integers3:
    """What the device truly measures on a face (index of FACES), fixed-point g."""
    up = -local_g if face % 2 else local_g
    x, y, z = (up if axis == face // 2 else 0 for axis in range(3))
    return x, y, z
