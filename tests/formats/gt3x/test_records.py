"""Records of log.bin are found one behind the other, whatever their lengths are."""

from __future__ import annotations

from itertools import accumulate, pairwise

from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.formats.gt3x.records import ALIKE, FRAME_BYTES, TOGETHER, walk
from tests.formats.make_gt3x import record

NUMBERS = [1, 2, ALIKE, ALIKE + 1, ALIKE + TOGETHER + 3]
RUNS = st.lists(st.tuples(st.sampled_from([0, 1, 2, 300]), st.sampled_from(NUMBERS)), max_size=5)


def places(runs: list[tuple[int, int]]) -> tuple[bytes, list[int]]:
    """Records of so many bytes of payload, so many of each length in a row, and where each begins."""
    sizes = [size for size, number in runs for _ in range(number)]
    ends = accumulate((FRAME_BYTES + size for size in sizes), initial=0)
    return b"".join(record(26, size, bytes(size)) for size in sizes), list(ends)


@given(RUNS, st.data())
def test_up_to_what_is_no_record(runs: list[tuple[int, int]], data: st.DataObject) -> None:
    """A separator that is another byte ends the walk, as does a record that is cut off."""
    log, begins = places(runs)
    first = data.draw(st.integers(0, len(begins) - 1))
    wrong = data.draw(st.integers(first, len(begins) - 1))
    spoiled = log[: begins[wrong]] + b"\0" + log[begins[wrong] + 1 :]
    assert walk(spoiled, begins[first], len(log) + 1) == (begins[first:wrong], begins[wrong])
    cut = data.draw(st.integers(begins[wrong], max(begins[wrong], len(log) - 1)))
    whole = [begin for begin, end in pairwise(begins) if end <= cut]
    assert walk(log[:cut], 0, len(log) + 1) == (whole, begins[len(whole)])


@given(RUNS, st.integers(1, 600))
def test_no_more_than_are_wanted(runs: list[tuple[int, int]], most: int) -> None:
    log, begins = places(runs)
    taken = min(most, len(begins) - 1)
    assert walk(log, 0, most) == (begins[:taken], begins[taken])
