"""T8: times that were written as texts, and counters known by name, in columns of tables."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.feather as pf
import pyarrow.parquet as pq
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import open_recording

ROWS, RATE_HZ = 300, 25
BEGIN = datetime(2024, 3, 14, 10, 41, 40)
BEGIN_US = 1_710_412_900_000_000
FORMS: dict[str, tuple[Callable[[datetime], str], str | None, int]] = {
    "ISO 8601": (lambda t: t.isoformat(timespec="milliseconds"), None, 0),
    "Z": (lambda t: t.isoformat(timespec="milliseconds") + "Z", "UTC", 0),
    "an offset": (lambda t: t.isoformat(" ", "milliseconds") + "+01:00", "UTC", -3600),
    "MATLAB": (lambda t: f"{t:%d-%b-%Y %H:%M:%S.%f}"[:-3], None, 0),
    "biobank": (lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f}"[:-3] + "+0100 [Europe/Paris]", "UTC", -3600),
    "a day above 12": (lambda t: f"{t:%d/%m/%Y %H:%M:%S.%f}"[:-3], None, 0),
    "numbers": (lambda t: f"{BEGIN_US / 1e6 + (t - BEGIN).total_seconds():.3f}", "UTC", 0),
}


def values() -> np.ndarray:
    return np.tile([0.1, 0.2, 0.97], (ROWS, 1)) + 0.01 * np.random.RandomState(1).randn(ROWS, 3)


def moments() -> list[datetime]:
    return [BEGIN + timedelta(milliseconds=40 * row) for row in range(ROWS)]


def as_columns(name: str, column: object) -> pa.Table:
    return pa.table({name: column, **dict(zip("xyz", values().T, strict=True))})


def write(path: Path, name: str, column: list[object] | np.ndarray) -> Path:
    if path.suffix == ".parquet":
        pq.write_table(as_columns(name, column), path, row_group_size=128)
    elif path.suffix == ".feather":
        pf.write_feather(as_columns(name, column), path, chunksize=100)
    elif path.suffix == ".npz":
        np.savez(path, acc=values(), **{name: np.array(column)})
    else:
        with h5py.File(path, "w") as file:
            file["acc"], file[name] = values(), column
    return path


def read(path: Path, samples: int = 70, **options: object) -> tuple[object, np.ndarray, list[str]]:
    with open_recording(path, ReadOptions(unit="g", **options)) as reader:  # type: ignore[arg-type]
        chunks = list(reader.chunks(samples))
        times = np.concatenate([chunk.clock.times(0, len(chunk)) for chunk in chunks])
        return reader.recording, times, [problem.code for chunk in chunks for problem in chunk.problems]


@pytest.mark.parametrize("suffix", [".parquet", ".feather", ".npz", ".h5"])
@pytest.mark.parametrize("form", FORMS)
def test_t8_written_times_are_read_in_tables(tmp_path: Path, suffix: str, form: str) -> None:
    write_time, zone, shift_s = FORMS[form]
    path = write(tmp_path / f"a{suffix}", "time", [write_time(moment) for moment in moments()])
    for samples in (70, 100_000):
        recording, times, problems = read(path, samples)
        assert times.tolist() == [BEGIN_US + shift_s * 1_000_000 + 40_000 * row for row in range(ROWS)]
        assert (recording.timezone, recording.rate_hz, recording.start_us) == (zone, RATE_HZ, times[0])
        assert problems == []


@pytest.mark.parametrize("form", ["ISO 8601", "Z"])
def test_t8_texts_that_are_no_times_lose_their_rows(tmp_path: Path, form: str) -> None:
    texts: list[object] = [FORMS[form][0](moment) for moment in moments()]
    texts[100], texts[150], texts[151] = "junk", None, ""
    _, times, problems = read(write(tmp_path / "a.parquet", "time", texts), rate_hz=25.0)
    assert len(times) == ROWS - 3 and set(problems) == {"bad_line", "missing_value"}
    assert times[0] == BEGIN_US and times[-1] == BEGIN_US + 40_000 * (ROWS - 1)


def test_t8_a_form_is_asked_for_where_dates_have_two_orders(tmp_path: Path) -> None:
    texts = [f"{moment.replace(day=4):%d/%m/%Y %H:%M:%S.%f}" for moment in moments()]
    path = write(tmp_path / "a.parquet", "when", texts)
    with pytest.raises(UnreadableError, match="dmy or mdy; say which with -R date_format"):
        read(path, time_column="when")
    assert read(path, time_column="when", date_format="dmy")[1][0] == BEGIN_US - 10 * 86_400_000_000
    _, times, _ = read(path, time_column="when", time_format="%d/%m/%Y %H:%M:%S.%f")
    assert times[0] == BEGIN_US - 10 * 86_400_000_000


NAMES = {
    "ms": 1e3,
    "micros": 1e6,
    "millis": 1e3,
    "seconds": 1,
    "elapsed": 1e3,
    "elapsed_ms": 1e3,
    "timestamp_ms": 1e3,
    "timestamp_millis": 1e3,
    "time_micros": 1e6,
    "time [ms]": 1e3,
    "Timestamp (us)": 1e6,
}


@pytest.mark.parametrize("suffix", [".parquet", ".feather", ".npz", ".h5"])
@pytest.mark.parametrize("name", NAMES)
def test_t8_counters_are_known_by_the_names_of_text_files(tmp_path: Path, suffix: str, name: str) -> None:
    ticks = np.arange(ROWS) * 0.04 * NAMES[name]
    path = write(tmp_path / f"a{suffix}", name, ticks if NAMES[name] == 1 else ticks.round().astype(np.int64))
    recording, times, problems = read(path)
    assert (recording.rate_hz, recording.start_us, problems) == (RATE_HZ, None, ["no_start_time"])
    assert np.diff(times).tolist() == [40_000] * (ROWS - 1)


@pytest.mark.parametrize("name", ["ts", "unix", "utc"])
def test_t8_such_a_name_is_known_and_asked_about_beside_another(tmp_path: Path, name: str) -> None:
    ticks = BEGIN_US // 1000 + 40 * np.arange(ROWS)
    assert read(write(tmp_path / "a.parquet", name, ticks))[0].start_us == BEGIN_US
    made = as_columns(name, ticks + 86_400_000).append_column("time", pa.array(ticks))
    pq.write_table(made, tmp_path / "b.parquet")
    with pytest.raises(UnreadableError, match=r"several columns may be the time .*-R time_column"):
        read(tmp_path / "b.parquet")
    assert read(tmp_path / "b.parquet", time_column="time")[0].start_us == BEGIN_US
