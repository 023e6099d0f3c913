"""F's nine subsets by hand-made windows and by a plain reading of its Fig. 6."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from math import floor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.collect.subsets import PaperCollector, SubsetCollector
from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.points import WEIGHT_ONE, Role
from accelcal_cli.core.settings import DEFAULT, PAPER
from tests.collect.made import windows

LENGTH, LSB = 4, 256.0
G = 1024
"""Sum of counts of a window that rests at 1 g."""

LEVELS = ("-1 g", "0 g", "+1 g")
ALL = [f"{axis} {level}" for axis in "xyz" for level in LEVELS]
NOWHERE = G // 2
"""0.5 g lies in no interval."""

ONE_SUBSET = {
    f"{axis} {level}": tuple(value if place == index else NOWHERE for place in range(3))
    for index, axis in enumerate("xyz")
    for level, value in zip(LEVELS, (-G, 0, G), strict=True)
}


class Offered:
    """A collector of windows of one length."""

    def __init__(self, length: int, lsb_per_g: float) -> None:
        self.length = length
        self.held = SubsetCollector(lsb_per_g)
        self.missing = self.held.missing
        self.points = self.held.points

    def offer(self, xyz: tuple[int, int, int]) -> bool:
        return self.held.offer(self.length, xyz)


def collector(length: int = LENGTH, lsb_per_g: float = LSB) -> Offered:
    return Offered(length, lsb_per_g)


@pytest.mark.parametrize("name", ALL)
def test_a_point_fills_its_subset(name: str) -> None:
    held = collector()
    assert held.missing() == ALL
    assert held.offer(ONE_SUBSET[name])
    assert held.missing() == ALL, "one point of two"
    assert held.offer(ONE_SUBSET[name])
    assert held.missing() == [other for other in ALL if other != name]
    assert not held.offer(ONE_SUBSET[name]), "full"


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("border", "outside"), [(-5, -1), (-3, 1), (-1, -1), (1, 1), (3, -1), (5, 1)])
def test_the_borders_belong_to_the_intervals(axis: int, border: int, outside: int) -> None:
    quarter = G // 4
    inside = [NOWHERE] * 3
    inside[axis] = border * quarter
    beyond = list(inside)
    beyond[axis] += outside
    assert collector().offer((inside[0], inside[1], inside[2]))
    assert not collector().offer((beyond[0], beyond[1], beyond[2]))


@pytest.mark.parametrize(
    ("value", "taken"), [(255, True), (256, False), (-255, True), (-256, False), (767, False), (768, True)]
)
def test_borders_between_counts_are_not_rounded(value: int, taken: bool) -> None:
    # 1 g is 1023 counts here, a quarter 255.75, three quarters 767.25
    assert collector(3, 341.0).offer((512, 512, value)) == taken


def test_axes_are_asked_in_the_order_x_y_z() -> None:
    held = collector()
    point = (0, G, -G)
    for name in ("x 0 g", "x 0 g", "y +1 g", "y +1 g", "z -1 g", "z -1 g"):
        before = held.missing()
        assert held.offer(point)
        assert set(before) - set(held.missing()) <= {name}
    assert not held.offer(point)
    assert held.missing() == [name for name in ALL if name not in ("x 0 g", "y +1 g", "z -1 g")]


def test_a_point_outside_all_intervals_is_not_taken() -> None:
    assert not collector().offer((NOWHERE, -NOWHERE, 2 * G))


def test_eighteen_points_fill_all_and_come_subset_by_subset() -> None:
    held = collector()
    for name in reversed(ALL):
        assert held.offer(ONE_SUBSET[name])
        assert held.offer(ONE_SUBSET[name])
    points = held.points()
    assert held.missing() == [] and len(points) == 18
    assert points.weights.tolist() == [WEIGHT_ONE] * 18
    assert points.windows.tolist() == [1] * 18
    assert points.xyz[::2].tolist() == points.xyz[1::2].tolist()
    assert points.xyz[::2].tolist() == [[value * (ONE // G) for value in ONE_SUBSET[name]] for name in ALL]
    assert points.tau is None


INTERVALS = tuple((Fraction(low, 4), Fraction(high, 4)) for low, high in ((-5, -3), (-1, 1), (3, 5)))


def by_the_paper(
    stream: list[tuple[int, int, int]], count: Fraction, distance: Fraction, limits: tuple[int, ...]
) -> tuple[list[int], list[int]]:
    """Numbers of the windows that the first and the second set take, in the order of the limits."""
    sets: list[dict[tuple[int, int], list[int]]] = [{}, {}]
    for number, window in enumerate(stream):
        if not Fraction(1, 4) < sum(value * value for value in window) / count**2 < Fraction(9, 4):
            continue
        taken = [stream[n] for held in sets for numbers in held.values() for n in numbers]
        apart = (sum((a - b) ** 2 for a, b in zip(window, point, strict=True)) for point in taken)
        if any(square < (distance * count) ** 2 for square in apart):
            continue
        for most, held in ((most, held) for most in limits for held in sets):
            places = [
                (axis, level)
                for axis, value in enumerate(window)
                for level, (low, high) in enumerate(INTERVALS)
                if low <= value / count <= high and len(held.get((axis, level), [])) < most
            ]
            if places:
                held.setdefault(places[0], []).append(number)
                break
    return tuple([n for _, item in sorted(held.items()) for n in item] for held in sets)


STREAM = st.lists(
    st.tuples(*[st.integers(-1300, 1300) | st.sampled_from([-1280, -768, -256, 256, 768, 1280])] * 3),
    max_size=60,
)


@given(
    STREAM,
    st.sampled_from([(4, 256.0), (3, 341.0), (7, 150.5)]),
    st.integers(1, 7),
    st.sampled_from([0.0, 0.05, 0.2, 0.7]),
    st.sampled_from([(2, 2), (1, 1), (1, 3), (2, 5)]),
)
def test_both_sets_are_those_of_the_paper(
    stream: list[tuple[int, int, int]],
    kind: tuple[int, float],
    batch: int,
    distance_g: float,
    numbers: tuple[int, int],
) -> None:
    (length, lsb_per_g), (least, most) = kind, numbers
    settings = replace(DEFAULT, min_distance_g=distance_g, min_subset_points=least, max_subset_points=most)
    paper = PaperCollector(lsb_per_g, settings)
    for start in range(0, len(stream), batch):
        paper.add(windows(length, stream[start : start + batch]))
    count = Fraction(lsb_per_g) * length
    sets = by_the_paper(stream, count, Fraction(str(distance_g)), tuple(sorted({least, most})))
    for held, taken in zip((paper.fit, paper.control), sets, strict=True):
        expected = [[floor(Fraction(v) / count * ONE + Fraction(1, 2)) for v in stream[n]] for n in taken]
        assert held.points().xyz.tolist() == expected


def test_no_window_is_in_both_sets() -> None:
    paper = PaperCollector(LSB, DEFAULT)
    stream = [(number, NOWHERE, NOWHERE) for number in range(6)]
    paper.add(windows(LENGTH, stream))
    sets = [[int(x) * G // ONE for x in held.points().xyz[:, 0]] for held in (paper.fit, paper.control)]
    assert sets == [[0, 1], [2, 3]]


def test_windows_that_gravity_cannot_give_enter_neither_set_and_are_counted() -> None:
    paper = PaperCollector(LSB, DEFAULT)
    paper.add(windows(LENGTH, [(0, 0, 0)] * 5 + [(G, 8 * G, 0), (G, 0, 0)]))
    assert paper.implausible == 6
    assert (len(paper.fit.points()), len(paper.control.points())) == (1, 0)


def taken(distance_g: float, stream: list[tuple[int, int, int]], length: int | list[int] = LENGTH) -> int:
    """Number of windows that go into either set."""
    paper = PaperCollector(LSB, replace(PAPER, min_distance_g=distance_g))
    paper.add(windows(length, stream))
    return len(paper.fit.points()) + len(paper.control.points())


@pytest.mark.parametrize(
    ("distance_g", "apart", "number"),
    [
        (0.25, (0, 0, 256), 2),
        (0.25, (0, 0, 255), 1),
        (0.25, (0, 0, -255), 1),
        (0.2, (0, 0, 205), 2),  # 204.8
        (0.2, (0, 0, 204), 1),
        (5 / 1024, (3, 4, 0), 2),  # 3, 4, 5
        (5 / 1024, (0, 4, 2), 1),
        (0.0, (0, 0, 0), 2),
    ],
)
def test_a_mean_is_taken_from_the_very_distance_on(
    distance_g: float, apart: tuple[int, int, int], number: int
) -> None:
    assert taken(distance_g, [(G, 0, 0), (G + apart[0], apart[1], apart[2])]) == number


def test_windows_of_different_lengths_are_compared_by_their_means() -> None:
    assert taken(0.25, [(G, 0, 0), (2 * G, 0, 0)], [LENGTH, 2 * LENGTH]) == 1
    assert taken(0.25, [(G, 0, 0), (2 * G, 0, 511)], [LENGTH, 2 * LENGTH]) == 1
    assert taken(0.25, [(G, 0, 0), (2 * G, 0, 512)], [LENGTH, 2 * LENGTH]) == 2


def test_point_1_one_rest_fills_no_subset_and_no_control_set() -> None:
    """F II.B.1: a new mean "differs sufficiently from the already acquired", of both sets."""
    rest = [(G, number % 7, -(number % 5)) for number in range(100)]
    assert (taken(0.0, rest), taken(PAPER.min_distance_g, rest)) == (12, 1)


def test_it_says_after_which_sample_the_first_set_was_full() -> None:
    """The window that fills it may be one of any length; what follows changes nothing."""
    means = [ONE_SUBSET[name] for name in ALL for _ in range(2)]
    held = PaperCollector(LSB, replace(PAPER, min_distance_g=0))
    lengths = [LENGTH] * 17 + [2 * LENGTH]
    last = tuple(2 * value for value in means[-1])
    held.add(windows(lengths[:17], means[:17]))
    assert held.full_after is None
    held.add(windows(lengths, [*means[:17], last]).select(np.arange(17, 18)))
    assert held.full_after == 17 * LENGTH + 2 * LENGTH
    held.add(windows(LENGTH, means))
    assert held.full_after == 19 * LENGTH
    assert not held.fit.missing()


def test_both_sets_get_what_they_need_before_either_takes_more() -> None:
    """One point each is needed, three are taken: the first set, the second, then the first again."""
    settings = replace(PAPER, min_distance_g=0, min_subset_points=1, max_subset_points=3)
    held = PaperCollector(LSB, settings)
    made = windows(LENGTH, [ONE_SUBSET[name] for name in ALL for _ in range(7)])
    for row in range(7):
        held.add(made.select(np.arange(row, len(made), 7)))
        if row == 0:
            assert (held.fit.missing(), held.full_after) == ([], held.full_after)
            assert held.full_after is not None and held.control.missing() == ALL
        assert not held.fit.missing()
    counts = [[3] * 3] * 3
    assert (held.fit.filled(), held.control.filled()) == (counts, counts)
    roles = held.window_uses(made).role.reshape(9, 7).T.tolist()
    fit, control, neither = int(Role.FIT), int(Role.CONTROL), int(Role.NOT_TAKEN)
    order = [fit, control, fit, fit, control, control, neither]
    assert roles == [[role] * 9 for role in order]


@given(st.lists(st.tuples(*[st.integers(-1300, 1300)] * 3), max_size=60), st.sampled_from([0.0, 0.2]))
def test_windows_that_no_subset_wants_change_nothing(means: list[tuple[int, int, int]], apart: float) -> None:
    """One after the other, or all at once: those that are passed over would not have been taken."""
    settings = replace(PAPER, min_distance_g=apart)
    at_once, singly = PaperCollector(LSB, settings), PaperCollector(LSB, settings)
    made = windows(LENGTH, means)
    at_once.add(made)
    for place in range(len(means)):
        singly.add(made.select(np.arange(place, place + 1)))
    assert at_once.full_after == singly.full_after
    assert at_once.fit.filled() == singly.fit.filled()
    assert at_once.control.filled() == singly.control.filled()
    assert (at_once.window_uses(made).role == singly.window_uses(made).role).all()
