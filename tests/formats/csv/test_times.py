"""Kinds of times, shared stamps, gaps and jumps."""

from __future__ import annotations

import bz2
import gzip
import lzma
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.formats.tables import PARQUET
from accelcal_cli.formats.tables.text import lines as csv_lines
from accelcal_cli.formats.tables.text import source as csv_reader
from tests.formats.make_csv import START_US, read, stamp, written
from tests.formats.reading import Read, read_all

SECOND = 1_000_000


def with_times(folder: Path, cells: list[str], name: str = "time", **options: object) -> Read:
    """Write a file of these times and a resting sensor."""
    text = "".join(f"{cell},0,0,1\n" for cell in cells)
    return read(written(folder, f"{name},x,y,z\n{text}"), **options)


def after_start(found: Read) -> list[int]:
    return (found.times - START_US).tolist()


@pytest.mark.parametrize(
    ("form", "zone"),
    [
        ("2024-03-04T00:00:00.{:02d}", None),
        ("2024-03-04 00:00:00.{:02d}", None),
        ("2024-03-04 00:00:00.{:02d}0000", None),
        ("2024-03-04 00:00:00.{:02d}0000499", None),
        ("2024-03-04 00:00:00.{:02d}0000000000000000", None),
        ("2024/03/04 00:00:00.{:02d}", None),
        ("2024-03-04T00:00:00.{:02d}Z", "UTC"),
        ("2024-03-04T01:00:00.{:02d}+01:00", "UTC"),
        ("2024-03-03T19:00:00.{:02d}-0500", "UTC"),
        ("1709510400.{:02d}", "UTC"),
        ("1709510400{:02d}0", "UTC"),
        ("1709510400{:02d}0.0", "UTC"),
        ("1709510400{:02d}0000", "UTC"),
        ("1709510400{:02d}0000000", "UTC"),
        ("2024-03-04 00:00:00:{:02d}0", None),
        ("2024-03-04 00:00:00:{:02d}00", None),
    ],
)
def test_ways_to_write_a_time(tmp_path: Path, form: str, zone: str | None) -> None:
    found = with_times(tmp_path, [form.format(row) for row in range(90)])
    assert after_start(found) == [row * 10_000 for row in range(90)]
    assert found.recording.rate_hz == 100.0
    assert found.recording.timezone == zone
    assert found.recording.start_us == START_US


def test_the_users_zone_is_kept_for_local_times(tmp_path: Path) -> None:
    cells = [stamp(row * 10_000) for row in range(9)]
    assert with_times(tmp_path, cells, timezone="Europe/Berlin").recording.timezone == "Europe/Berlin"


def test_fractions_may_be_left_out_where_they_are_zero(tmp_path: Path) -> None:
    cells = ["2024-03-04 00:00:00", "2024-03-04 00:00:00.5", "2024-03-04 00:00:01", "2024-03-04 00:00:01.5"]
    assert after_start(with_times(tmp_path, cells)) == [0, 500_000, SECOND, 1_500_000]


@pytest.mark.parametrize(
    ("name", "step", "us"),
    [
        ("time", 0.01, SECOND),
        ("time", 10, 1000),
        ("time", 10_000, 1),
        ("time [s]", 1, SECOND),
        ("time (ms)", 1, 1000),
        ("time_ms", 0.5, 1000),
        ("seconds", 2, SECOND),
        ("Time since start in ms ", 10, 1000),
        ("time_ns", 10**7, 0.001),
    ],
)
def test_times_from_the_start_of_the_recording(tmp_path: Path, name: str, step: float, us: float) -> None:
    found = with_times(tmp_path, [f"{row * step:.2f}" for row in range(20)], name)
    assert found.times.tolist() == [round(row * step * us) for row in range(20)]
    assert found.recording.start_us is None
    assert found.codes == ["no_start_time"]


