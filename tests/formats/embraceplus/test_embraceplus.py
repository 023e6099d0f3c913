"""EmbracePlus: both ways to state the scale, what lies beside, and files that claim too much."""

from __future__ import annotations

import gzip
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.errors import AccelcalError, UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Reader
from accelcal_cli.formats import find_format
from accelcal_cli.formats.embraceplus import FORMAT
from tests.formats.cuts import cuts, every_byte
from tests.formats.make_embraceplus import (
    MARKER,
    NONE,
    SERIAL,
    START_US,
    array,
    container,
    long,
    record,
    schema,
    sensor,
    session,
    text,
    written,
)

COUNTS = np.random.default_rng(6).integers(-32768, 32768, (640, 3))
TURNING = np.random.default_rng(7).integers(-32768, 32768, (640, 3))
RANGES = (-16, 16, -32768, 32767)


def opened(folder: Path, data: bytes, **options: Any) -> Reader:
    path = folder / "1-1-001_1709510400.avro"
    path.write_bytes(data)
    return FORMAT.open(path, ReadOptions(**options))


def rows(reader: Reader, name: str = "counts", chunk_samples: int = 100) -> np.ndarray:
    return np.concatenate([getattr(chunk, name) for chunk in reader.chunks(chunk_samples)])


def problems(reader: Reader) -> list[str]:
    return [problem.code for chunk in reader.chunks(100) for problem in chunk.problems]


def test_a_file_by_conversion_factor(tmp_path: Path) -> None:
    with opened(tmp_path, written(COUNTS, 2048.0)) as reader:
        assert np.array_equal(rows(reader), COUNTS)
        assert np.array_equal(rows(reader, "time_us"), START_US + np.arange(640) * 15_625)
        about = reader.recording
        assert (about.rate_hz, about.lsb_per_g, about.range_g) == (64.0, 2048.0, None)
        assert (about.start_us, about.timezone, about.samples) == (START_US, "UTC", 640)
        device = about.device
        assert (device.model, device.serial, device.firmware) == ("EmbracePlus", SERIAL, "3.1.2")
        assert about.notes == ("the wearer's clock was UTC+01:00; times are UTC",)
        assert problems(reader) == []


@pytest.mark.parametrize(
    ("version", "factor", "lsb_per_g"),
    [
        ((6, 4, 0), None, 65535 / 32),
        ((6, 4, 9), 0.5, 65535 / 32),
        ((6, 5, 0), 0.25, 4.0),
        ((7, 0, 0), 0.0, 65535 / 32),
    ],
)
def test_the_schema_decides_which_scale_counts(
    tmp_path: Path, version: tuple[int, int, int], factor: float | None, lsb_per_g: float
) -> None:
    body = session(sensor(COUNTS, RANGES, factor, block=7), sensor(NONE, RANGES, factor), version=version)
    for codec in ("null", "deflate"):
        with opened(tmp_path, container(body, schema(factor is not None), codec)) as reader:
            assert np.array_equal(rows(reader), COUNTS)
            assert reader.recording.lsb_per_g == pytest.approx(lsb_per_g, rel=1e-15)
            assert reader.recording.range_g == 16.0


def test_gyroscope_and_temperature_come_along(tmp_path: Path) -> None:
    warm = [30.0, float("nan"), 31.5, 1e9, *[32.25] * 5]
    body = session(sensor(COUNTS, RANGES, 0.001), sensor(TURNING, RANGES, 0.0625), temperature=warm)
    with opened(tmp_path, container(body, schema(True))) as reader:
        assert reader.recording.gyro_dps_per_lsb == (0.0625,) * 3
        assert np.array_equal(rows(reader, "gyro_counts"), TURNING)
        heat = rows(reader, "temperature_mc")
        assert heat[::64].tolist() == [30_000, 30_000, 31_500, 31_500, *[32_250] * 6]


