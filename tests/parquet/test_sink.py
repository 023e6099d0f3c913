"""The sink and the source: schema, metadata, and bytes that do not depend on portions or threads."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from accelcal_cli.core.clock import Clock, StampClock
from accelcal_cli.core.errors import OutputError
from accelcal_cli.core.gyroscope import Bias, Gyroscope
from accelcal_cli.core.recording import Chunk, Recording
from accelcal_cli.core.results import Facts, SampleCounts
from accelcal_cli.output.columns import NO_RATE, NO_TEMPERATURE_MC, recording_columns, schema_of
from accelcal_cli.output.files import refuse_foreign, written_by_us
from accelcal_cli.parquet import Column, Memory, Numbers, ParquetSink, pages, sink
from accelcal_cli.parquet.pages import PAGE_ROWS


def arrays(number: int, *, temperature: bool = True, gyroscope: bool = True) -> list[np.ndarray]:
    """Times, and what else a sink takes: temperatures in thousandths of a degree, rates in counts."""
    random = np.random.RandomState(3)
    held = [1_700_000_000_000_000 + 10_000 * np.arange(number, dtype=np.int64)]
    held += [random.randn(number).astype(np.float32) for _ in range(3)]
    if temperature:
        held.append(np.repeat(np.int32(30_500), number))
    if gyroscope:
        held += [random.randint(-(1 << 15), 1 << 15, number) for _ in range(3)]
    return [*held, random.randint(0, 4, number).astype(np.uint8)]


def columns(*, temperature: bool, gyroscope: bool, utc: bool) -> list[Column]:
    facts = Facts(
        samples=0, first_us=None, last_us=None, rate_hz=None, gaps=(), gaps_omitted=0, problems=(),
        counts=SampleCounts(), has_temperature=temperature, has_gyroscope=gyroscope,
        utc_offset_s=3600 if utc else None,
    )  # fmt: skip
    recording = Recording(Path("a"), "csv", 100.0, 256.0, 0, gyro_dps_per_lsb=(0.1, 0.2, 0.3))
    return recording_columns(recording, facts)


@dataclass(frozen=True)
class Arrays:
    """Rows as a sink stores them."""

    clock: Clock
    arrays: list[np.ndarray]

    def __len__(self) -> int:
        return len(self.arrays[0])

    def part(self, start: int, stop: int) -> Arrays:
        return Arrays(self.clock.part(start, stop), [array[start:stop] for array in self.arrays])


def copied(rows: Arrays, memory: Memory) -> int:
    for (_, free), array in zip(memory, rows.arrays, strict=True):
        free[:] = array
    return len(rows)


def write(
    path: Path, kept: list[Column], held: list[np.ndarray], edges: list[int], threads: int = 2
) -> list[list[int]]:
    """Write rows from edge to edge; returns the rows of each portion, group by group."""
    with ParquetSink(path, path, kept, schema_of(kept, {"a": 1}), threads) as target:
        rows = Arrays(StampClock(held[0]), held[1:])
        portions = (rows.part(start, stop) for start, stop in itertools.pairwise(edges))
        filled = list(target.write(portions, copied))
        target.close()
    assert sum(map(sum, filled)) == edges[-1]
    return filled


def test_columns_types_units_and_metadata(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    write(path, columns(temperature=True, gyroscope=True, utc=False), arrays(10), [0, 10])
    schema = pq.read_schema(path)
    assert schema.names == ["time", "x", "y", "z", "temperature", "gx", "gy", "gz", "validity"]
    assert schema.field("time").type == pa.timestamp("us")
    assert [schema.field(name).type for name in ("x", "temperature", "gz")] == [pa.float32()] * 3
    assert schema.field("validity").type == pa.uint8()
    assert schema.field("x").metadata[b"unit"] == b"g"
    assert json.loads(schema.metadata[b"accelcal"]) == {"a": 1}


def test_a_known_zone_makes_the_times_utc(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    kept = columns(temperature=False, gyroscope=False, utc=True)
    write(path, kept, arrays(3, temperature=False, gyroscope=False), [0, 3])
    assert pq.read_schema(path).field("time").type == pa.timestamp("us", "UTC")


def test_pandas_reads_the_same_values(tmp_path: Path) -> None:
    path, held = tmp_path / "a.parquet", arrays(1000)
    write(path, columns(temperature=True, gyroscope=True, utc=False), held, [0, 1000])
    frame = pd.read_parquet(path)
    assert (frame["time"].to_numpy("datetime64[us]").astype(np.int64) == held[0]).all()
    assert (frame["x"].to_numpy() == held[1]).all()
    assert (frame["temperature"].to_numpy() == np.float32(30.5)).all()
    assert (frame["gy"].to_numpy() == (held[6] * 0.2).astype(np.float32)).all()
    assert (frame["validity"].to_numpy() == held[-1]).all()


@given(st.lists(st.integers(0, 5000), max_size=6))
@settings(max_examples=8, deadline=None)
def test_the_bytes_do_not_depend_on_portions_or_threads(cuts: list[int]) -> None:
    import tempfile

    held = arrays(5000)
    kept = columns(temperature=True, gyroscope=True, utc=False)
    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as name:
        patch.setattr(sink, "ROW_GROUP_ROWS", 1024)
        write(Path(name) / "a", kept, held, [0, 5000])
        write(Path(name) / "b", kept, held, [0, *sorted(cuts), 5000])
        for threads in (1, 3, 16):
            write(Path(name) / str(threads), kept, held, [0, *sorted(cuts), 5000], threads=threads)
        assert len({path.read_bytes() for path in Path(name).iterdir()}) == 1


def test_rows_without_temperature_or_rates_have_none(tmp_path: Path) -> None:
    path, held = tmp_path / "a.parquet", arrays(1000)
    held[4][300:] = NO_TEMPERATURE_MC
    held[5][:10] = NO_RATE
    write(path, columns(temperature=True, gyroscope=True, utc=False), held, [0, 1000])
    table = pq.read_table(path)
    assert np.isnan(table["temperature"].to_numpy()).tolist() == [False] * 300 + [True] * 700
    assert np.isnan(table["gx"].to_numpy()).tolist() == [True] * 10 + [False] * 990


@pytest.mark.parametrize("spread", [1, 200, 2000, 70_000, 1 << 30], ids=str)
@pytest.mark.parametrize("paired_with", [None, "temperature"])
def test_numbers_are_written_whatever_their_range(
    tmp_path: Path, spread: int, paired_with: str | None
) -> None:
    random, rows = np.random.default_rng(spread), 100_001
    warm = np.repeat(random.integers(20_000, 23_000, rows // 100 + 1), 100)[:rows].astype(np.int32)
    numbers = random.integers(-spread, spread, rows).astype(np.int32)

    def values(counts: np.ndarray, mc: np.ndarray | float = 0.0) -> np.ndarray:
        return (counts / 256 + mc / 1000).astype(np.float32)

    kept = columns(temperature=True, gyroscope=False, utc=False)
    kept[1] = Column("x", "g", pa.float32(), never, Numbers(never, values, paired_with=paired_with))
    held = arrays(rows, gyroscope=False)
    held[1], held[4] = numbers, warm
    write(tmp_path / "a", kept, held, [0, rows])
    expected = values(numbers) if paired_with is None else values(numbers, warm)
    assert (pq.read_table(tmp_path / "a")["x"].to_numpy() == expected).all()


def never(*_: object) -> np.ndarray:
    raise AssertionError


@pytest.mark.parametrize(("repeat", "encoding"), [(1000, "PLAIN"), (1, "BYTE_STREAM_SPLIT")])
def test_fractions_that_repeat_are_written_as_they_are(tmp_path: Path, repeat: int, encoding: str) -> None:
    held = arrays(100_000, temperature=False, gyroscope=False)
    held[2] = np.repeat(held[2][: 100_000 // repeat], repeat)
    write(tmp_path / "a", columns(temperature=False, gyroscope=False, utc=False), held, [0, 100_000])
    column = pq.ParquetFile(tmp_path / "a").metadata.row_group(0).column(2)
    assert encoding in column.encodings
    page = pages.read((tmp_path / "a").read_bytes()[column.data_page_offset :])
    assert pages.value_of(pages.value_of(page, 5), 1) == PAGE_ROWS == 65536


def test_a_foreign_file_is_refused_and_ours_is_not(tmp_path: Path) -> None:
    ours, foreign, text = tmp_path / "o.parquet", tmp_path / "f.parquet", tmp_path / "t.parquet"
    write(
        ours, columns(temperature=False, gyroscope=False, utc=False), [*arrays(3)[:4], arrays(3)[-1]], [0, 3]
    )
    pd.DataFrame({"x": [1]}).to_parquet(foreign)
    text.write_text("mine")
    assert written_by_us(ours)
    refuse_foreign(ours, known=written_by_us(ours))
    refuse_foreign(tmp_path / "absent.parquet", known=False)
    for path in (foreign, text):
        with pytest.raises(OutputError, match="not written by accelcal"):
            refuse_foreign(path, known=written_by_us(path))


@pytest.mark.skipif(not hasattr(os, "fdatasync"), reason="the system has no fdatasync")
def test_a_disk_that_fails_while_it_takes_what_was_written_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(_file: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(sink, "ROW_GROUP_ROWS", 1024)
    monkeypatch.setattr(sink, "FLUSHED_BYTES", 1)
    monkeypatch.setattr(os, "fdatasync", failing)
    kept = columns(temperature=False, gyroscope=False, utc=False)
    for rows in (1024, 5000):
        with pytest.raises(OutputError, match="cannot be written \\(Input/output error\\)"):
            write(tmp_path / "a", kept, arrays(rows, temperature=False, gyroscope=False), [0, rows])
    write(tmp_path / "a", kept, arrays(1024, temperature=False, gyroscope=False), [0, 1024], threads=1)


def test_only_whole_numbers_and_times(tmp_path: Path) -> None:
    path, rows = tmp_path / "a.parquet", 1000
    kept = columns(temperature=True, gyroscope=False, utc=False)
    whole = [kept[0], *kept[4:]]
    held = arrays(rows, gyroscope=False)
    write(path, whole, [held[0], *held[4:]], [0, rows])
    assert pq.ParquetFile(path).metadata.num_rows == rows
    assert (pq.read_table(path)["time"].cast(pa.int64()).to_numpy() == held[0]).all()


def test_angular_rates_of_a_chunk_are_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made, calibrated = [], Gyroscope.calibrated

    def counted(*arguments: Any) -> Any:
        made.append(1)
        return calibrated(*arguments)

    bias = Bias((1.0, 2.0, 3.0), None, (0.0, 0.0, 0.0), None, 60.0, 1.0, None, None)
    verdict = Gyroscope("calibrated", "", 12, scale=((2, 0, 0), (0.5, 1, 0), (0, 0, 1)), bias=bias)
    facts = Facts(
        samples=0, first_us=None, last_us=None, rate_hz=None, gaps=(), gaps_omitted=0, problems=(),
        counts=SampleCounts(), has_temperature=False, has_gyroscope=True, utc_offset_s=None,
    )  # fmt: skip
    recording = Recording(Path("a"), "csv", 100.0, 256.0, 0, gyro_dps_per_lsb=(0.1, 0.2, 0.3))
    rates = recording_columns(recording, facts, gyroscope=verdict)[4:7]
    random = np.random.default_rng(1)

    def chunk() -> Chunk:
        counts = random.integers(-3000, 3000, (50, 3)).astype(np.int16)
        return Chunk(0, np.zeros((50, 3), np.int16), StampClock(np.arange(50)), 0, gyro_counts=counts)

    chunks = [chunk() for _ in range(4)]
    alone = [[column.values(rows, []) for column in rates[::-1]][::-1] for rows in chunks]
    monkeypatch.setattr(Gyroscope, "calibrated", counted)
    found = [[column.values(rows, []) for column in rates] for rows in chunks]
    assert len(made) == len(chunks)
    for expected, axes in zip(alone, found, strict=True):
        assert all((a == b).all() for a, b in zip(expected, axes, strict=True))


@pytest.mark.parametrize("threads", [1, 2])
def test_a_file_without_rows(tmp_path: Path, threads: int) -> None:
    kept = columns(temperature=True, gyroscope=True, utc=False)
    write(tmp_path / "a", kept, arrays(0), [0, 0], threads)
    table = pq.read_table(tmp_path / "a")
    assert (table.num_rows, table.schema.names) == (0, [column.name for column in kept])


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs Linux")
def test_reading_back_holds_a_row_group_or_two_and_starts_no_thread(tmp_path: Path) -> None:
    """Five row groups of 6 MB, which hardly get shorter."""
    path, rows = tmp_path / "a.parquet", 5 * sink.ROW_GROUP_ROWS
    held = arrays(rows, temperature=False, gyroscope=False)
    write(path, columns(temperature=False, gyroscope=False, utc=False), held, [0, rows])
    program = """
import os, sys
from pathlib import Path
import pyarrow as pa
from accelcal_cli.parquet import ParquetSource
threads, rows = set(os.listdir("/proc/self/task")), 0  # the allocator has one
with ParquetSource(Path(sys.argv[1])) as source:
    while len(taken := source.take(1 << 16)[0]):
        assert set(os.listdir("/proc/self/task")) == threads
        rows += len(taken)
print(rows, pa.default_memory_pool().max_memory())
"""
    words = [sys.executable, "-c", program, str(path)]
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    taken, peak = map(int, done.stdout.split())
    assert taken == rows
    assert path.stat().st_size > 25_000_000
    assert peak < 20_000_000
