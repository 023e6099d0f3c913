"""HDF5 files: finding datasets, units, times, damage. The oracle is h5py and plain arithmetic."""

from __future__ import annotations

import gzip
import struct
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.formats import find_format
from accelcal_cli.formats.tables import HDF5, tracks
from accelcal_cli.formats.tables import hdf5 as hdf5_reader
from accelcal_cli.formats.tables.hdf5 import TextDataset, attributes_of, heaps_are_sound, open_hdf5
from accelcal_cli.formats.tables.header import readable
from tests.cli.run import run
from tests.formats.cuts import cuts, every_byte
from tests.formats.make_hdf5 import START, START_US, about, even_times, read, write
from tests.formats.reading import joined

ROWS = 500

Capture = pytest.CaptureFixture[str]


def counts(rows: int = ROWS, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).integers(-2048, 2048, (rows, 3)).astype(np.int16)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.h5"


def columns(values: np.ndarray, names: str) -> dict[str, np.ndarray]:
    return dict(zip(names.split(), values.T, strict=True))


# --- finding the acceleration


@pytest.mark.parametrize(
    "name", ["accel", "Acceleration", "wrist/ACC", "a/b/accelerometer/data", "raw", "XYZ"]
)
def test_a_dataset_of_three_columns_is_found_by_name_in_any_group(path: Path, name: str) -> None:
    write(path, {name: counts()}, about(serial="7", model="M1", firmware="1.2", range_g=8))
    got = read(path)
    assert (got.counts == counts()).all()
    assert got.counts.dtype == np.int16
    assert (got.times == even_times(ROWS, 100.0)).all()
    recording = got.recording
    assert (recording.rate_hz, recording.lsb_per_g, recording.range_g) == (100.0, 256.0, 8.0)
    assert (recording.device.serial, recording.device.model, recording.device.firmware) == ("7", "M1", "1.2")
    assert (recording.start_us, recording.samples, recording.duration_s) == (START_US, ROWS, 5.0)
    assert (got.breaks, got.problems) == ([], [])


def test_axes_of_a_gyroscope_and_a_magnetometer_are_not_taken_for_acceleration(path: Path) -> None:
    names = "imu/{0}/x imu/{0}/y imu/{0}/z"
    with_gyro = columns(counts(), names.format("accelerometer")) | columns(
        counts(), names.format("gyroscope")
    )
    write(path, with_gyro | columns(counts(), names.format("mag")), about())
    assert (read(path).counts == counts()).all()


def test_single_columns_may_have_a_second_dimension_of_one(path: Path) -> None:
    write(path, {"x": counts()[:, :1], "y": counts()[:, 1:2].T, "z": counts()[:, 2]}, about())
    assert (read(path).counts == counts()).all()


def test_of_many_datasets_a_message_lists_the_first_ones(path: Path) -> None:
    write(path, {f"g{number:03}/accel": counts(4) for number in range(200)}, about())
    with pytest.raises(UnreadableError, match=r"g000/accel; .*g007/accel; \.\.\.; ") as caught:
        read(path)
    assert (len(caught.value.sensors), str(caught.value).count("/accel")) == (200, 8 + 1)


