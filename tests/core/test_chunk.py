"""Parts of chunks: whatever is cut, masked and joined gives the rows of the whole."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.clock import Clock, PageClock, StampClock, UniformClock
from accelcal_cli.core.recording import (
    CHANNELS,
    Chunk,
    OtherColumn,
    Problem,
    Validity,
    cut_channels,
    joined,
    joined_channels,
    others_as,
    uniquely_named,
)

PAGE_ROWS = 7
CLOCKS = st.sampled_from(["uniform", "stamps", "pages"])
CUTS = st.lists(st.integers(1, 40), max_size=5)
ROWS = st.integers(0, 40)


def clock_of(kind: str, rows: int) -> Clock:
    """One that differs from row to row."""
    if kind == "uniform":
        return UniformClock(1_000, 5, Fraction(857, 10))
    if kind == "stamps":
        return StampClock(np.arange(rows, dtype=np.int64) ** 2)
    first = np.arange(0, max(rows, 1), PAGE_ROWS, dtype=np.int64)
    return PageClock(first, first * 1_001, np.full(len(first), PAGE_ROWS), np.full(len(first), 7_003))


def whole_chunk(rows: int, clock: str, breaks: set[int], *, channels: bool = True) -> Chunk:
    """So many rows, of which no two are equal."""
    counts = np.arange(3 * rows, dtype=np.int16).reshape(rows, 3)
    return Chunk(
        100,
        counts,
        clock_of(clock, rows),
        5_000,
        breaks=np.array(sorted(row for row in breaks if row < rows), np.int64),
        clock_jumps=np.array(sorted(row for row in breaks if row < rows and row % 2), np.int64),
        temperature_mc=counts[:, 0].astype(np.int32) if channels else None,
        gyro_counts=-counts if channels else None,
        others=counts[:, :2].astype(np.float32) if channels else None,
        validity=(counts[:, 1] % 4).astype(np.uint8) if channels else None,
        problems=(Problem("truncated", "cut off", None, 100),),
        used_bytes=6 * rows,
    )


def assert_same(one: Chunk, other: Chunk) -> None:
    """All that two chunks say."""
    assert one.time_us.tolist() == other.time_us.tolist()
    assert one.breaks.tolist() == other.breaks.tolist()
    assert one.clock_jumps.tolist() == other.clock_jumps.tolist()
    for name in CHANNELS:
        first, second = getattr(one, name), getattr(other, name)
        assert (first is None) == (second is None), name
        if first is not None and second is not None:
            assert first.dtype == second.dtype and first.tolist() == second.tolist(), name
    assert (one.first_sample, one.end_byte) == (other.first_sample, other.end_byte)
    assert (one.problems, one.used_bytes) == (other.problems, other.used_bytes)


@given(ROWS, CLOCKS, st.sets(st.integers(0, 39)), CUTS, st.booleans())
def test_parts_joined_are_the_whole(
    rows: int, clock: str, breaks: set[int], cuts: list[int], channels: bool
) -> None:
    whole = whole_chunk(rows, clock, breaks, channels=channels)
    edges = [0, *sorted(cut for cut in cuts if cut <= rows), rows]
    parts = [whole.part(low, high) for low, high in pairwise(edges)]
    assert_same(joined(parts), whole)
    assert [part.first_sample for part in parts[1:]] == [100 + low for low in edges[1:-1]]


@given(ROWS, CLOCKS, ROWS, ROWS)
def test_a_part_has_the_times_of_its_rows(rows: int, clock: str, one: int, other: int) -> None:
    low, high = sorted((min(one, rows), min(other, rows)))
    whole = whole_chunk(rows, clock, set())
    part = whole.part(low, high)
    assert part.time_us.tolist() == whole.time_us[low:high].tolist()
    middle = (high - low) // 2
    assert part.part(middle, high - low).time_us.tolist() == whole.time_us[low + middle : high].tolist()


@given(ROWS, CLOCKS, ROWS, ROWS, ROWS)
def test_a_part_of_two_joined_chunks_has_the_times_of_its_rows(
    rows: int, clock: str, cut: int, one: int, other: int
) -> None:
    whole, cut = whole_chunk(rows, clock, set()), min(cut, rows)
    low, high = sorted((min(one, rows), min(other, rows)))
    both = joined([whole.part(0, cut), whole.part(cut, rows)])
    assert both.part(low, high).time_us.tolist() == whole.time_us[low:high].tolist()
    assert both.clock.times(low, high).tolist() == whole.time_us[low:high].tolist()


def test_a_part_is_a_view_and_a_copy_is_not() -> None:
    whole = whole_chunk(20, "stamps", {3})
    part, copy = whole.part(2, 9), whole.part(2, 9).copy()
    assert_same(part, copy)
    for name in CHANNELS:
        assert np.shares_memory(getattr(part, name), getattr(whole, name))
        assert not np.shares_memory(getattr(copy, name), getattr(whole, name))
    assert np.shares_memory(part.time_us, whole.time_us)
    assert not np.shares_memory(copy.time_us, whole.time_us)


@given(CLOCKS, st.sets(st.integers(0, 39)), st.lists(st.booleans(), max_size=40))
def test_rows_of_a_mask_break_where_a_row_is_left_out(clock: str, breaks: set[int], mask: list[bool]) -> None:
    whole, keep = whole_chunk(len(mask), clock, breaks), np.array(mask, np.bool_)
    kept = whole.keep(keep)
    numbers = np.flatnonzero(keep).tolist()
    assert kept.time_us.tolist() == whole.time_us[keep].tolist()
    for name in CHANNELS:
        assert getattr(kept, name).tolist() == getattr(whole, name)[keep].tolist()
    before = [-1, *numbers]
    expected = [
        index
        for index, row in enumerate(numbers)
        if row != before[index] + 1 or any(before[index] < at <= row for at in breaks)
    ]
    assert kept.breaks.tolist() == expected
    assert not len(kept.clock_jumps)
    assert kept.is_fresh == (expected[:1] == [0])
    assert kept.problems == whole.problems and kept.used_bytes == whole.used_bytes


def test_a_channel_that_one_chunk_lacks_is_left_out_and_its_validity_is_measured() -> None:
    full, bare = whole_chunk(3, "uniform", set()), whole_chunk(2, "uniform", set(), channels=False)
    for chunks in ([full, bare], [bare, full]):
        both = joined(chunks)
        assert both.temperature_mc is None and both.gyro_counts is None
        validity = [1, 0, 3, *[Validity.MEASURED] * 2] if chunks[0] is full else [0, 0, 1, 0, 3]
        assert both.validity is not None and both.validity.tolist() == validity
        assert both.validity.dtype == np.uint8


def test_a_chunk_without_rows_takes_no_channel_away() -> None:
    full, empty = whole_chunk(3, "uniform", set()), whole_chunk(0, "uniform", set(), channels=False)
    both = joined([empty, full])
    assert both.temperature_mc is not None and len(both) == 3
    assert len(both.problems) == 2


@pytest.mark.parametrize("name", CHANNELS)
def test_every_channel_is_a_column_of_a_chunk(name: str) -> None:
    assert name in Chunk.__dataclass_fields__


def test_channels_are_cut_and_joined_whole() -> None:
    channels = {"temperature_mc": np.arange(5, dtype=np.int32), "gyro_counts": np.arange(15).reshape(5, 3)}
    first, rest = cut_channels(channels, slice(2)), cut_channels(channels, np.arange(5) >= 2)
    assert rest["gyro_counts"].tolist() == [[6, 7, 8], [9, 10, 11], [12, 13, 14]]
    both = joined_channels((first, rest))
    assert {name: values.tolist() for name, values in both.items()} == {
        name: values.tolist() for name, values in channels.items()
    }
    assert both["temperature_mc"].dtype == np.int32
    assert list(joined_channels((first, {"gyro_counts": rest["gyro_counts"]}))) == ["gyro_counts"]


def test_other_quantities_of_a_part_get_the_columns_of_the_whole() -> None:
    light, battery, button = (OtherColumn(name, "V") for name in ("light", "battery", "button"))
    chunk = whole_chunk(3, "uniform", set())
    found = others_as(chunk, (light, battery), (button, battery, light)).others
    assert found is not None and np.isnan(found[:, 0]).all()
    assert found[:, 1:].tolist() == chunk.others[:, ::-1].tolist()
    assert others_as(chunk, (light, battery), (light, battery)) is chunk
    bare = whole_chunk(3, "uniform", set(), channels=False)
    assert others_as(bare, (), (light,)) is bare


def test_columns_of_one_name_are_numbered() -> None:
    names = ["light", "light", "battery", "light_2", "light"]
    found = uniquely_named(OtherColumn(name, "lux") for name in names)
    assert [one.name for one in found] == ["light", "light_2", "battery", "light_2_2", "light_3"]