@pytest.mark.parametrize(("ago", "step"), [(1_234_567_890, 10), (987_654_321_000_000, 10_000_000)])
def test_a_phone_that_ran_for_weeks_is_not_taken_for_a_date(tmp_path: Path, ago: int, step: int) -> None:
    """Times count ms or ns since the phone was switched on, or the next unit since 1970."""
    cells = [str(ago + row * step) for row in range(12)]
    with pytest.raises(UnreadableError, match="may be seconds or milliseconds; give the right --rate"):
        with_times(tmp_path, cells, "timestamp")
    found = with_times(tmp_path, cells, "timestamp", rate_hz=100.0)
    assert np.diff(found.times).tolist() == [10_000] * 11
    assert found.codes == ["no_start_time"]


def test_a_rate_that_contradicts_the_times_is_refused(tmp_path: Path) -> None:
    cells = [stamp(row * 10_000) for row in range(20)]
    with pytest.raises(UnreadableError, match="its times say 100 Hz, not 30 Hz"):
        with_times(tmp_path, cells, rate_hz=30.0)
    assert with_times(tmp_path, cells, rate_hz=102.4).recording.rate_hz == 102.4


@pytest.mark.parametrize(("rate_hz", "noted"), [(99.5, True), (100.9, True), (100.05, False)])
def test_a_rate_that_is_nearly_that_of_the_times_is_used_and_noted(
    tmp_path: Path, rate_hz: float, noted: bool
) -> None:
    found = with_times(tmp_path, [stamp(row * 10_000) for row in range(1000)], rate_hz=rate_hz)
    assert found.recording.rate_hz == rate_hz
    said = f"its times say 100 Hz; the {rate_hz:g} Hz that were given are used"
    assert (said in found.recording.notes) == noted


@pytest.mark.parametrize("rate_hz", [98.5, 101.2, 102.4])
def test_a_rate_that_is_off_by_more_than_a_hundredth_is_refused(tmp_path: Path, rate_hz: float) -> None:
    """Twenty rows do not show that for certain; a thousand do."""
    with pytest.raises(UnreadableError, match=f"its times say 100 Hz, not {rate_hz:g} Hz"):
        with_times(tmp_path, [stamp(row * 10_000) for row in range(1000)], rate_hz=rate_hz)