@pytest.mark.parametrize("change", [{"start_us": START_US + 20_000}, {"rows": 639}])
def test_a_gyroscope_of_other_samples_is_not_used(tmp_path: Path, change: dict[str, int]) -> None:
    gyro = sensor(TURNING[: change.get("rows", 640)], RANGES, 1.0, start_us=change.get("start_us", START_US))
    with opened(tmp_path, container(session(sensor(COUNTS, RANGES, 0.001), gyro), schema(True))) as reader:
        assert reader.recording.gyro_dps_per_lsb is None
        assert any("gyroscope is not used" in note for note in reader.recording.notes)


def test_damage_that_can_be_read_is_told(tmp_path: Path) -> None:
    data = written(COUNTS, 2048.0)
    for damaged, codes in (
        (data[:-1], ["checksum"]),
        (data[:-16] + bytes(16), ["checksum"]),
        (data + b"x", ["bad_page"]),
    ):
        with opened(tmp_path, damaged) as reader:
            assert np.array_equal(rows(reader), COUNTS)
            assert problems(reader) == codes
    body = session(sensor(COUNTS, RANGES, 0.001), sensor(NONE, RANGES, 1.0))
    with opened(tmp_path, container(body * 2, schema(True), records=2)) as reader:
        assert np.array_equal(rows(reader), COUNTS)
        assert problems(reader) == ["bad_page"]
    short = long(START_US) + struct.pack("<f", 64) + b"".join(map(long, RANGES)) + struct.pack("<d", 0.001)
    short += b"".join(array([long(5)] * count) for count in (30, 32, 31))
    with opened(tmp_path, container(session(short, sensor(NONE, RANGES, 1.0)), schema(True))) as reader:
        assert (len(rows(reader)), problems(reader)) == (30, ["unequal_lengths"])


@pytest.mark.parametrize(
    ("accelerometer", "words"),
    [
        (sensor(NONE, RANGES, 0.001), "holds no acceleration"),
        (sensor(COUNTS + (1 << 30) * 3, RANGES, 0.001), "holds no acceleration"),
        (sensor(COUNTS, (0, 0, 0, 0), float("nan")), "how many counts make one g"),
        (sensor(COUNTS, RANGES, 1e-12), "how many counts make one g"),
        (sensor(COUNTS, RANGES, 0.001, rate_hz=0.0), "does not state its sampling rate.*--rate"),
    ],
)
def test_what_cannot_be_used_is_refused(tmp_path: Path, accelerometer: bytes, words: str) -> None:
    body = session(accelerometer, sensor(NONE, RANGES, 1.0))
    with pytest.raises(UnreadableError, match=words):
        opened(tmp_path, container(body, schema(True)))


def test_the_rate_is_the_users_where_the_file_has_none(tmp_path: Path) -> None:
    body = session(sensor(COUNTS, RANGES, 0.001, rate_hz=0.0), sensor(NONE, RANGES, 1.0))
    assert opened(tmp_path, container(body, schema(True)), rate_hz=64.0).recording.rate_hz == 64.0
    with pytest.raises(UsageError, match="made at 64 Hz, not 32"):
        opened(tmp_path, written(COUNTS, 2048.0), rate_hz=32.0)


def bomb(depth: int) -> dict[str, Any]:
    """Records in records that take no bytes: two to the power of the depth."""
    kind: Any = record("R0", [("a", "null"), ("b", "null")])
    for level in range(1, depth):
        kind = record(f"R{level}", [("a", kind), ("b", f"R{level - 1}")])
    return record("rawData", [("accelerometer", kind)])


@pytest.mark.parametrize(
    ("schema_json", "body", "words"),
    [
        ("int", long(5), "not that of a record"),
        ({"type": "record", "name": "rawData", "fields": [{"name": 1}]}, b"", "its schema is damaged"),
        (record("rawData", [("a", "nowhere")]), b"", "does not say what 'nowhere' is"),
        (record("rawData", [("a", ["null"])]), long(3), "of no known type"),
        (record("rawData", [("a", {"type": "array", "items": "null"})]), long(1 << 60), "claims"),
        (record("rawData", [("a", {"type": "array", "items": "int"})]), long(1 << 60), "claims"),
        (record("rawData", [("a", {"type": "array", "items": "double"})]), long(1 << 60), "claims"),
        (record("rawData", [("a", {"type": "map", "values": "null"})]), long(1 << 60), "claims"),
        (record("rawData", [("a", "bytes")]), long(1 << 60), "ends early"),
        (record("rawData", [("a", "bytes")]), long(-5), "ends early"),
        (record("rawData", [("a", "long")]), b"\xff" * 30, "has no end"),
        (record("rawData", [("a", {"type": "fixed", "name": "f", "size": "x"})]), b"", "ends early"),
        (bomb(28), b"", "nested too deep"),
        (bomb(60), b"", "nested too deep"),
    ],
)
def test_claims_of_a_file_take_no_memory(tmp_path: Path, schema_json: Any, body: bytes, words: str) -> None:
    with pytest.raises(UnreadableError, match=words):
        opened(tmp_path, container(body, schema_json))


