"""The log of problems: what becomes one record, in what order, how many records, whatever is taken when."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from accelcal_cli.core.recording import Problem
from accelcal_cli.formats._problems import Event, ProblemLog, text_with_count

BAD = ("bad_page", "pages left out")
GAP = ("clock_gap", "jumps ahead")


def event(kind: tuple[str, str], position: int, length: int = 1) -> Event:
    """At byte 100 times the position, before the sample of that number, of as many units as it is long."""
    return Event(position, length, *kind, 100 * position, position, length)


def texts(problems: Iterable[Problem]) -> list[str]:
    return [problem.message for problem in problems]


def logged(log: ProblemLog, events: Iterable[Event], every: int | None = None) -> list[Problem]:
    """All problems, where they are taken `every` so many positions, or at the end only."""
    problems: list[Problem] = []
    scanned = 0
    for item in events:
        while every and item.position >= scanned + every:
            scanned += every
            problems += log.take(scanned)
        log.add(item)
    return [*problems, *log.take(None)]


def overlapping() -> list[Event]:
    """A long run around short ones, two that end together, and one that goes on where another began."""
    return [
        event(BAD, 10, 40),
        event(GAP, 12),
        event(GAP, 20, 2),
        event(BAD, 50),
        event(GAP, 50),
        event(GAP, 70),
        event(BAD, 70),
    ]


def test_events_without_a_gap_between_them_are_one_record_with_their_totals() -> None:
    log = ProblemLog()
    events = [replace(event(GAP, at, 2), amount_us=1_500_000, lost_bytes=7) for at in (4, 6)]
    assert logged(log, events) == [Problem(*GAP[:1], "jumps ahead: 4 (3.000 s in all)", 400, 4, 4, 14)]
    assert texts(logged(ProblemLog(), [event(GAP, 4), event(GAP, 6)])) == ["jumps ahead: 1"] * 2


def test_kinds_with_one_code_but_different_texts_are_separate_records() -> None:
    assert texts(logged(ProblemLog(), [event(BAD, 1), event(("bad_page", "others"), 2)])) == [
        "pages left out: 1",
        "others: 1",
    ]


def test_records_come_in_the_order_of_their_beginnings() -> None:
    problems = logged(ProblemLog(), overlapping())
    assert [(problem.code, problem.sample, problem.count) for problem in problems] == [
        ("bad_page", 10, 41),
        ("clock_gap", 12, 1),
        ("clock_gap", 20, 2),
        ("clock_gap", 50, 1),
        ("clock_gap", 70, 1),
        ("bad_page", 70, 1),
    ]


def test_records_come_in_the_order_of_their_ends_by_code_where_they_end_together() -> None:
    problems = logged(ProblemLog(by_end=True), overlapping())
    assert [(problem.code, problem.sample, problem.count) for problem in problems] == [
        ("clock_gap", 12, 1),
        ("clock_gap", 20, 2),
        ("bad_page", 10, 41),
        ("clock_gap", 50, 1),
        ("bad_page", 70, 1),
        ("clock_gap", 70, 1),
    ]


@pytest.mark.parametrize("by_end", [False, True])
@pytest.mark.parametrize("every", [1, 2, 3, 7, 50])
def test_problems_do_not_depend_on_when_they_are_taken(by_end: bool, every: int) -> None:
    random = np.random.default_rng(3)
    lengths = random.integers(1, 4, 400)
    positions = np.cumsum(lengths + random.integers(0, 3, 400)) - lengths
    events = [
        event((BAD, GAP)[int(kind)], *map(int, place))
        for kind, *place in zip(random.integers(0, 2, 400), positions, lengths, strict=True)
    ]
    whole = logged(ProblemLog(single=5, by_end=by_end), events)
    assert logged(ProblemLog(single=5, by_end=by_end), pieces(events, every), every) == whole
    assert sum(problem.count for problem in whole) == lengths.sum()


def pieces(events: Iterable[Event], every: int) -> Iterable[Event]:
    """The same events as blocks of `every` positions see them: cut at the blocks' ends."""
    for item in events:
        start, stop = item.position, item.position + item.length
        cuts = [start, *range(start // every * every + every, stop, every), stop]
        for begin, end in pairwise(cuts):
            yield replace(event(item.kind, begin, end - begin), sample=begin)


@pytest.mark.parametrize("by_end", [False, True])
def test_a_run_that_may_grow_is_given_once_it_cannot(by_end: bool) -> None:
    log = ProblemLog(by_end=by_end)
    log.add(event(BAD, 1, 2))
    assert log.take(3) == ()
    log.add(event(BAD, 3, 2))
    log.add(event(GAP, 3))
    assert texts(log.take(5)) == (["jumps ahead: 1"] if by_end else [])
    assert texts(log.take(6)) == (["pages left out: 4"] + ([] if by_end else ["jumps ahead: 1"]))
    assert log.take(None) == ()


def test_one_more_record_counts_what_the_single_ones_leave_where_it_began() -> None:
    events = [event(BAD, at) for at in (1, 3, 5, 7, 9)]
    problems = logged(ProblemLog(single=2), [*events[:4], event(GAP, 8), events[4]])
    assert [(problem.message, problem.byte_offset, problem.sample) for problem in problems] == [
        ("pages left out: 1", 100, 1),
        ("pages left out: 1", 300, 3),
        ("pages left out: 3, in several places", 500, 5),
        ("jumps ahead: 1", 800, 8),
    ]
    assert texts(logged(ProblemLog(single=2), events[:3])) == ["pages left out: 1"] * 3


def test_by_end_the_record_of_all_others_comes_last_and_has_no_place() -> None:
    events = [event(BAD, at) for at in (1, 3, 5, 7, 9)]
    problems = logged(ProblemLog(single=2, by_end=True), [*events[:4], event(GAP, 8), events[4]])
    assert [(problem.message, problem.byte_offset, problem.sample) for problem in problems] == [
        ("pages left out: 1", 100, 1),
        ("pages left out: 1", 300, 3),
        ("jumps ahead: 1", 800, 8),
        ("pages left out: 3, in several places", None, 5),
    ]


@pytest.mark.parametrize("by_end", [False, True])
def test_scattered_events_are_counted_with_the_others(by_end: bool) -> None:
    events = [replace(event(BAD, at), scattered=True, count=5) for at in (1, 2, 9)]
    problems = logged(ProblemLog(by_end=by_end), [event(GAP, 0), *events, event(GAP, 12)], every=4)
    assert sorted(texts(problems)) == ["jumps ahead: 1"] * 2 + ["pages left out: 15, in several places"]


def test_problems_known_before_come_first_and_once() -> None:
    before = Problem("no_start_time", "no date", None, 0)
    log = ProblemLog([before], by_end=True)
    log.add(event(BAD, 0))
    assert log.take(1) == (before,)
    assert texts(log.take(None)) == ["pages left out: 1"]


def test_messages_are_made_of_the_whole_run() -> None:
    log = ProblemLog(describe=lambda run: f"{run.event.position}-{run.end}, {text_with_count(run)}")
    assert texts(logged(log, [event(BAD, 1, 2), event(BAD, 3)])) == ["1-4, pages left out: 3"]


def test_runs_of_places_are_single_as_long_as_records_are_left() -> None:
    log = ProblemLog(single=2)
    assert [*log.runs(BAD, np.empty(0, np.int64))] == []
    assert [*log.runs(BAD, np.array([4, 5, 6, 8]))] == [(0, 3, False), (3, 1, False)]
    log.add(event(BAD, 4, 3))
    places = np.array([8, 10, 11, 14, 20, 21])
    assert [*log.runs(BAD, places)] == [(0, 1, False), (1, 2, False), (3, 3, True)]
    assert [*log.runs(BAD, places[:4])] == [(0, 1, False), (1, 2, False), (3, 1, False)]


@pytest.mark.parametrize("by_end", [False, True])
def test_the_log_of_a_file_full_of_problems_stays_small(by_end: bool) -> None:
    log = ProblemLog(by_end=by_end)
    problems = 0
    tracemalloc.start()
    for at in range(0, 20_000, 2):
        log.add(event(BAD, at))
        problems += len(log.take(at + 2))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 20_000, "two bytes an event"
    assert problems + len(log.take(None)) == 100
