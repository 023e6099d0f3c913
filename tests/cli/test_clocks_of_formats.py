"""T3: in every format whose files tell the time, any clock gives a report that accelcal's commands read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyarrow import feather

from tests.cli.run import exit_code
from tests.cli.test_clocks import read_by_all
from tests.formats import make_cwa, make_flash, make_geneactiv, make_gt3x, make_mat
from tests.recordings import LSB_PER_G, directions, still_counts

COUNTS = still_counts(directions(24))
G = COUNTS / LSB_PER_G
DAY_US = 86_400_000_000
START_US = make_cwa.START_US
YEARS = {year: int(np.datetime64(f"{year}-03-04", "us").astype(int)) for year in (2000, 2010, 2024, 2061)}

Times = np.ndarray
"""Times (n,) [us since 1970]."""


def table(**columns: object) -> dict[str, object]:
    return columns | dict(zip("xyz", G.T, strict=True))


def csv(path: Path, head: str, stamps: list[str]) -> Path:
    rows = (f"{stamp},{x:.5f},{y:.5f},{z:.5f}" for stamp, (x, y, z) in zip(stamps, G.tolist(), strict=True))
    path.write_text("\n".join([f"{head},x,y,z", *rows, ""]))
    return path


def texts(times: Times) -> list[str]:
    return np.datetime_as_string(times.astype("datetime64[us]"), unit="ms").tolist()


def iso(path: Path, times: Times) -> Path:
    return csv(path, "time", texts(times))


def staying_date(path: Path, times: Times) -> Path:
    """The date is that of the first row, though midnight passes."""
    date = texts(times)[0][:10]
    return csv(path, "date,time", [f"{date},{text[11:]}" for text in texts(times)])


def half_day(path: Path, times: Times) -> Path:
    """Hours from 1 to 12, without AM or PM."""
    hours = (times // 3_600_000_000 - 1) % 12 + 1
    stamps = [f"{text[:10]},{hour:02d}{text[13:]}" for text, hour in zip(texts(times), hours, strict=True)]
    return csv(path, "date,time", stamps)


def counter(unit_us: int, bits: int) -> Callable[[Path, Times], Path]:
    """A counter that wraps; `_us` or `_ms` at the end of its name."""
    name = {1: "time_us", 1000: "time_ms"}[unit_us]

    def write(path: Path, times: Times) -> Path:
        return csv(path, name, [str(tick) for tick in (times // unit_us % (1 << bits)).tolist()])

    return write


def parquet(path: Path, times: Times) -> Path:
    pq.write_table(pa.table(table(time=pa.array(times, pa.timestamp("us")))), path)
    return path


def arrow(path: Path, times: Times) -> Path:
    feather.write_feather(pa.table(table(timestamp_ms=times // 1000)), path)
    return path


def hdf5(path: Path, times: Times) -> Path:
    with h5py.File(path, "w") as file:
        file["accel"], file["time"] = G, times / 1e6
        file.attrs["units"] = "g"
    return path


def npz(path: Path, times: Times) -> Path:
    np.savez(path, accel=G, time=times / 1e6, unit="g")
    return path


def mat(path: Path, times: Times) -> Path:
    return make_mat.write(path, {"accel": G, "time": times / 1e6, "unit": "g"}, packed=True)


def cwa(path: Path, times: Times) -> Path:
    pages = make_cwa.sectors(COUNTS, rate_code=0x48)
    placed = [
        make_cwa.replace(page, time_us=int(times[80 * k]), anchor=0, temperature=270)
        for k, page in enumerate(pages)
    ]
    return make_cwa.written(path, placed)


def whole_cwa(path: Path, times: Times) -> Path:
    pages = make_cwa.sectors(COUNTS, rate_code=0x48)
    stamps = [int(times[80 * k]) // 1_000_000 * 1_000_000 for k in range(len(pages))]
    placed = [
        make_cwa.replace(page, time_us=stamp, fractional=False)
        for page, stamp in zip(pages, stamps, strict=True)
    ]
    return make_cwa.written(path, placed)


def gt3x(path: Path, times: Times) -> Path:
    log = [
        make_gt3x.activity(int(times[at] // 1_000_000), COUNTS[at : at + 50])
        for at in range(0, len(COUNTS), 50)
    ]
    return make_gt3x.written(path, log)


def geneactiv(path: Path, times: Times) -> Path:
    pages = [
        make_geneactiv.replace(page, time_us=int(times[300 * k]))
        for k, page in enumerate(make_geneactiv.pages(COUNTS, 25.0))
    ]
    head = make_geneactiv.header(rate="25", pages=len(pages))
    return make_geneactiv.written(path, pages, head)


def flash(path: Path, times: Times) -> Path:
    begins = range(0, len(COUNTS), 80)
    pages = [make_flash.page(k, int(times[at]), COUNTS[at : at + 80]) for k, at in enumerate(begins)]
    path.write_bytes(make_flash.header(25.0) + b"".join(pages))
    return path


@dataclass(frozen=True)
class Kind:
    """A format: how it is written, its suffix, its rate, and whether it asks where a clock is ambiguous."""

    write: Callable[[Path, Times], Path]
    suffix: str
    rate_hz: float = 25.0
    asks: bool = False


KINDS = {
    "csv": Kind(iso, "csv"),
    "date that stays": Kind(staying_date, "csv", asks=True),
    "12 hours": Kind(half_day, "csv", asks=True),
    "ms of 16 bits": Kind(counter(1000, 16), "csv", asks=True),
    "ms of 32 bits": Kind(counter(1000, 32), "csv", asks=True),
    "us of 32 bits": Kind(counter(1, 32), "csv", asks=True),
    "parquet": Kind(parquet, "parquet"),
    "feather": Kind(arrow, "feather"),
    "hdf5": Kind(hdf5, "h5"),
    "npz": Kind(npz, "npz"),
    "mat": Kind(mat, "mat"),
    "cwa": Kind(cwa, "cwa"),
    "cwa in seconds": Kind(whole_cwa, "cwa"),
    "gt3x": Kind(gt3x, "gt3x", 50.0),
    "geneactiv": Kind(geneactiv, "bin"),
    "flash": Kind(flash, "bin"),
}


def check(folder: Path, kind: Kind, begins: list[int]) -> dict | None:
    """Calibrate a recording whose rows are shared by stretches with these begins, and read what was written.

    Returns:
        The report; None if the command asked how the clock is meant.
    """
    edges = np.linspace(0, len(COUNTS), len(begins) + 1).astype(int)
    period = 1e6 / kind.rate_hz
    times = np.concatenate(
        [
            begin + np.rint(period * np.arange(rows)).astype(np.int64)
            for begin, rows in zip(begins, np.diff(edges), strict=True)
        ]
    )
    path = kind.write(folder / f"a.{kind.suffix}", times)
    code = exit_code("calibrate", path, "--html", "-d", folder / "out", "-q")
    if code in (2, 3) and kind.asks and len(begins) > 1:
        return None
    assert code == 0
    found = read_by_all(folder, path)
    assert found["recording"]["samples"] == len(COUNTS)
    lasted = found["recording"]["duration_s"]
    assert lasted >= 0
    if len(begins) == 1:
        assert lasted == pytest.approx(len(COUNTS) / kind.rate_hz, abs=2)
    return found


@pytest.mark.parametrize("name", ["us of 32 bits", "mat", "cwa in seconds", "gt3x"])
def test_t3_a_clock_that_is_reset_is_read_in_any_format(tmp_path: Path, name: str) -> None:
    begins = [START_US] if KINDS[name].asks else [START_US, YEARS[2000]]
    assert check(tmp_path, KINDS[name], begins) is not None


@pytest.mark.nightly
@pytest.mark.parametrize("name", KINDS)
@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(
        st.one_of(
            st.sampled_from(sorted(YEARS.values())),
            st.integers(0, 400 * DAY_US).map(lambda by: START_US + by),
            st.integers(0, 900_000_000).map(lambda by: START_US + by),
        ),
        min_size=1,
        max_size=5,
    )
)
def test_t3_any_clock_of_any_format_is_read_by_all_commands(
    tmp_path_factory: pytest.TempPathFactory, name: str, begins: list[int]
) -> None:
    check(tmp_path_factory.mktemp("clocks"), KINDS[name], begins)