def test_what_unpacks_without_end_is_refused(tmp_path: Path) -> None:
    huge = container(bytes(70 << 20), record("rawData", [("a", "null")]))
    with pytest.raises(UnreadableError, match="unpacks to more than 64 MB"):
        opened(tmp_path, huge)
    with pytest.raises(UnreadableError, match="has more than 64 MB"):
        opened(tmp_path, gzip.compress(b"Obj\x01" + bytes(65 << 20), 1))


@pytest.mark.parametrize(
    ("codec", "words"), [("snappy", "packed with snappy"), ("bzip2", "packed data are damaged")]
)
def test_other_ways_of_packing(tmp_path: Path, codec: str, words: str) -> None:
    with pytest.raises(UnreadableError, match=words):
        opened(tmp_path, container(b"no such packing" * 9, schema(True), codec))


def test_other_avro_files_are_not_taken_for_it(tmp_path: Path) -> None:
    path = tmp_path / "a.avro"
    path.write_bytes(container(long(5), "int"))
    with pytest.raises(UnreadableError, match="format not recognised"):
        find_format(path, ReadOptions())
    path.write_bytes(gzip.compress(written(COUNTS, 2048.0)))
    assert find_format(path, ReadOptions()) is FORMAT


@every_byte
@pytest.mark.parametrize("codec", ["null", "deflate"])
def test_truncation_at_every_byte_gives_all_or_one_clear_error(tmp_path: Path, codec: str, step: int) -> None:
    data = written(COUNTS[:40], 2048.0, codec=codec)
    for size in cuts(data, step):
        try:
            with opened(tmp_path, data[:size]) as reader:
                assert np.array_equal(rows(reader), COUNTS[:40])
                assert problems(reader) == ["checksum"]
        except AccelcalError as error:
            assert "1-1-001_1709510400.avro" in str(error) and error.hint
            assert size < len(data) - len(MARKER)


def test_fastavro_reads_and_writes_the_same(tmp_path: Path) -> None:
    fastavro = pytest.importorskip("fastavro")
    path = tmp_path / "theirs.avro"
    path.write_bytes(written(COUNTS, 2048.0))
    with path.open("rb") as file:
        (fields,) = fastavro.reader(file)
    accel = fields["rawData"]["accelerometer"]
    assert np.array_equal(np.stack([accel[axis] for axis in "xyz"], axis=1), COUNTS)
    accel |= {axis: column.tolist() for axis, column in zip("xyz", (COUNTS // 3).T, strict=True)}
    fields["rawData"]["gyroscope"] |= {axis: [70, -70_000, 2**31 - 1] for axis in "xyz"}
    for codec in ("null", "deflate", "bzip2"):
        with path.open("wb") as file:
            fastavro.writer(
                file, fastavro.parse_schema(json.loads(json.dumps(schema(True)))), [fields], codec
            )
        with FORMAT.open(path, ReadOptions()) as reader:
            assert np.array_equal(rows(reader), COUNTS // 3)
            assert problems(reader) == []


def test_text_is_what_avro_says() -> None:
    """The examples of the specification: 0, -1, 1, -2, 2, -64, 64; and "foo"."""
    assert [long(value).hex() for value in (0, -1, 1, -2, 2, -64, 64)] == [
        "00",
        "01",
        "02",
        "03",
        "04",
        "7f",
        "8001",
    ]
    assert text("foo").hex() == "06666f6f"
