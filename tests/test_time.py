"""Times of real recordings, to the second, against what their bytes say to a decoder of its own; times over
a change of clocks, against `zoneinfo`.

The decoders do not use the package.
"""

from __future__ import annotations

import gzip
import json
import re
import struct
import zipfile
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest

from accelcal_cli.core.clock import iso_time, utc_offset_s
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import open_recording
from accelcal_cli.pipeline.inspect import as_json, inspect
from accelcal_cli.pipeline.jobs import Request
from tests.cli.run import run
from tests.cli.studies import rows
from tests.formats import make_csv, make_cwa, make_hdf5
from tests.formats.reading import Read

FIRST: dict[str, tuple[str, str | None]] = {
    "actigraph_30hz_12h.csv.gz": ("2017-10-30T15:00:00", "UTC"),
    "actigraph_gt3xplus_30hz_9h.csv.gz": ("2012-06-27T10:54:00", None),
    "apdm_opal.h5": ("2021-05-14T13:16:40", "UTC"),
    "ax3_100hz_3min.cwa": ("2019-02-26T10:55:05", None),
    "ax3_200hz_5min.cwa": ("2020-02-12T09:03:37", None),
    "ax3_corrupt_blocks_0_13_14_142_143_144.cwa": ("2019-02-26T10:55:07", None),
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
    part = (fraction & 0x7FFF) / 32768 if fraction & 0x8000 else 0.0
    anchor = sample + int(part * 3200 / (1 << (15 - (sector[24] & 15))))
    return make_cwa.unpacked_time(stamp) + timedelta(seconds=part), anchor, count


def cwa(path: Path) -> str:
    """By the stamps of the first two data sectors whose words add up to 0, and the samples between them."""
    data = path.read_bytes()
    sectors = [data[place : place + 512] for place in range(1024, 1024 + 512 * 4, 512)]
    good = [sector for sector in sectors if sum(struct.unpack("<256H", sector)) % 65536 == 0]
    (one, at, count), (two, then, _) = map(cwa_stamp, good[:2])
    return (one - at * (two - one) / (count + then - at)).replace(microsecond=0, tzinfo=None).isoformat()


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


def test_every_real_recording_is_looked_at(real_data: Path) -> None:
    assert {path.name for path in (real_data / "vendor").iterdir()} == set(FIRST)


@pytest.mark.parametrize("name", FIRST)
def test_the_first_stamp_is_right_to_the_second(real_data: Path, name: str) -> None:
    path = real_data / "vendor" / name
    with open_recording(path, ReadOptions(sensor=sensor_of(path))) as reader:
        found = reader.recording
        first_us = int(next(chunk for chunk in reader.chunks(1000) if len(chunk)).clock.times(0, 1)[0])
    second, zone = FIRST[name]
    assert DECODERS[path.suffix.lower()](path) == second
    assert (str(iso_time(found.start_us, None))[:19], found.timezone) == (second, zone)
    assert str(iso_time(first_us, None))[:19] == second


def sensor_of(path: Path) -> str | None:
    return "XI-012367" if path.suffix == ".h5" else None


def moment_of(name: str, zone: str | None = None) -> datetime:
    """The first second of a recording, in UTC where the zone is known, or at least given."""
    second, stated = FIRST[name]
    if stated is not None:
        return datetime.fromisoformat(second + stated.replace("UTC", "+00:00"))
    local = datetime.fromisoformat(second)
    return local if zone is None else local.replace(tzinfo=ZoneInfo(zone))


def contradicts(name: str, zone: str) -> bool:
    """Whether the offset that a recording states is not that of a zone when it began."""
    moment = moment_of(name, zone)
    return moment.utcoffset() != moment.replace(tzinfo=ZoneInfo(zone)).utcoffset()


@pytest.mark.parametrize("name", FIRST)
def test_a_zone_is_taken_where_the_file_states_none_and_else_refused_by_name(
    real_data: Path, name: str
) -> None:
    path, zone = real_data / "vendor" / name, "Europe/Berlin"
    options = ReadOptions(sensor=sensor_of(path), timezone=zone)
    if contradicts(name, zone):
        said = f"states its time zone, {FIRST[name][1]}, which is not {zone}"
        with pytest.raises(UsageError, match=re.escape(said)):
            open_recording(path, options)
        return
    with open_recording(path, options) as reader:
        about = reader.recording
    offset_s = utc_offset_s(about.timezone, about.start_us or 0) or 0
    utc = datetime.fromtimestamp((about.start_us or 0) // 10**6 - offset_s, UTC)
    assert utc == moment_of(name, zone)


@pytest.mark.nightly
@pytest.mark.parametrize("zone", [None, "Europe/Berlin"])
def test_a_study_of_all_real_recordings(
    real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], zone: str | None
) -> None:
    """One type of `time`, or a word about it; every first stamp right to the second."""
    words = () if zone is None else ("--timezone", zone)
    ran = run(capsys, "study", real_data / "vendor", "-d", tmp_path, "-j", 2, *words)
    kinds = set()
    for row in rows(tmp_path):
        name = Path(row["path"]).name
        if name.endswith(".h5"):
            assert "choose one with --sensor" in row["message"]
        elif zone is not None and contradicts(name, zone):
            assert f"states its time zone, {FIRST[name][1]}, which is not {zone}" in row["message"]
        else:
            moment = moment_of(name, zone)
            assert datetime.fromisoformat(row["start_time"]).replace(microsecond=0) == moment
            assert row["time_zone"] == ("unknown" if moment.tzinfo is None else "UTC")
        if row["parquet"]:
            first = pq.read_table(tmp_path / row["parquet"], columns=["time"])["time"][0].as_py()
            assert first.replace(microsecond=0) == moment_of(name, zone)
            kinds.add(str(first.tzinfo))
    assert len(kinds) == (1 if zone else 2)
    assert ("do not join them" in ran.err) == (zone is None)
    found = json.loads((tmp_path / "study.json").read_text())["findings"]["number"]
    assert (found == 0) == (zone is not None)


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


CHANGES = [
    ("Europe/Berlin", datetime(2023, 3, 26, 1, tzinfo=UTC), 1),
    ("Europe/Berlin", datetime(2023, 10, 29, 1, tzinfo=UTC), -1),
    ("America/New_York", datetime(2024, 11, 3, 6, tzinfo=UTC), -1),
    ("Australia/Lord_Howe", datetime(2024, 10, 5, 15, 30, tzinfo=UTC), 0.5),
]
"""A zone, when its clocks were changed, and by how many hours."""


def moments(change: datetime, seconds: int = 8, apart_ms: int = 50) -> list[datetime]:
    """As many seconds before a change as after it."""
    steps = range(-1000 * seconds // apart_ms, 1000 * seconds // apart_ms)
    return [change + timedelta(milliseconds=apart_ms * step) for step in steps]


def local(moment: datetime, zone: str) -> str:
    """What a computer there wrote."""
    return moment.astimezone(ZoneInfo(zone)).strftime("%Y-%m-%d %H:%M:%S.%f")


def table(path: Path, stamps: list[str], bad: int | None = None) -> Path:
    rows = [
        f"{stamp},{0.001 * (row % 7):g},0.02,{'' if row == bad else 1}" for row, stamp in enumerate(stamps)
    ]
    path.write_text("\n".join(["time,x [g],y [g],z [g]", *rows, ""]))
    return path


def utc_us(found: Read) -> list[int]:
    """Its times as the Parquet file has them."""
    about = found.recording
    offset_s = utc_offset_s(about.timezone, about.start_us or 0)
    assert offset_s is not None
    return (found.times - offset_s * 10**6).tolist()


def exact_us(times: list[datetime]) -> list[int]:
    return [(moment - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) for moment in times]


@pytest.mark.parametrize("chunk_samples", [7, 1000])
@pytest.mark.parametrize(("zone", "change", "hours"), CHANGES)
def test_stamps_of_a_computer_follow_its_clock_over_a_change(
    tmp_path: Path, zone: str, change: datetime, hours: float, chunk_samples: int
) -> None:
    times = moments(change)
    path = table(tmp_path / "a.csv", [local(moment, zone) for moment in times])
    found = make_csv.read(path, chunk_samples, timezone=zone)
    assert utc_us(found) == exact_us(times)
    assert (found.breaks, found.codes) == ([], ["clock_followed"])
    line = 2 + len(times) // 2
    assert found.problems[0].message == f"the times follow a change of the clocks in {zone}"
    assert found.problems[0].place == f"before line {line}"
    assert found.problems[0].sample == len(times) // 2
    unknown = make_csv.read(path, chunk_samples)
    assert (unknown.breaks, unknown.codes) == (
        [len(times) // 2],
        ["clock_gap" if hours > 0 else "clock_back"],
    )


def test_stamps_that_rows_share_follow_a_change_too(tmp_path: Path) -> None:
    zone, change, _ = CHANGES[1]
    times = moments(change)
    path = table(tmp_path / "a.csv", [local(moment, zone)[:19] for moment in times])
    found = make_csv.read(path, timezone=zone)
    assert (utc_us(found), found.codes) == (exact_us(times), ["clock_followed"])


@pytest.mark.parametrize("beside", [-1, 0])
def test_a_row_that_is_left_out_at_the_change_hides_nothing(tmp_path: Path, beside: int) -> None:
    zone, change, _ = CHANGES[0]
    times = moments(change)
    bad = len(times) // 2 + beside
    path = table(tmp_path / "a.csv", [local(moment, zone) for moment in times], bad)
    found = make_csv.read(path, timezone=zone)
    del times[bad]
    assert utc_us(found) == exact_us(times)
    assert sorted(found.codes) == ["clock_followed", "missing_value"]


def test_times_over_two_changes_follow_both(tmp_path: Path) -> None:
    zone = "Europe/Berlin"
    times = [moment for _, change, _ in CHANGES[:2] for moment in moments(change)]
    found = make_csv.read(
        table(tmp_path / "a.csv", [local(moment, zone) for moment in times]), timezone=zone, rate_hz=20.0
    )
    assert utc_us(found) == exact_us(times)
    assert found.codes.count("clock_followed") == 2


@pytest.mark.parametrize(("zone", "change", "hours"), CHANGES)
def test_the_clock_of_a_device_runs_on_over_a_change(
    tmp_path: Path, zone: str, change: datetime, hours: float
) -> None:
    times = moments(change)
    offset = times[0].astimezone(ZoneInfo(zone)).utcoffset()
    assert offset is not None
    stamps = [(moment + offset).strftime("%Y-%m-%d %H:%M:%S.%f") for moment in times]
    found = make_csv.read(table(tmp_path / "a.csv", stamps), timezone=zone)
    assert (utc_us(found), found.codes, found.breaks) == (exact_us(times), [], [])


def test_an_hour_that_is_missing_elsewhere_is_no_change_of_the_clocks(tmp_path: Path) -> None:
    zone, change, _ = CHANGES[0]
    times = moments(change - timedelta(minutes=10))
    half = len(times) // 2
    times = [moment + timedelta(hours=row >= half) for row, moment in enumerate(times)]
    stamps = [(moment + timedelta(hours=1)).strftime("%Y-%m-%d %H:%M:%S.%f") for moment in times]
    found = make_csv.read(table(tmp_path / "a.csv", stamps), timezone=zone)
    assert (utc_us(found), found.codes) == (exact_us(times), ["clock_gap"])


def test_local_times_that_an_hdf5_file_counts_from_1970_follow_a_change_where_the_zone_is_forced(
    tmp_path: Path,
) -> None:
    zone, change, _ = CHANGES[1]
    times = moments(change)
    walls = [moment.astimezone(ZoneInfo(zone)).replace(tzinfo=UTC) for moment in times]
    counts = np.tile(np.array([1, 2, 256], np.int16), (len(times), 1))
    datasets = {"accel": counts, "time": np.array(exact_us(walls), np.int64)}
    path = make_hdf5.write(tmp_path / "a.h5", datasets, make_hdf5.about(sample_rate=20.0, start_time=None))
    found = make_hdf5.read(path, 30, timezone=zone, force_timezone=True)
    assert (utc_us(found), found.codes, found.breaks) == (exact_us(times), ["clock_followed"], [])
    assert found.problems[0].message == f"the times follow a change of the clocks in {zone}"
    datasets["time"] = datasets["time"] // 10**6
    make_hdf5.write(path, datasets, make_hdf5.about(sample_rate=20.0, start_time=None))
    found = make_hdf5.read(path, 30, timezone=zone, force_timezone=True)
    assert (utc_us(found), found.codes, found.breaks) == (exact_us(times), ["clock_followed"], [])


@pytest.mark.parametrize(
    ("kept", "followed", "words"),
    [
        (lambda _: True, True, "the times of this file follow that, and were read so"),
        (lambda minutes: abs(minutes) > 0.05, True, "the times of this file follow that"),
        (lambda minutes: abs(minutes) > 1, None, "if it was, later times are 1 h too early"),
    ],
    ids=["rows at the change", "a pause of seconds", "none for minutes"],
)
def test_the_report_says_whether_times_follow_a_change(
    tmp_path: Path, kept: Callable[[float], bool], followed: bool | None, words: str
) -> None:
    zone, change, _ = CHANGES[1]
    times = [moment for moment in moments(change, 90) if kept((moment - change) / timedelta(minutes=1))]
    path = table(tmp_path / "a.csv", [local(moment, zone) for moment in times])
    found = inspect(path, Request(ReadOptions(timezone=zone, rate_hz=20.0)), full=True)
    told = as_json(found)["file_health"]["clock"]["dst_change"]
    assert (told["time"], told["followed"]) == ("2023-10-29T03:00:00.000000+02:00", followed)
    assert told["note"].endswith(words) or words in told["note"]
    assert told["note"] in as_json(found)["recording"]["notes"]