def test_a_file_of_too_many_datasets_is_refused(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(path, {f"g/d{number}": counts(4) for number in range(20)}, about())
    monkeypatch.setattr(hdf5_reader, "MOST_NODES", 20)
    with pytest.raises(UnreadableError, match="more than 20 datasets and groups"):
        read(path)


def test_types_and_links_in_a_file_are_no_damage(path: Path) -> None:
    write(path, {"g/accel": counts()}, about())
    with h5py.File(path, "a") as file:
        file["kind"] = np.dtype("i2")
        file["g/there"], file["g/away"] = h5py.SoftLink("/nowhere"), h5py.ExternalLink("other.h5", "/accel")
    got = read(path)
    assert (got.counts == counts()).all()
    assert got.codes == []


def test_datasets_are_looked_at_one_at_a_time(path: Path) -> None:
    write(path, {f"g{number // 9}/d{number}": counts(4) for number in range(90)}, about())
    kinds = h5py.h5f.OBJ_DATASET | h5py.h5f.OBJ_GROUP
    with open_hdf5(path) as file:
        opened = [h5py.h5f.get_obj_count(file.id, kinds) for _ in hdf5_reader.all_nodes(file, path)]
        opened += [h5py.h5f.get_obj_count(file.id, kinds) for _ in [attributes_of(file, "/g0/d0")]]
    assert (len(opened), max(opened) < 5) == (90 + 10 + 1, True)


@pytest.mark.parametrize("names", [("signal",) * 3, ("/signal",) * 3, ("grp/a", "grp/b", "c")])
def test_columns_name_one_dataset_thrice_or_three(path: Path, names: tuple[str, str, str]) -> None:
    write(path, {"signal": counts()} | columns(counts(), "grp/a grp/b grp/C"), about())
    more: dict[str, Any] = {"rate_hz": 100.0, "lsb_per_g": 256.0}
    assert (read(path, columns=names, **more).counts == counts()).all()


def test_columns_of_another_length_are_refused(path: Path) -> None:
    write(path, {"signal": counts(), "short": np.arange(9)} | columns(counts(), "a b c"), about())
    for names in (("a", "b", "short"), ("signal", "signal", "a")):
        with pytest.raises(UsageError, match=r"twice|short"):
            read(path, columns=names)


# --- attributes, units and scales


@pytest.mark.parametrize(
    "rate", [50, np.float32(50), "50", "50 Hz", b"50.0", np.array([50.0]), np.bytes_(b"50")]
)
@pytest.mark.parametrize("name", ["fs", "Hz", "Sampling Rate", "rate_hz"])
def test_attributes_may_be_of_many_kinds(path: Path, rate: Any, name: str) -> None:
    write(path, {"accel": counts()}, about(sample_rate=None, **{name: rate}, serial=np.bytes_(b"A1\0")))
    assert read(path).recording.rate_hz == 50.0
    assert read(path).recording.device.serial == "A1"


def test_the_nearest_attribute_wins_and_options_outweigh_all(path: Path) -> None:
    write(path, {"s/accel": counts()}, about(sample_rate=None, lsb_per_g=None, units=None, start_time=None))
    with h5py.File(path, "a") as file:
        file.attrs.update(fs=10.0, lsb_per_g=100.0, start_time=START)
        file["s"].attrs["fs"] = 20.0
    recording = read(path).recording
    assert (recording.rate_hz, recording.lsb_per_g, recording.start_us) == (20.0, 100.0, START_US)
    recording = read(path, lsb_per_g=64.0, timezone="Europe/Oslo").recording
    assert (recording.lsb_per_g, recording.timezone) == (64.0, "Europe/Oslo")
    with pytest.raises(UsageError, match="made at 20 Hz, not 40"):
        read(path, rate_hz=40.0)
    assert read(path, unit="mg").recording.lsb_per_g == 1000.0


@pytest.mark.parametrize("changes", [{"sample_rate": 1e300}, {"sample_rate": 0.0}, {"lsb_per_g": -1.0}])
def test_numbers_that_cannot_be_right_are_refused(path: Path, changes: dict[str, float]) -> None:
    write(path, {"accel": counts()}, about(**changes))
    with pytest.raises(UnreadableError, match=r"cannot be right|give the sampling rate"):
        read(path)


def test_whole_numbers_in_mg_stay_whole_counts(path: Path) -> None:
    write(path, {"accel": counts()}, about(units="mg", lsb_per_g=None))
    got = read(path)
    assert (got.recording.lsb_per_g, got.counts.dtype) == (1000.0, np.int16)


@pytest.mark.parametrize("dtype", ["i1", "u1", ">i2", "u2", "i4", "i8", "f4", "f8"])
def test_whole_counts_of_any_type_are_kept_exactly(path: Path, dtype: str) -> None:
    values = (counts() % 100).astype(dtype)
    write(path, {"accel": values}, about())
    got = read(path)
    assert got.counts.dtype == ("i2" if dtype in ("i1", "u1", ">i2") else "i4")
    assert (got.counts == values).all()


def test_a_rare_fraction_among_whole_counts_is_a_bad_row(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracks, "BLOCK_ROWS", 1000)
    values = counts(20_000).astype(np.float32)
    values[3_000, 0] = 0.5
    write(path, {"accel": values}, about())
    got = read(path)
    assert (got.counts == np.delete(values, 3_000, axis=0)).all()
    assert (got.codes, got.breaks) == (["bad_row"], [3_000])


def test_axes_of_different_scales_are_refused(path: Path) -> None:
    write(path, columns(counts(), "x y z"), about())
    with h5py.File(path, "a") as file:
        file["y"].attrs.update(units="counts", lsb_per_g=512.0)
    with pytest.raises(UnreadableError, match="different counts per g"):
        read(path)
    assert read(path, lsb_per_g=256.0).recording.lsb_per_g == 256.0


# --- rows that are not there


@pytest.mark.parametrize("chunk_samples", [1, 7, 64, 333, 10**6])
def test_nothing_depends_on_the_chunk_size_even_with_damage(path: Path, chunk_samples: int) -> None:
    random = np.random.default_rng(8)
    values = counts() / 256.0
    values[random.random(ROWS) < 0.3] = np.nan
    values[random.random(ROWS) < 0.1] = 500.0
    stamps = START_US + np.arange(ROWS) * 10_000 + 50_000 * (random.random(ROWS) < 0.1)
    warm = np.where(random.random(ROWS) < 0.5, np.nan, 20 + np.arange(ROWS) / 100)
    columns = {"accel": values, "time": stamps.astype(np.int64), "temperature": warm}
    write(path, columns, about(units="g", lsb_per_g=None), chunks=(50, 3), compression="gzip")
    corrupt(path, "accel", 3)
    one, other = read(path, 200), read(path, chunk_samples)
    assert one.same_as(other)
    assert {"missing_value", "out_of_range", "clock_gap", "clock_back", "bad_page"} <= set(one.codes)


# --- temperature and gyroscope


@pytest.mark.parametrize(
    "warm",
    [np.full(9, 20.0), np.full(ROWS, np.nan), np.full(ROWS, 300, np.int16)],
    ids=["another length", "all missing", "counts of an unknown unit"],
)
def test_a_temperature_that_cannot_be_used_is_left_aside(path: Path, warm: np.ndarray) -> None:
    write(path, {"accel": counts(), "temperature": warm}, about())
    assert read(path).temperature is None


def test_a_gyroscope_in_counts_stays_in_counts(path: Path) -> None:
    write(path, {"imu/accel/xyz": counts(), "imu/gyroscope/xyz": counts(seed=5)}, about())
    assert read(path).gyro is None
    with h5py.File(path, "a") as file:
        file["imu/gyroscope/xyz"].attrs["lsb_per_dps"] = 16.4
    got = read(path)
    assert got.gyro is not None
    assert (got.gyro == counts(seed=5)).all()
    assert got.recording.gyro_dps_per_lsb == (1 / 16.4,) * 3


def test_what_the_user_says_of_a_gyroscope(path: Path) -> None:
    write(path, {"accel": counts(), "gyro": counts(seed=5), "w": counts(seed=6) / 16}, about())
    assert read(path).gyro is None
    got = read(path, lsb_per_dps=16.4)
    assert got.gyro is not None and (got.gyro == counts(seed=5)).all()
    got = read(path, gyro_columns=("w", "w", "w"), gyro_unit="deg/s")
    assert got.gyro is not None and (got.gyro == counts(seed=6).astype(int) * 4096).all()
    with pytest.raises(UsageError, match="-R gyro_columns"):
        read(path, gyro_columns=("gyro", "w", "w"))


# --- times


@pytest.mark.parametrize(
    ("start", "start_us", "zone"),
    [
        (START, START_US, None),
        (b"2024-03-04 00:00:00.250", START_US + 250_000, None),
        ("2024-03-04T02:00:00+02:00", START_US, "UTC"),
        ("2024-03-04T00:00:00Z", START_US, "UTC"),
        (1_709_510_400, START_US, "UTC"),
        (1_709_510_400.5, START_US + 500_000, "UTC"),
        ("1709510400", START_US, "UTC"),
        (np.int64(START_US), START_US, "UTC"),
    ],
)
def test_starts_are_understood(path: Path, start: Any, start_us: int, zone: str | None) -> None:
    write(path, {"accel": counts()}, about(start_time=start))
    assert (read(path).recording.start_us, read(path).recording.timezone) == (start_us, zone)


@pytest.mark.parametrize("start", [None, "yesterday", 12.0, "0001-01-01T00:00:00+05:00", -1e300])
def test_a_missing_start_is_told(path: Path, start: Any) -> None:
    write(path, {"accel": counts()}, about(start_time=start))
    got = read(path)
    assert (got.recording.start_us, got.codes, got.times[1]) == (None, ["no_start_time"], 10_000)


def test_the_time_zone_is_taken_from_an_attribute(path: Path) -> None:
    write(path, {"accel": counts()}, about(timezone="Europe/Berlin"))
    assert read(path).recording.timezone == "Europe/Berlin"
    write(path, {"accel": counts()}, about(timezone="Middle Earth"))
    assert read(path).recording.timezone is None
    assert "Middle Earth" in read(path).recording.notes[0]


def stamped(
    path: Path, values: np.ndarray, name: str = "time", unit: str | None = None, **changes: Any
) -> Path:
    write(path, {"accel": counts(len(values)), name: values}, about(**{"start_time": None, **changes}))
    if unit is not None:
        with h5py.File(path, "a") as file:
            file[name].attrs["Units"] = unit
    return path


@pytest.mark.parametrize("unit", ["us", "ms", "s", "ns"])
def test_stamps_in_any_unit(path: Path, unit: str) -> None:
    times = START_US + 10_000 * np.arange(ROWS)
    values = {"us": times, "ms": times // 1000, "s": times / 1e6, "ns": times * 1000}[unit]
    got = read(stamped(path, values, "Timestamp", unit, sample_rate=None))
    assert (got.times == times).all()
    assert (got.recording.rate_hz, got.recording.start_us, got.breaks) == (100.0, START_US, [])


@pytest.mark.parametrize("unit", ["s", "ms", None])
def test_stamps_from_zero_count_from_the_start(path: Path, unit: str | None) -> None:
    elapsed = np.arange(ROWS) / 100 * (1000 if unit == "ms" else 1)
    got = read(stamped(path, elapsed, unit=unit, start_time=START))
    assert (got.times == even_times(ROWS, 100.0)).all()
    got = read(stamped(path, elapsed, unit=unit))
    assert (got.times == even_times(ROWS, 100.0) - START_US).all()
    assert got.codes == ["no_start_time"]


def test_stamps_may_name_their_origin(path: Path) -> None:
    got = read(stamped(path, np.arange(ROWS) * 10, unit="milliseconds since 2024-03-04 00:00:00"))
    assert (got.times == even_times(ROWS, 100.0)).all()


# --- damage


def corrupt(path: Path, name: str, chunk: int) -> int:
    """Overwrite the middle of one HDF5 chunk; return where it begins."""
    with h5py.File(path, "r") as file:
        info = file[name].id.get_chunk_info(chunk)
    data = bytearray(path.read_bytes())
    middle = info.byte_offset + info.size // 2
    data[middle : middle + 8] = b"\xff" * 8
    path.write_bytes(data)
    return int(info.byte_offset)


@pytest.mark.parametrize("shape", ["wide", "columns", "transposed"])
def test_a_damaged_chunk_loses_its_rows_only(path: Path, shape: str) -> None:
    values = counts().T if shape == "transposed" else counts()
    chunks = {"wide": (50, 3), "columns": (50, 1), "transposed": (3, 50)}[shape]
    write(path, {"accel": values}, about(), chunks=chunks, compression="gzip")
    offset = corrupt(path, "accel", 3 if shape != "columns" else 9)
    got = read(path)
    kept = np.r_[0:150, 200:ROWS]
    assert (got.counts == counts()[kept]).all()
    assert (got.times == even_times(ROWS, 100.0)[kept]).all()
    assert got.breaks == [150]
    [problem] = got.problems
    assert (problem.code, problem.sample, problem.count) == ("bad_page", 150, 50)
    assert problem.byte_offset == offset


def test_a_checksum_of_hdf5_is_heeded(path: Path) -> None:
    write(path, {"accel": counts()}, about(), chunks=(50, 3), fletcher32=True)
    corrupt(path, "accel", 9)
    got = read(path)
    assert (got.counts == counts()[:450]).all()
    assert (got.codes, got.breaks) == (["bad_page"], [])


PACKINGS: dict[str, dict[str, Any]] = {
    "plain": {},
    "checksum": {"fletcher32": True},
    "shuffle": {"shuffle": True},
    "gzip": {"compression": "gzip", "shuffle": True},
    "gzip checksum": {"compression": "gzip", "fletcher32": True},
    "lzf that packs nothing": {"compression": "lzf"},
    "scaled": {"scaleoffset": 0},
}


def resize(path: Path, row: int, size: int) -> None:
    """Change the size of a chunk of 50 rows in the index, beside which its row and place stand."""
    with h5py.File(path, "r") as file:
        [info] = [
            info for k in range(10) if (info := file["accel"].id.get_chunk_info(k)).chunk_offset[0] == row
        ]
    data = bytearray(path.read_bytes())
    at = data.index(struct.pack("<QQQQ", row, 0, 0, info.byte_offset)) - 8
    assert struct.unpack_from("<I", data, at)[0] == info.size
    struct.pack_into("<I", data, at, size)
    path.write_bytes(data)


@pytest.mark.parametrize("packing", PACKINGS)
def test_a_chunk_of_an_impossible_size_is_lost(path: Path, packing: str) -> None:
    """Found by `make fuzz`: HDF5 read beyond a chunk too short for its checksum, and the process died."""
    for size in (0, 1, 3):
        write(path, {"accel": counts()}, about(), chunks=(50, 3), **PACKINGS[packing])
        assert (read(path).counts == counts()).all()
        resize(path, 200, size)
        got = read(path)
        assert (got.counts == np.delete(counts(), np.s_[200:250], axis=0)).all()
        assert (got.codes, got.breaks) == (["bad_page"], [200])


@pytest.mark.parametrize("packing", ["plain", "shuffle", "lzf that packs nothing"])
def test_rows_that_a_short_chunk_does_not_hold_are_not_made_up(path: Path, packing: str) -> None:
    """HDF5 fills such a chunk up with what lies in memory."""
    for size in (299, 150, 301):
        write(path, {"accel": counts()}, about(), chunks=(50, 3), **PACKINGS[packing])
        resize(path, 200, size)
        assert (read(path).counts == np.delete(counts(), np.s_[200:250], axis=0)).all()


def test_a_dataset_that_was_hardly_written_is_refused(path: Path) -> None:
    """Else a file of few megabytes keeps a run busy for minutes with a thousand million rows."""
    for rows in (20_000, 20_001):
        with h5py.File(path, "w") as file:
            dataset = file.create_dataset("accel", (rows, 3), "i2", chunks=(100, 3))
            dataset.attrs.update(about())
            dataset[:100] = counts()[:100]
        if rows == 20_000:
            assert len(read(path).counts) == 100
    with pytest.raises(UnreadableError, match="claims 20001 rows, of which only 100 were ever written"):
        read(path)


def elsewhere() -> h5py.VirtualLayout:
    layout = h5py.VirtualLayout((ROWS, 3), "i2")
    layout[:] = h5py.VirtualSource("other.h5", "accel", (ROWS, 3))
    return layout


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda file: file.create_dataset("accel", (ROWS, 3), "i2"), "never written"),
        (lambda file: file.create_dataset("accel", (ROWS, 3), "i2", chunks=(10, 3)), "never written"),
        (
            lambda file: file.create_dataset("accel", (10**12, 3), "i2", chunks=(100, 3)),
            "than the file can hold",
        ),
        (lambda file: file.create_virtual_dataset("accel", elsewhere()), "other files"),
    ],
)
def test_a_dataset_whose_values_are_not_there_is_refused(path: Path, make: Any, match: str) -> None:
    with h5py.File(path, "w") as file:
        dataset = make(file)
        dataset.attrs.update(about())
        if len(dataset) > ROWS:
            dataset[:100] = counts()[:100]
    with pytest.raises(UnreadableError, match=match):
        read(path)


