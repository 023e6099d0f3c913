"""Times of real recordings, to the second, against what their bytes say to a decoder of its own.

The decoders do not use the package.
"""

from __future__ import annotations

import gzip
import re
import struct
import zipfile
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import h5py
import pytest

from accelcal_cli.core.clock import iso_time, utc_offset_s
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import open_recording

FIRST: dict[str, tuple[str, str | None]] = {
    "actigraph_30hz_12h.csv.gz": ("2017-10-30T15:00:00", "UTC"),
    "actigraph_gt3xplus_30hz_9h.csv.gz": ("2012-06-27T10:54:00", None),
    "apdm_opal.h5": ("2021-05-14T13:16:40", "UTC"),
    "ax3_100hz_3min.cwa": ("2019-02-26T10:55:05", None),
    "ax3_200hz_5min.cwa": ("2020-02-12T09:03:37", None),
    "ax3_sacrum_100hz_3h.cwa": ("2019-10-02T11:43:55", None),
    "ax6_100hz_2min.cwa": ("2019-12-23T21:04:06", None),
    "ax6_100hz_6min.CWA": ("2025-11-17T09:00:02", None),
    "empatica_e4_32hz_2h.csv": ("2017-06-02T22:50:04", "UTC"),
    "geneactiv_66hz_22min.bin": ("2023-06-16T13:37:11", "+01:00"),
    "geneactiv_85hz_1min.bin": ("2013-05-30T10:12:54", "+01:00"),
    "geneactiv_sample.bin": ("2019-05-21T16:16:43", "-04:00"),
    "gt3x_ism_disabled.gt3x": ("2021-03-19T15:57:00", "-05:00"),
    "gt3x_ism_enabled.gt3x": ("2021-03-19T15:57:00", "-05:00"),
    "gt3x_link_100hz_36min.actilife.csv.gz": ("2019-09-17T18:40:00", None),
    "gt3x_link_100hz_36min.gt3x": ("2019-09-17T18:40:00", "-04:00"),
    "gt3x_link_30hz_14h.gt3x": ("2019-05-06T11:38:38", "UTC"),
    "gt3x_link_30hz_3h.gt3x": ("2020-01-23T08:50:00", "-05:00"),
    "gt3x_old_neo_30hz_10min.gt3x": ("2021-12-20T11:55:00", "-06:00"),
    "gt3x_waist_30hz_30min.gt3x": ("2020-08-26T10:09:00", "+02:00"),
    "must_refuse_30hz_4h.csv.gz": ("2000-01-04T20:00:00", None),
    "zio_chest_1.56hz_14d.csv.gz": ("2019-11-20T11:50:44", "UTC"),
}
"""Of each recording: the second of its first sample on its clock, and the zone that the file states."""


def since_1970(seconds: float) -> str:
    return (datetime(1970, 1, 1) + timedelta(seconds=int(seconds))).isoformat()


def cwa_stamp(sector: bytes) -> tuple[datetime, int, int]:
    """A data sector's time, which of its samples has that time, and how many samples it holds."""
    fraction, _session, _sequence, stamp = struct.unpack_from("<HIII", sector, 4)
    sample, count = struct.unpack_from("<hH", sector, 26)
    day = datetime(2000 + (stamp >> 26), stamp >> 22 & 15, stamp >> 17 & 31)
    part = (fraction & 0x7FFF) / 32768 if fraction & 0x8000 else 0.0
    seconds = (stamp >> 12 & 31) * 3600 + (stamp >> 6 & 63) * 60 + (stamp & 63) + part
    return (
        day + timedelta(seconds=seconds),
        sample + int(part * 3200 / (1 << (15 - (sector[24] & 15)))),
        count,
    )


def cwa(path: Path) -> str:
    """By the stamps of the first two data sectors and the samples between them."""
    data = path.read_bytes()
    (one, at, count), (two, then, _) = (cwa_stamp(data[place : place + 512]) for place in (1024, 1536))
    return (one - at * (two - one) / (count + then - at)).replace(microsecond=0).isoformat()


def gt3x(path: Path) -> str:
    """Of the first record with samples in log.bin; of the older kind, the start in info.txt."""
    with zipfile.ZipFile(path) as archive:
        if "log.bin" not in archive.namelist():
            ticks = re.search(rb"Start Date: (\d+)", archive.read("info.txt"))
            assert ticks is not None
            return since_1970(int(ticks[1]) / 10**7 - 62_135_596_800)
        log, at = archive.read("log.bin"), 0
    while True:
        kind, stamp, size = struct.unpack_from("<xBIH", log, at)
        if kind in (0, 26) and size > 1:
            return since_1970(stamp)
        at += 9 + size


def geneactiv(path: Path) -> str:
    stamp = re.search(r"Page Time:(\S+ \d\d:\d\d:\d\d)", path.read_bytes().decode("latin-1"))
    assert stamp is not None
    return stamp[1].replace(" ", "T")


def csv(path: Path) -> str:
    raw = path.read_bytes()
    text = (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode()[:2000]
    if "ActiGraph" in text:
        clock, day = re.search(r"Start Time (\S+)", text), re.search(r"Start Date (\S+)", text)
        assert clock is not None
        assert day is not None
        return datetime.strptime(f"{day[1]} {clock[1]}", "%m/%d/%Y %H:%M:%S").isoformat()
    lines = text.splitlines()
    cell = lines["time" in lines[0]].split(",")[0]
    return since_1970(float(cell)) if re.fullmatch(r"[\d.]+", cell) else cell.replace(" ", "T")[:19]


def opal(path: Path) -> str:
    with h5py.File(path) as file:
        return since_1970(int(file["Sensors/XI-012367/Time"][0]) / 10**6)


DECODERS: dict[str, Callable[[Path], str]] = {
    ".cwa": cwa, ".gt3x": gt3x, ".bin": geneactiv, ".gz": csv, ".csv": csv, ".h5": opal,
}  # fmt: skip


@pytest.mark.parametrize("name", FIRST)
def test_the_first_stamp_is_right_to_the_second(real_data: Path, name: str) -> None:
    path = real_data / "vendor" / name
    sensor = "XI-012367" if name.endswith(".h5") else None
    with open_recording(path, ReadOptions(sensor=sensor)) as reader:
        found = reader.recording
    second, zone = FIRST[name]
    assert DECODERS[path.suffix.lower()](path) == second
    assert (str(iso_time(found.start_us, None))[:19], found.timezone) == (second, zone)


def test_a_recording_and_its_export_begin_at_the_same_moment_once_the_zone_is_named(real_data: Path) -> None:
    name, zone = "gt3x_link_100hz_36min", "America/New_York"
    starts = []
    for suffix, options in ((".gt3x", ReadOptions()), (".actilife.csv.gz", ReadOptions(timezone=zone))):
        with open_recording(real_data / "vendor" / f"{name}{suffix}", options) as reader:
            about = reader.recording
            starts.append(
                (about.start_us or 0) // 10**6 - (utc_offset_s(about.timezone, about.start_us or 0) or 0)
            )
    assert starts == [datetime(2019, 9, 17, 22, 40, tzinfo=UTC).timestamp()] * 2