def test_without_times_rows_are_counted_at_the_rate(tmp_path: Path) -> None:
    path = written(tmp_path, "x,y,z\n" + "0,0,1\n" * 31)
    with pytest.raises(UnreadableError, match="-R time_column=NAME, or give the sampling rate with --rate"):
        read(path)
    found = read(path, 7, rate_hz=30.0)
    assert found.times.tolist() == [(row * SECOND + 15) // 30 for row in range(31)]
    assert found.codes == ["no_start_time"]
    assert found.recording.start_us is None


def test_uneven_stamps_are_used_as_given(tmp_path: Path) -> None:
    steps = [0, 33, 67, 100, 133, 133, 167, 200]
    found = with_times(tmp_path, [stamp(step * 1000) for step in steps])
    assert after_start(found) == [step * 1000 for step in steps]
    assert found.breaks == []


def test_gaps_and_steps_back_are_breaks(tmp_path: Path) -> None:
    """A step of three periods is not a gap yet."""
    steps = [*range(20), *range(23, 40), *range(35, 60), *range(70, 90), *range(92, 99)]
    found = with_times(tmp_path, [stamp(step * 10_000) for step in steps])
    assert found.breaks == [20, 37, 62]
    assert found.codes == ["clock_gap", "clock_back", "clock_gap"]
    assert [problem.sample for problem in found.problems] == [20, 37, 62]
    assert found.problems[0].told == "the time jumps ahead by 0.04 s, before line 22"
    assert found.problems[1].told == "the time goes back by 0.04 s, before line 39"


def test_whole_seconds_are_spread_evenly(tmp_path: Path) -> None:
    groups = [7, 10, 10, 9, 10, 11, 10, 4]
    cells = [stamp(second * SECOND)[:19] for second, size in enumerate(groups) for _ in range(size)]
    found = with_times(tmp_path, cells)
    begin = [300_000 + row * 100_000 for row in range(7)]
    middle = [
        second * SECOND + (2 * row * SECOND + size) // (2 * size)
        for second, size in enumerate(groups[1:-1], 1)
        for row in range(size)
    ]
    end = [7 * SECOND + row * 100_000 for row in range(4)]
    assert after_start(found) == begin + middle + end
    assert found.recording.rate_hz == 10.0
    assert found.recording.start_us == START_US + 300_000
    assert (found.breaks, found.problems) == ([], [])


def test_whole_seconds_around_a_gap(tmp_path: Path) -> None:
    sizes = {0: 10, 1: 10, 2: 10, 3: 6, 8: 4, 9: 10, 10: 10}
    cells = [stamp(second * SECOND)[:19] for second, size in sizes.items() for _ in range(size)]
    found = with_times(tmp_path, cells)
    times = after_start(found)
    assert times[30:36] == [3 * SECOND + row * 100_000 for row in range(6)]
    assert times[36:40] == [8 * SECOND + row * 100_000 for row in range(6, 10)]
    assert found.breaks == [36]
    assert found.codes == ["clock_gap"]


def test_stamps_shared_by_minutes_and_by_batches(tmp_path: Path) -> None:
    minutes = [stamp(minute * 60 * SECOND)[:16] for minute in range(5) for _ in range(120)]
    found = with_times(tmp_path, minutes)
    assert found.recording.rate_hz == 2.0
    assert after_start(found) == [row * 500_000 for row in range(600)]
    batches = [stamp(batch * 80_000) for batch in range(20) for _ in range(4)]
    assert after_start(with_times(tmp_path, batches)) == [row * 20_000 for row in range(80)]


@pytest.mark.parametrize("piece", [1, 37, 400, 5000])
@pytest.mark.parametrize("chunk_samples", [1, 5, 64, 1000])
def test_spreading_and_gaps_do_not_depend_on_blocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, piece: int, chunk_samples: int
) -> None:
    sizes = [7, 10, 10, 3, 10, 95, 10, 0, 0, 10, 10, 1, 10, 10, 4]
    cells = [stamp(second * SECOND)[:19] for second, size in enumerate(sizes) for _ in range(size)]
    cells[50:52] = ["", ""]
    cells[0] = ""
    whole = with_times(tmp_path, cells)
    assert {"clock_gap", "clock_back", "missing_value"} <= set(whole.codes)
    monkeypatch.setattr(csv_lines, "PIECE_BYTES", piece)
    assert with_times(tmp_path, cells, chunk_samples=chunk_samples).same_as(whole)


def test_a_stopped_clock_asks_for_the_rate(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match=r"found from the times of its rows: .*50; give it with --rate"):
        with_times(tmp_path, [stamp(0)] * 50)
    found = with_times(tmp_path, [stamp(0)] * 20, rate_hz=30.0)
    assert np.array_equal(np.diff(found.times) // 1000, np.full(19, 33))


@pytest.mark.parametrize("block_bytes", [30, 60, 100, 1 << 20])
def test_problems_come_in_the_order_of_their_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block_bytes: int
) -> None:
    """A jump ends with the next good row, however many bad ones are between."""
    lines = [f"{row * 0.1 + (5 if row >= 40 else 0):.1f},0,0,1" for row in range(100)]
    lines[41] = lines[42] = "9.1,,0,1"
    lines[43] = lines[44] = "9.3,77777,0,1"
    lines[60:70] = [line.replace(",0,1", ",,1") for line in lines[60:70]]
    lines[62] = "11.2,77777,0,1"
    lines[98], lines[99] = "3,0,0,1", "14.9,0,,1"
    monkeypatch.setattr(csv_reader, "BLOCK_BYTES", block_bytes)
    found = read(written(tmp_path, "time,x [g],y [g],z [g]\n" + "\n".join(lines) + "\n"))
    assert [(problem.code, problem.count) for problem in found.problems] == [
        ("no_start_time", 1),
        ("missing_value", 2),
        ("clock_gap", 1),
        ("out_of_range", 2),
        ("missing_value", 2),
        ("out_of_range", 1),
        ("missing_value", 7),
        ("missing_value", 1),
        ("clock_back", 1),
    ]