def test_a_file_cut_short_gives_what_is_left(path: Path) -> None:
    with h5py.File(path, "w") as file:
        dataset = file.create_dataset("accel", (ROWS, 3), "i2", chunks=(50, 3), compression="gzip")
        dataset.attrs.update(about())
        dataset[:] = counts()
        place = dataset.id.get_chunk_info(6).byte_offset
    size = path.stat().st_size
    path.write_bytes(path.read_bytes()[: place + 20])
    got = read(path, 64)
    assert (got.counts == counts()[:300]).all()
    assert got.codes == ["bad_page", "truncated"]
    assert (got.problems[-1].count, got.problems[-1].sample) == (size - place - 20, 300)


def test_a_file_cut_short_before_its_description_is_refused(path: Path) -> None:
    write(path, {"accel": counts()}, about(), chunks=(50, 3), compression="gzip")
    path.write_bytes(path.read_bytes()[:4000])
    with pytest.raises(
        UnreadableError, match=r"byte 4000: is cut short to 4000 of \d+ bytes, so that .* copy the whole"
    ):
        read(path)


def test_a_file_cut_short_still_tells_its_sensors(path: Path) -> None:
    write(path, {"left/accel": counts(), "right/accel": counts(seed=4)}, about())
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(UnreadableError, match=r"is cut short to .*, so that several") as caught:
        read(path)
    assert caught.value.sensors == ("left", "right")


