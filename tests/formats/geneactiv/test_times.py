"""Times of GENEActiv pages: coarse stamps, true rates, jumps, resets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.formats.geneactiv.oracle import page_times
from tests.formats.geneactiv.test_damage import read
from tests.formats.geneactiv.test_geneactiv import opened, random_counts, times_of
from tests.formats.make_geneactiv import START_US, Page, header, pages, stamp, written

COUNTS = random_counts(6000)
SECOND = 1_000_000


def floored(page: Page, unit_us: int) -> Page:
    return replace(page, time_us=page.time_us // unit_us * unit_us)


@pytest.mark.parametrize(
    ("told", "rate_hz", "half_seconds"),
    [("85.7", 600 / 7, 7), ("66.7", 200 / 3, 9), ("33.3", 100 / 3, 18), ("75.0", 75, 8), ("10.0", 10, 60)],
)
def test_a_page_lasts_whole_half_seconds(
    tmp_path: Path, told: str, rate_hz: float, half_seconds: int
) -> None:
    content = [
        Page(COUNTS[300 * k : 300 * k + 300], k, START_US + k * half_seconds * SECOND // 2, rate=told)
        for k in range(20)
    ]
    chunks, breaks, problems = read(written(tmp_path / "a.bin", content, header(rate=told, pages=20)))
    assert not breaks and not problems
    exact = START_US + np.arange(6000) * 1e6 / rate_hz
    assert np.abs(times_of(chunks) - exact).max() <= 1


@pytest.mark.parametrize("unit_us", [500_000, SECOND])
def test_stamps_without_fractions_do_not_make_the_samples_uneven(tmp_path: Path, unit_us: int) -> None:
    content = [
        replace(page, time_us=START_US + 4_500_000 * k, rate="66.7") for k, page in enumerate(pages(COUNTS))
    ]
    content = [floored(page, unit_us) for page in content]
    chunks, breaks, problems = read(written(tmp_path / "a.bin", content))
    assert not breaks and not problems
    steps = np.diff(times_of(chunks))
    assert steps.min() == 15_000 and steps.max() == 15_000


@pytest.mark.parametrize("faster", [0.995, 1.003])
def test_a_rate_off_the_nominal_one_is_followed(tmp_path: Path, faster: float) -> None:
    """Stamps to the millisecond of a device whose samples come faster or slower than it says."""
    counts = random_counts(30_000)
    step_us = 20_000 / faster
    content = [
        replace(page, time_us=round(START_US + 300 * k * step_us)) for k, page in enumerate(pages(counts))
    ]
    chunks, breaks, problems = read(written(tmp_path / "a.bin", content))
    assert not breaks and not problems
    off = times_of(chunks) - START_US - step_us * np.arange(30_000)
    assert np.abs(off[:-300]).max() <= 2_000


@pytest.mark.parametrize(
    "name", ["geneactiv_66hz_22min.bin", "geneactiv_85hz_1min.bin", "geneactiv_sample.bin"]
)
def test_real_times_keep_to_the_stamps_and_never_go_back(real_data: Path, name: str) -> None:
    path = real_data / "vendor" / name
    times = times_of(list(opened(path).chunks(7000)))
    stamps = np.array(page_times(path)) * 1e6
    unit_us = 500_000 if (stamps % SECOND).any() else SECOND
    begins = times[::300]
    assert np.abs(begins - stamps).max() <= unit_us
    steps = np.diff(times)
    assert steps.min() > 0 and steps.max() - steps.min() <= 1


def test_a_jump_of_the_clock_is_a_gap(tmp_path: Path) -> None:
    late = [
        replace(page, time_us=page.time_us + 36_000 * SECOND * (page.sequence >= 4)) for page in pages(COUNTS)
    ]
    chunks, breaks, problems = read(written(tmp_path / "a.bin", late))
    assert breaks == [1200]
    assert [(code, sample) for code, _, sample, _ in problems] == [("clock_gap", 1200)]
    times = times_of(chunks)
    assert times[1200] == late[4].time_us
    assert times[1199] == START_US + 1199 * 20_000


def test_a_step_back_is_reported_and_the_samples_kept(tmp_path: Path) -> None:
    back = [
        replace(page, time_us=page.time_us - 3600 * SECOND * (page.sequence >= 4)) for page in pages(COUNTS)
    ]
    path = written(tmp_path / "a.bin", back)
    chunks, breaks, problems = read(path)
    assert breaks == [1200]
    assert [(code, sample) for code, _, sample, _ in problems] == [("clock_back", 1200)]
    assert opened(path).recording.duration_s is None
    assert times_of(chunks)[1200] == back[4].time_us
    assert sum(map(len, chunks)) == 6000


def test_leading_zeros_may_be_missing(tmp_path: Path) -> None:
    first = Page(COUNTS[:300], 0, time="2024-3-4 0:00:00:500")
    second = Page(COUNTS[300:600], 1, time="2024-3-4 0:0:6:500")
    chunks, breaks, problems = read(written(tmp_path / "a.bin", [first, second]))
    assert not breaks and not problems
    assert (times_of(chunks) == START_US + 20_000 * np.arange(600)).all()


@pytest.mark.parametrize("time", ["2024-02-30", "2024-13-01", "2024-00-10", "2024-01-00"])
def test_a_day_that_does_not_exist_is_no_time(tmp_path: Path, time: str) -> None:
    content = pages(COUNTS)
    content[5] = replace(content[5], time=f"{time} 00:00:00:000")
    _, breaks, problems = read(written(tmp_path / "a.bin", content))
    assert breaks == [1500]
    assert [(code, count) for code, _, _, count in problems] == [("bad_page", 1)]


@pytest.mark.parametrize("key", ["configured", "start"])
def test_after_a_reset_the_times_are_those_of_the_pages(tmp_path: Path, key: str) -> None:
    head = header(pages=20, **{key: "2010-09-16 09:08:54:000"})
    reader = opened(written(tmp_path / "a.bin", pages(COUNTS), head))
    assert reader.recording.start_us == START_US
    assert reader.recording.notes == (
        "the header's times are those of a device that was reset; the times are those of the pages",
    )


def test_a_clock_that_was_reset_gives_no_start_time(tmp_path: Path) -> None:
    reset_us = 1_284_628_134 * SECOND
    assert stamp(reset_us) == "2010-09-16 09:08:54:000"
    content = [replace(page, time_us=page.time_us - START_US + reset_us) for page in pages(COUNTS)]
    path = written(tmp_path / "a.bin", content)
    chunks, breaks, problems = read(path)
    assert opened(path).recording.start_us is None
    assert [code for code, *_ in problems] == ["no_start_time"]
    assert not breaks
    assert (np.diff(times_of(chunks)) == 20_000).all()