def test_a_z_can_be_overruled_by_force_and_an_offset_cannot(tmp_path: Path) -> None:
    cells = [stamp(row * 10_000) for row in range(9)]
    zone = {"timezone": "Europe/Berlin", "force_timezone": True}
    forced = with_times(tmp_path, [cell + "Z" for cell in cells], **zone).recording
    assert (forced.timezone, forced.start_us) == ("Europe/Berlin", START_US)
    with pytest.raises(UsageError, match="-R force_timezone cannot replace"):
        with_times(tmp_path, [cell + "+05:00" for cell in cells], **zone)


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        ("10000-01-01", None),
        ("9e11", None),
        ("yesterday", None),
        ("2024-03-04T00:00:00Z", "some times have a zone"),
    ],
)
@pytest.mark.parametrize("line", [2, 3, 9, 150])
def test_t17_an_odd_time_is_named_by_its_line(
    tmp_path: Path, cell: str, message: str | None, line: int
) -> None:
    """Blank lines count; the first row is blamed only where it is the odd one."""
    rows = [f"{stamp(20_000 * k)},0.{k % 7},0.1,0.9" for k in range(170)]
    lines = ["time,x,y,z", *rows[:5], "", *rows[5:]]
    lines[line - 1] = f"{cell},0.1,0.2,0.3"
    path = written(tmp_path, "\n".join(lines) + "\n")
    if message is None:
        found = read(path)
        assert len(found.counts) == 169
        assert line == 2 or found.problems[0].place == f"from line {line} on"
    else:
        with pytest.raises(UnreadableError, match=message) as caught:
            read(path)
        assert caught.value.line == line


@pytest.mark.parametrize("pack", [bytes, gzip.compress, bz2.compress, lzma.compress])
@pytest.mark.parametrize("end", ["\n", ""])
@pytest.mark.parametrize(
    ("head", "cells"),
    [
        ("time,x,y,z", [stamp(row * 40_000) for row in range(400)]),
        ("# a logger's\ntime (s),x,y,z", [f"{row / 25:.2f}" for row in range(400)]),
        ("t,x,y,z", [str(row * 40) for row in range(400)]),  # of no stated unit
        ("time,x,y,z", [stamp(row // 25 * SECOND)[:19] for row in range(400)]),
    ],
)
def test_a_table_that_begins_with_its_newest_row_is_turned_over(
    tmp_path: Path, pack: Callable[[bytes], bytes], end: str, head: str, cells: list[str]
) -> None:
    """However it is packed and named, and with or without an end of its last line."""
    lines = [f"{cell},0.1,0.{row % 7},0.9" for row, cell in enumerate(cells)]
    path = written(tmp_path, pack(("\n".join([head, *reversed(lines)]) + end).encode()))
    for options in ({}, {"rate_hz": 25.0}):
        with pytest.raises(UnreadableError, match="newest first") as found:
            read(path, **options)
    command = found.value.hint.partition(": ")[2]
    subprocess.run(["bash", "-c", command], cwd=tmp_path, check=True)
    assert (tmp_path / "sorted.csv").read_text() == "\n".join([head, *lines, ""])
    assert read(tmp_path / "sorted.csv").recording.rate_hz == 25.0


def test_a_frame_of_arrow_that_begins_with_its_newest_row_is_refused(tmp_path: Path) -> None:
    times = pa.array(np.arange(400)[::-1] * 40_000 + START_US).cast(pa.timestamp("us"))
    axes = {axis: np.full(400, 0.57) for axis in "xyz"}
    pq.write_table(pa.table({"time": times, **axes}), tmp_path / "a.parquet")
    with pytest.raises(UnreadableError, match="newest first") as found:
        read_all(tmp_path / "a.parquet", PARQUET, 1000)
    assert (found.value.hint or "").startswith("sort its rows by time, the oldest first (in pandas:")