def tiny(path: Path, rows: int, **layout: Any) -> bytes:
    """Write a file of about 1 kB."""
    block = 1024 if layout else 512
    with h5py.File(path, "w", libver="latest", meta_block_size=block) as file:
        dataset = file.create_dataset("accel", (rows, 3), "i2", **layout)
        dataset.attrs.update(fs=100.0, lsb_per_g=256.0, start=START_US)
        dataset[:] = counts(rows)
    return path.read_bytes()


@every_byte
@pytest.mark.parametrize("layout", [{}, {"chunks": (16, 3), "compression": "gzip"}], ids=["plain", "packed"])
def test_cut_at_every_byte_it_gives_true_rows_or_our_error(
    path: Path, layout: dict[str, Any], capfd: pytest.CaptureFixture[str], step: int
) -> None:
    data = tiny(path, 40, **layout)
    whole = dict(zip(even_times(40, 100.0).tolist(), counts(40).tolist(), strict=True))
    short = path.with_name("short.h5")
    fates = set()
    for size in cuts(data, step, 1):
        short.write_bytes(data[:size])
        try:
            got = read(short)
        except UnreadableError as error:
            assert str(short) in str(error)
            fates.add("refused")
            continue
        rows = zip(got.times.tolist(), got.counts.tolist(), strict=True)
        assert all(whole[time] == row for time, row in rows)
        assert got.codes[-1] == "truncated"
        fates.add(f"shorter by {40 - len(got.counts)}")
    assert {"refused", "shorter by 8"} <= fates
    assert capfd.readouterr() == ("", "")


