"""Finding the six faces among still windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE, to_fixed
from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.points import Windows
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.six_pose.poses import FACES, Origin, Session, find_faces
from tests.six_pose.made import UP, turned

LSB = 1000.0
LENGTH = 50
SETTINGS = PoseSettings()


def windows(*runs: tuple[object, int] | None) -> Windows:
    """Runs of windows of one second with these means; None is a window that was not still."""
    means, index = [], []
    at = 0
    for run in runs:
        if run is None:
            at += 1
            continue
        vector, number = run
        mean = np.array(UP[vector] if isinstance(vector, str) else vector, float)
        means += [mean] * number
        index += range(at, at + number)
        at += number
    first = LENGTH * np.array(index, np.int64)
    sums = np.rint(np.array(means) * LSB * LENGTH).astype(np.int64).reshape(-1, 3)
    start = 5_000_000 + 1_000_000 * np.array(index, np.int64)
    samples = np.full(len(index), LENGTH, np.int64)
    return Windows(samples, first, sums, np.ones_like(sums), None, start, start + 1_000_000)


def found(*runs: tuple[object, int] | None, settings: PoseSettings = SETTINGS) -> Session:
    return find_faces(windows(*runs), [Origin(5_000_000, False, None)], LSB, settings)


def test_the_six_faces_are_found_in_their_order_and_their_edges_are_left_out() -> None:
    runs = [run for face in UP for run in ((face, 8), None)]
    session = found(*runs)
    assert [pose.face for pose in session.poses] == list(FACES)
    assert session.missing == ()
    assert [pose.state.windows for pose in session.poses] == [6] * 6
    assert [pose.state.start_us for pose in session.poses] == [6_000_000 + 9_000_000 * n for n in range(6)]
    assert session.poses[0].state.end_us == 12_000_000
    for pose in session.poses:
        assert pose.reference == tuple(ONE * value for value in UP[pose.face])
        assert pose.state.raw == pose.reference


def test_a_bump_begins_another_state_of_the_same_face() -> None:
    session = found(("+x", 4), None, ("+x", 2), None, ("-z", 3))
    assert [(pose.face, pose.number, pose.state.windows) for pose in session.poses] == [
        ("+x", 0, 2),
        ("+x", 0, 2),
        ("-z", 5, 1),
    ]
    assert session.orientations == 2
    assert session.missing == ("-x", "+y", "-y", "+z")


def test_states_that_are_short_or_between_faces_are_counted() -> None:
    session = found(("+x", 1), None, (turned(UP["+y"], 16), 5), None, (turned(UP["+y"], 14), 5))
    assert (session.short, len(session.between)) == (1, 1)
    assert [pose.face for pose in session.poses] == ["+y"]


def test_a_slow_turn_within_a_face_is_split_where_it_leaves_the_mean() -> None:
    session = found(("+x", 4), (turned(UP["+x"], 1.9), 4))
    assert len(session.poses) == 1
    session = found(("+x", 4), (turned(UP["+x"], 2.1), 4))
    assert len(session.poses) == 2


@pytest.mark.parametrize(("degrees", "faces"), [(15.0, 0), (25.0, 1)])
def test_how_far_a_face_may_be_from_its_axis(degrees: float, faces: int) -> None:
    session = found((turned(UP["-y"], 20), 4), settings=replace(SETTINGS, face_degrees=degrees))
    assert len(session.poses) == faces


def test_references_are_local_gravity() -> None:
    settings = replace(SETTINGS, latitude=0.0, altitude_m=3000.0)
    session = found(("-z", 4), settings=settings)
    local = (9.780327 - 3.086e-6 * 3000) / 9.80665
    assert session.poses[0].reference == (0, 0, -to_fixed(round(local, 9)))


def test_another_file_begins_another_state_though_its_windows_follow() -> None:
    origins = [Origin(5_000_000, True, None, name, 200 * n, 200 * (n + 1)) for n, name in enumerate("ab")]
    session = find_faces(windows(("+x", 8)), origins, LSB, SETTINGS)
    assert [(pose.face, pose.state.file, pose.state.windows) for pose in session.poses] == [
        ("+x", 0, 2),
        ("+x", 1, 2),
    ]
    assert (session.name(1), session.files) == ("b", tuple(origins))


def test_a_file_without_a_pose_ends_the_session_unless_it_is_a_roll() -> None:
    origins = [Origin(5_000_000, True, None, name, 200 * n, 200 * (n + 1)) for n, name in enumerate("ab")]
    with pytest.raises(DivergedError, match="b: no rest of 2 s lies within 15 degrees of a face"):
        find_faces(windows(("+x", 4)), origins, LSB, SETTINGS)
    session = find_faces(windows(("+x", 4)), origins, LSB, SETTINGS, rolled_files=[1])
    assert len(session.poses) == 1


def test_nothing_still_is_no_pose() -> None:
    session = found()
    assert (session.poses, session.between, session.short) == ((), (), 0)