def test_a_damaged_heap_of_texts_does_not_hang(path: Path) -> None:
    write(path, {"accel": counts()}, about())
    data = bytearray(path.read_bytes())
    heap = data.index(b"GCOL")
    data[heap + 24] = 0xFF
    path.write_bytes(data)
    got = read(path)
    assert (got.counts == counts()).all()
    assert got.codes == ["no_start_time", "damaged_header"]


def test_sound_and_damaged_heaps() -> None:
    def item(number: int, length: int, size: int) -> bytes:
        return number.to_bytes(8, "little") + length.to_bytes(8, "little") + bytes(size)

    def heap(*items: bytes) -> bytes:
        return b"GCOL\1\0\0\0" + (4096).to_bytes(8, "little") + b"".join(items)

    text = item(1, 6, 8)
    assert heaps_are_sound(heap(text, item(0, 4096 - 16 - 24, 4040)))
    assert heaps_are_sound(heap(item(1, 4064, 4064)))
    assert not heaps_are_sound(bytes(99) + heap(text, item(0, 0, 4040)))
    assert not heaps_are_sound(heap(item(1, 2**63, 4064)))


# --- what is not read, and how


def test_the_signature_is_found_at_the_places_where_it_may_be(path: Path) -> None:
    for block, score in ((0, 90), (512, 90), (2048, 90)):
        with h5py.File(path, "w", userblock_size=block) as file:
            file.create_dataset("accel", data=counts()).attrs.update(about())
        assert HDF5.sniff(probe_file(path, ReadOptions())) == score
        assert (read(path).counts == counts()).all()
    path.write_bytes(bytes(100) + b"\x89HDF\r\n\x1a\n")
    assert HDF5.sniff(probe_file(path, ReadOptions())) == 0


def test_it_is_recognised_whatever_its_suffix(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mat", {"accel": counts()}, about())
    assert find_format(path, ReadOptions()).name == "hdf5"


@pytest.mark.parametrize(
    ("data", "message"),
    [(b"no HDF5 at all", "not an HDF5 file"), (gzip.compress(b"\x89HDF\r\n\x1a\n"), "gunzip")],
    ids=["another content", "packed"],
)
def test_other_files_are_refused(path: Path, data: bytes, message: str) -> None:
    path.write_bytes(data)
    with pytest.raises(UnreadableError, match=message):
        read(path)
    with pytest.raises(UnreadableError, match="file not found; check the path"):
        read(path.with_name("absent.h5"))


def test_it_can_be_read_twice_and_previewed(path: Path) -> None:
    write(path, {"accel": counts()}, about())
    with HDF5.open(path, ReadOptions()) as reader:
        one, two = (joined(reader.recording, reader.chunks(100)) for _ in range(2))
        assert one.same_as(two)
        pieces = list(reader.preview(20, 5))
        assert len(list(reader.preview(200, 5))) == 3
    assert [piece.first_sample for piece in pieces] == [0, 100, 200, 300, 400]
    assert all(
        (piece.counts == counts()[row : row + 20]).all()
        for row, piece in zip(range(0, 500, 100), pieces, strict=True)
    )
    assert pieces[1].clock.times(0, 1)[0] == START_US + 1_000_000


def test_text_that_is_not_utf_8_is_read_with_marks_in_its_place(path: Path, capsys: Capture) -> None:
    """Variable-length text, of which h5py passes on every byte."""
    still = np.tile(np.array([0, 0, 256], np.int16), (ROWS, 1))
    write(path, {"accel": still, "other": np.arange(3)}, about=about())
    text = h5py.string_dtype("utf-8")
    with h5py.File(path, "r+") as file:
        for name, value in (("serial", b"A\xff\xfeB"), ("model", b"M\xfc"), ("firmware", b"\xff")):
            file["accel"].attrs.create(name, np.array(value, dtype=object), dtype=text)
    device = HDF5.open(path, ReadOptions()).recording.device
    assert (device.serial, device.model, device.firmware) == ("A\ufffd\ufffdB", "M\ufffd", "\ufffd")
    assert run(capsys, "calibrate", path, "-q").code == 4
    assert "A\ufffd\ufffdB" in path.with_suffix(".calibration.json").read_text("utf-8")


def test_readable_text_can_always_be_written() -> None:
    texts = ["plain", "\xfcber", "a\udcff", "\udced\udca0\udc80"]
    assert [readable(text) for text in texts] == ["plain", "\xfcber", "a\ufffd", "\ufffd" * 3]


def test_times_since_1970_are_utc_whatever_the_attribute_names(path: Path) -> None:
    seconds = START_US / 1e6 + np.arange(len(counts())) / 100
    write(path, {"accel": counts(), "time": seconds}, about(timezone="Europe/Berlin", start_time=None))
    found = read(path).recording
    assert (found.timezone, found.start_us) == ("UTC", START_US)
    assert "its times are UTC; it names the time zone Europe/Berlin" in found.notes


@pytest.mark.parametrize("deep", [10, 1500])
def test_h6_groups_within_groups_cost_what_a_recording_costs(path: Path, deep: int) -> None:
    with h5py.File(path, "w") as file:
        group = file
        for _ in range(deep):
            group = group.create_group("g")
        group["acceleration"] = counts() / 1000
        group["acceleration"].attrs.update(unit="g", rate_hz=50.0)
    begun = time.process_time()
    if deep < 64:
        assert len(read(path).counts) == ROWS
    else:
        with pytest.raises(UnreadableError):
            read(path)
    assert time.process_time() - begun < 5


@pytest.mark.parametrize("dtype", [h5py.string_dtype(), h5py.string_dtype("utf-8", 9), "S9"])
def test_texts_are_cells_of_arrow(path: Path, dtype: Any) -> None:
    texts = [b"10:00:01", b"", b"  ", b"M\xc3\xbc", b"A\xff"]
    with h5py.File(path, "w") as file:
        dataset = file.create_dataset("time", (5,), dtype)
        for row, text in enumerate(texts):
            dataset[row] = text
        cells, good = TextDataset(file["time"]).read(0, 5)
        assert cells.type == "string"
        assert cells.to_pylist() == ["10:00:01", None, None, "M\xfc", "A\ufffd"]
        assert good.tolist() == [True] * 5
        cells, good = TextDataset(file["time"]).read(3, 4)
        assert (cells.to_pylist(), good.tolist()) == (["M\xfc"], [True])


def test_texts_that_cannot_be_read_are_lost_cells(path: Path) -> None:
    write(path, {"time": np.array([b"10:00:01", b"10:00:02"])}, chunks=(2,), fletcher32=True)
    corrupt(path, "time", 0)
    with h5py.File(path) as file:
        cells, good = TextDataset(file["time"]).read(0, 2)
    assert (cells.to_pylist(), good.tolist()) == ([None, None], [False, False])
