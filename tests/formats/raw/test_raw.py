"""Raw dumps: every number type, page key and kind of damage, on bytes built by hand."""

from __future__ import annotations

import gzip
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Chunk, Reader
from accelcal_cli.formats.raw import FORMAT
from tests.formats import reading
from tests.formats.cuts import cuts, every_byte
from tests.formats.make_raw import START_US, frames, make
from tests.formats.reading import all_of, check_same

RNG = np.random.default_rng(9)
COUNTS = RNG.integers(-2048, 2047, (1200, 3)).astype(np.int16)
PLAIN = ReadOptions(format="raw", rate_hz=100, lsb_per_g=256)
EPOCH_S = 1_709_510_400

Read = tuple[np.ndarray, np.ndarray, list[int], list[Chunk]]


def opened(folder: Path, data: bytes, layout: str | None = None, options: ReadOptions = PLAIN) -> Reader:
    (folder / "a.bin").write_bytes(data)
    if layout is not None:
        (folder / "a.layout.toml").write_text(layout)
        options = ReadOptions()
    return FORMAT.open(folder / "a.bin", options)


def problems(chunks: list[Chunk]) -> list[tuple[str, int | None, int, int]]:
    return [found for found in reading.problems(chunks) if found[0] != "no_start_time"]


def xyz(kind: str, size: int, extra: str = "") -> str:
    lines = [f'{axis} = {{ offset = {size * k}, type = "{kind}"{extra} }}' for k, axis in enumerate("xyz")]
    return "[fields]\n" + "\n".join(lines) + "\n"


def dump(**keys: object) -> str:
    known = {"rate_hz": 100.0, "lsb_per_g": 256.0} | keys
    lines = [f"{key} = {value!r}".replace("'", '"') for key, value in known.items()]
    return "[dump]\n" + "\n".join(lines) + "\n"


def test_a_dump_with_its_layout_beside_it(tmp_path: Path) -> None:
    expected = make(tmp_path, COUNTS[:900], 204.8, 2048.0)
    reader = FORMAT.open(expected.path, ReadOptions())
    counts, times, breaks, chunks = all_of(reader)
    recording = reader.recording
    assert np.array_equal(counts, COUNTS[:900])
    assert np.abs(times - expected.times_us).max() <= 1
    assert (breaks, problems(chunks)) == ([], [])
    assert (recording.rate_hz, recording.lsb_per_g, recording.range_g) == (204.8, 2048.0, 8.0)
    assert (recording.device.serial, recording.start_us, recording.samples) == ("012345", START_US, 900)
    assert recording.duration_s == pytest.approx(900 / 204.8, abs=1e-5)


def test_rate_and_scale_are_enough_for_plain_int16(tmp_path: Path) -> None:
    reader = opened(tmp_path, frames(COUNTS))
    counts, times, _, chunks = all_of(reader)
    assert np.array_equal(counts, COUNTS)
    assert counts.dtype == np.int16
    assert np.array_equal(times, np.arange(1200) * 10_000)
    assert reader.recording.start_us is None
    assert [problem.code for chunk in chunks for problem in chunk.problems] == ["no_start_time"]


def test_without_a_layout_there_is_a_hint(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match=r"--layout FILE or in a\.layout\.toml"):
        opened(tmp_path, frames(COUNTS), options=ReadOptions(format="raw"))


def test_what_the_user_says_goes_before_the_layout(tmp_path: Path) -> None:
    expected = make(tmp_path, COUNTS, 100, 256)
    options = ReadOptions(rate_hz=50, lsb_per_g=128, timezone="UTC")
    recording = FORMAT.open(expected.path, options).recording
    assert (recording.rate_hz, recording.lsb_per_g, recording.timezone) == (50, 128, "UTC")


def int24(order: str) -> Callable[[int], bytes]:
    return lambda value: value.to_bytes(3, "little" if order == "<" else "big", signed=True)


@pytest.mark.parametrize("endian", ["little", "big"])
@pytest.mark.parametrize(
    "number",
    [
        ("int8", "b", 8),
        ("uint8", "B", 8),
        ("int16", "h", 16),
        ("uint16", "H", 16),
        ("int24", "", 24),
        ("int32", "i", 32),
    ],
)
def test_whole_number_types_are_exact(tmp_path: Path, endian: str, number: tuple[str, str, int]) -> None:
    kind, code, bits = number
    size, low = bits // 8, 0 if kind.startswith("u") else -(1 << bits - 1)
    high = low + (1 << bits) - 1
    order = "<" if endian == "little" else ">"
    pack = (lambda value: struct.pack(order + code, value)) if code else int24(order)
    values = np.random.default_rng(size).integers(low, high, (40, 3), endpoint=True)
    values[:2] = [[low, high, 1], [0, high, low]]
    data = b"".join(pack(int(value)) for value in values.ravel())
    counts, *_ = all_of(opened(tmp_path, data, dump(endian=endian) + xyz(kind, size)))
    assert np.array_equal(counts, values)


def test_a_zero_is_taken_off(tmp_path: Path) -> None:
    values = np.array([[0, 32768, 65535], [32767, 32769, 40000]])
    data = struct.pack("<6H", *values.ravel().tolist())
    counts, *_ = all_of(opened(tmp_path, data, dump() + xyz("uint16", 2, ", zero = 32768")))
    assert np.array_equal(counts, values - 32768)
    assert counts.dtype == np.int16


def test_what_leaves_32_bits_is_left_out(tmp_path: Path) -> None:
    values = [[5, 6, 7], [2**31 - 1, 0, 0], [1, 2, 3]]
    data = struct.pack("<9i", *np.ravel(values).tolist())
    counts, times, breaks, chunks = all_of(opened(tmp_path, data, dump() + xyz("int32", 4, ", zero = -1")))
    assert counts.tolist() == [[6, 7, 8], [2, 3, 4]]
    assert times.tolist() == [0, 20_000]
    assert breaks == [1]
    assert problems(chunks) == [("missing_value", 0, 2, 1)]


def test_floats_become_counts_on_a_grid(tmp_path: Path) -> None:
    values = RNG.normal(0, 9.8, (300, 3)).astype(np.float32)
    layout = dump(lsb_per_g=9.80665) + xyz("float32", 4)
    reader = opened(tmp_path, values.astype("<f4").tobytes(), layout)
    counts, *_ = all_of(reader)
    assert reader.recording.lsb_per_g == FLOAT_LSB_PER_G
    assert counts.dtype == np.int32
    assert np.array_equal(counts, np.rint(values.astype(np.float64) / 9.80665 * 2**24))


@pytest.mark.parametrize("chunk_samples", [1, 256, 300, 5000])
def test_unusable_floats_are_left_out_with_a_break(tmp_path: Path, chunk_samples: int) -> None:
    values = RNG.normal(0, 1, (1500, 3)).astype(np.float32)
    bad = [0, 1, 255, 256, 257, 700, 1023, 1499]
    for row, value in zip(bad, [np.nan, np.inf, -np.inf, 128, -128, 1e38, np.nan, np.nan], strict=True):
        values[row, row % 3] = value
    layout = dump(lsb_per_g=1.0, start_time="2024-03-04T00:00:00") + xyz("float32", 4)
    counts, times, breaks, chunks = all_of(opened(tmp_path, values.tobytes(), layout), chunk_samples)
    kept = np.setdiff1d(np.arange(1500), bad)
    assert np.array_equal(counts, np.rint(values[kept].astype(np.float64) * 2**24))
    assert np.array_equal(times, START_US + kept * 10_000)
    assert breaks == [int(np.searchsorted(kept, row)) for row in (258, 701, 1024)]
    assert sum(count for *_, count in problems(chunks)) == len(bad)


def test_a_signalling_nan_is_left_out_without_a_warning(tmp_path: Path) -> None:
    """Converting one warns, which would reach the terminal."""
    rows = np.full((300, 3), 0.5, "<f4")
    bits = rows.view("<u4")
    bits[7, 1] = 0x7F800001
    found = all_of(opened(tmp_path, rows.tobytes(), dump() + xyz("float32", 4)))
    assert len(found[0]) == 299


def test_temperature_and_gyroscope(tmp_path: Path) -> None:
    fields = """temperature = { offset = 6, type = "int16", per_unit = 0.0078125, zero = 25.0 }
gx = { offset = 8, type = "int16", per_unit = 0.061 }
gy = { offset = 10, type = "int16", per_unit = 0.061 }
gz = { offset = 12, type = "int16", per_unit = 0.061, zero = 6.1 }
"""
    data = struct.pack("<7h", 1, 2, 3, 128, -4, 5, 6) + struct.pack("<7h", 7, 8, 9, -256, 10, 11, 12)
    reader = opened(tmp_path, data, dump() + xyz("int16", 2) + fields)
    (chunk,) = reader.chunks(10)
    assert chunk.temperature_mc is not None
    assert chunk.gyro_counts is not None
    assert chunk.temperature_mc.tolist() == [26_000, 23_000]
    assert chunk.gyro_counts.tolist() == [[-4, 5, 106], [10, 11, 112]]
    assert reader.recording.gyro_dps_per_lsb == (0.061, 0.061, 0.061)
    assert reader.recording.has_temperature


def test_float_gyroscope_and_temperature_with_gaps(tmp_path: Path) -> None:
    fields = "\n".join(
        f'{name} = {{ offset = {6 + 4 * k}, type = "float32" }}'
        for k, name in enumerate(("temperature", "gx", "gy", "gz"))
    )
    rows = [(1, 2, 3, 20.5, 1.5, -2.25, 300.0), (4, 5, 6, np.nan, 0, 0, 1), (7, 8, 9, 21, np.nan, 0, 0)]
    data = b"".join(struct.pack("<3h4f", *row) for row in rows)
    reader = opened(tmp_path, data, dump() + xyz("int16", 2) + fields + "\n")
    (chunk,) = reader.chunks(10)
    assert chunk.counts.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert chunk.temperature_mc is not None
    assert chunk.gyro_counts is not None
    assert chunk.temperature_mc.tolist() == [20_500, 20_500]
    scale = reader.recording.gyro_dps_per_lsb
    assert scale is not None
    assert (chunk.gyro_counts * np.array(scale)).tolist() == [[1.5, -2.25, 300.0], [0, 0, 1]]


def crc16_bit_by_bit(data: bytes) -> int:
    state = 0xFFFF
    for byte in data:
        state ^= byte << 8
        for _ in range(8):
            state = (state << 1 ^ 0x1021 if state & 0x8000 else state << 1) & 0xFFFF
    return state


def test_the_crc16_is_the_one_whose_check_value_is_29b1() -> None:
    assert crc16_bit_by_bit(b"123456789") == 0x29B1


CRC_SIZE = {"crc32": 4, "crc16-ccitt": 2}


def paged(
    *, crc: str | None = "crc32", time: bool = True, per_unit: float = 1.0, sequence: str = "uint32"
) -> str:
    """Pages of 128 bytes: 8 bytes of header, 19 frames of 6 bytes, 6 bytes for the checksum."""
    keys = [f'sequence = {{ offset = 0, type = "{sequence}" }}'] if sequence else []
    if time:
        keys.append(f'time = {{ offset = 4, type = "uint32", per_unit = {per_unit} }}')
    if crc:
        keys.append(f'crc = {{ offset = 124, type = "{crc}", covers = [0, 122] }}')
    sizes = dump(header_bytes=3, page_bytes=128, page_header_bytes=8, page_trailer_bytes=6)
    return sizes + xyz("int16", 2) + "[page]\n" + "\n".join(keys) + "\n"


def page(sequence: int, stamp: int, rows: np.ndarray, crc: str = "crc32", code: str = "<I") -> bytes:
    body = struct.pack(code, sequence).ljust(4, b"\0") + struct.pack("<I", stamp) + frames(rows)
    body = body.ljust(122, b"\xff")
    value = zlib.crc32(body) if crc == "crc32" else crc16_bit_by_bit(body)
    return (body.ljust(124, b"\0") + value.to_bytes(CRC_SIZE[crc], "little")).ljust(128, b"\0")


def rows_of(k: int) -> np.ndarray:
    return COUNTS[19 * k : 19 * k + 19]


def numbered(sequences: list[int], crc: str = "crc32") -> bytes:
    """Pages of 0.19 s stamped in whole seconds of their sequence number."""
    return b"HEA" + b"".join(page(k, EPOCH_S + 19 * k // 100, rows_of(k), crc) for k in sequences)


@pytest.mark.parametrize("crc", ["crc32", "crc16-ccitt"])
def test_pages_with_a_wrong_checksum_are_dropped_and_reported(tmp_path: Path, crc: str) -> None:
    data = bytearray(numbered(list(range(8)), crc))
    data[3 + 128 * 4 + 60] ^= 4
    data[3 + 128 * 5 + 124] ^= 1
    reader = opened(tmp_path, bytes(data), paged(crc=crc))
    counts, times, breaks, chunks = all_of(reader)
    assert np.array_equal(counts, np.concatenate((COUNTS[:76], COUNTS[114:152])))
    assert problems(chunks) == [("checksum", 3 + 512, 76, 2)]
    assert breaks == [76]
    assert times[76] - times[0] == 1_140_000


def test_missing_pages_shift_the_times(tmp_path: Path) -> None:
    reader = opened(tmp_path, numbered([0, 1, 2, 7, 8]), paged(time=False))
    counts, times, breaks, chunks = all_of(reader)
    assert problems(chunks) == [("sequence_gap", 3 + 384, 57, 4)]
    assert breaks == [57]
    assert np.array_equal(times, np.concatenate((np.arange(57), np.arange(133, 171))) * 10_000)
    assert reader.recording.samples is None
    assert reader.recording.duration_s == 1.71
    assert len(counts) == 95


@pytest.mark.parametrize(("sequence", "code", "top"), [("uint8", "<B", 256), ("uint16", "<H", 65536)])
def test_narrow_sequence_numbers_wrap(tmp_path: Path, sequence: str, code: str, top: int) -> None:
    numbers = [top - 2, top - 1, 0, 1, 3]
    data = b"HEA" + b"".join(page(n, 0, rows_of(k), code=code) for k, n in enumerate(numbers))
    _, _, breaks, chunks = all_of(opened(tmp_path, data, paged(time=False, sequence=sequence)))
    assert problems(chunks) == [("sequence_gap", 3 + 512, 76, 1)]
    assert breaks == [76]


def test_a_falling_sequence_number_is_a_break(tmp_path: Path) -> None:
    _, _, breaks, chunks = all_of(opened(tmp_path, numbered([3, 4, 1, 1]), paged(time=False)))
    assert problems(chunks) == [("sequence_back", 3 + 256, 38, 2)]
    assert breaks == [38, 57]


def test_stamps_of_whole_seconds_leave_a_nominal_recording_evenly_spaced(tmp_path: Path) -> None:
    _, times, breaks, chunks = all_of(opened(tmp_path, numbered(list(range(60))), paged()), 100)
    assert np.array_equal(times, EPOCH_S * 1_000_000 + np.arange(1140) * 10_000)
    assert (breaks, problems(chunks)) == ([], [])


@pytest.mark.parametrize(
    "real_rate", [94.0, 100.01, *(pytest.param(rate, marks=pytest.mark.nightly) for rate in (97.3, 104.0))]
)
def test_times_follow_a_sensor_that_is_off_its_nominal_rate(tmp_path: Path, real_rate: float) -> None:
    count = 2000
    rows = rows_of(0)
    stamps = [int(EPOCH_S + 19 * k / real_rate) for k in range(count)]
    data = b"HEA" + b"".join(page(k, stamp, rows) for k, stamp in enumerate(stamps))
    reader = opened(tmp_path, data, paged())
    _, times, breaks, chunks = all_of(reader, 700)
    truth = EPOCH_S * 1e6 + np.arange(19 * count) / real_rate * 1e6
    assert np.abs(times - truth).max() < 2_100_000
    assert (np.diff(times) > 0).all()
    assert (breaks, problems(chunks)) == ([], [])
    assert np.array_equal(all_of(reader, 1 << 20)[1], times)


@pytest.mark.parametrize(
    ("jump", "code"), [(3600, "clock_gap"), (-3600, "clock_back"), (1, None), (4, "clock_gap")]
)
def test_a_jump_of_stamps_of_whole_seconds(tmp_path: Path, jump: int, code: str | None) -> None:
    stamps = [EPOCH_S + 19 * k // 100 + (jump if k >= 10 else 0) for k in range(20)]
    data = b"HEA" + b"".join(page(k, stamp, rows_of(k)) for k, stamp in enumerate(stamps))
    _, times, breaks, chunks = all_of(opened(tmp_path, data, paged()))
    expected = [] if code is None else [(code, 3 + 1280, 190, 1)]
    assert problems(chunks) == expected
    assert breaks == [190] * len(expected)
    if code:
        assert times[190] == stamps[10] * 1_000_000


def test_fine_stamps_place_every_page(tmp_path: Path) -> None:
    ticks = [1_000_000 + 200 * k for k in range(6)]
    data = b"HEA" + b"".join(page(k, tick, rows_of(k)) for k, tick in enumerate(ticks))
    _, times, breaks, _ = all_of(opened(tmp_path, data, paged(per_unit=0.001)))
    assert times[::19].tolist() == [tick * 1000 for tick in ticks]
    assert times[1] - times[0] == round(200_000 / 19)
    assert breaks == []


def test_frames_that_were_never_written_are_not_samples(tmp_path: Path) -> None:
    erased = b"\xff" * 6
    reader = opened(tmp_path, frames(COUNTS[:700]) + erased * 5000 + b"\xff" * 5)
    counts, _, breaks, chunks = all_of(reader)
    assert np.array_equal(counts, COUNTS[:700])
    assert (breaks, problems(chunks)) == ([], [])
    assert reader.recording.samples == 700


@pytest.mark.parametrize("chunk_samples", [1, 1 << 20])
def test_a_few_bytes_behind_frames_that_were_never_written_are_no_damage(
    tmp_path: Path, chunk_samples: int
) -> None:
    stamped = [page(k, EPOCH_S + k, rows_of(k)) for k in range(4)]
    unused = stamped[3][:8] + b"\xff" * (len(stamped[3]) - 8)
    reader = opened(tmp_path, b"HEA" + b"".join(stamped[:3]) + unused + b"\xff" * 5, paged(crc=None))
    assert "truncated" not in [code for code, *_ in problems(all_of(reader, chunk_samples)[3])]


def test_erased_flash_between_frames_is_a_gap(tmp_path: Path) -> None:
    data = frames(COUNTS[:512]) + b"\xff" * 6 * 512 + frames(COUNTS[512:600])
    _, times, breaks, chunks = all_of(opened(tmp_path, data))
    assert breaks == [512]
    assert problems(chunks) == [("bad_page", 3072, 512, 2)]
    assert times[512] == 10_240_000


@pytest.mark.parametrize("chunk_samples", [1, 19, 57, 500])
def test_rows_times_breaks_and_problems_do_not_depend_on_the_chunk_size(
    tmp_path: Path, chunk_samples: int
) -> None:
    stamped = [page(k, EPOCH_S + k // 5, rows_of(k % 60)) for k in range(90)]
    stamped[20:24] = []
    stamped[40] = b"\0" + stamped[40][1:]
    stamped[70:70] = [b"\xff" * 128] * 3
    reader = opened(tmp_path, b"HEA" + b"".join(stamped), paged())
    first, second = list(reader.chunks(1 << 20)), list(reader.chunks(chunk_samples))
    check_same(first, second)
    assert len(problems(first)) == 3


@every_byte
@pytest.mark.parametrize("layout", [None, paged()])
def test_cut_at_every_byte_it_is_shorter_or_unreadable(tmp_path: Path, layout: str | None, step: int) -> None:
    data = frames(COUNTS[:120]) if layout is None else numbered([0, 1, 2, 3])
    head, unit, rows = (0, 6, 1) if layout is None else (3, 128, 19)
    for size in cuts(data, step, 1):
        whole, rest = divmod(max(0, size - head), unit)
        try:
            counts, _, _, chunks = all_of(opened(tmp_path, data[:size], layout))
        except UnreadableError:
            assert whole == 0
            continue
        assert np.array_equal(counts, COUNTS[: whole * rows])
        offset = head + whole * unit
        assert rest == 0 or problems(chunks) == [("truncated", offset, whole * rows, rest)]


def test_a_gzip_dump_reads_alike(tmp_path: Path) -> None:
    (tmp_path / "a.bin.gz").write_bytes(gzip.compress(numbered(list(range(9)))))
    (tmp_path / "a.layout.toml").write_text(paged())
    reader = FORMAT.open(tmp_path / "a.bin.gz", ReadOptions())
    assert np.array_equal(all_of(reader)[0], COUNTS[:171])
    assert [len(piece) for piece in reader.preview(57, 2)] == [57, 57]


def test_a_dump_without_a_usable_page_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match=r"page\.crc covers"):
        opened(tmp_path, b"HEA" + b"\1" * 1280, paged())
    with pytest.raises(UnreadableError, match="no whole page of 128 bytes"):
        opened(tmp_path, b"HEA" + b"\1" * 100, paged())
    with pytest.raises(UnreadableError, match="no usable sample"):
        opened(tmp_path, b"\xff" * 6000)


def test_preview_enters_the_file_at_evenly_spread_pages(tmp_path: Path) -> None:
    reader = opened(tmp_path, frames(np.tile(COUNTS, (20, 1))))
    pieces = list(reader.preview(512, 4))
    assert len(pieces) == 4
    for piece in pieces:
        assert len(piece) == 512
        first = piece.first_sample
        assert np.array_equal(piece.counts, np.tile(COUNTS, (20, 1))[first : first + 512])
        assert piece.clock.times(0, 1)[0] == first * 10_000


def test_sniff_trusts_layouts_only(tmp_path: Path) -> None:
    def score(name: str, options: ReadOptions) -> int:
        (tmp_path / name).write_bytes(b"123456")
        return FORMAT.sniff(probe_file(tmp_path / name, options))

    plain = ReadOptions()
    assert score("a.bin", plain) == 0
    assert score("a.raw", ReadOptions(rate_hz=1, lsb_per_g=1)) == 30
    assert score("a.bin", ReadOptions(layout=tmp_path / "any.toml")) == 100
    (tmp_path / "layout.toml").touch()
    assert (score("a.bin", plain), score("a.csv", plain)) == (40, 0)
    (tmp_path / "a.layout.toml").touch()
    assert (score("a.bin", plain), score("a.RAW", plain), score("a.csv", plain)) == (95, 95, 0)


NILSPOD = """[dump]
rate_hz = 204.8
lsb_per_g = 2048.0
range_g = 16.0
frame_bytes = 20
[fields]
gx = { offset = 0, type = "int16", per_unit = 0.06103515625 }
gy = { offset = 2, type = "int16", per_unit = 0.06103515625 }
gz = { offset = 4, type = "int16", per_unit = 0.06103515625 }
x = { offset = 6, type = "int16" }
y = { offset = 8, type = "int16" }
z = { offset = 10, type = "int16" }
"""


@pytest.mark.parametrize("name", ["nilspod_84965c0.bin", "nilspod_92338c81.bin"])
def test_a_real_dump_of_20_byte_frames(tmp_path: Path, real_data: Path, name: str) -> None:
    path, layout = real_data / "imu" / name, tmp_path / "nilspod.toml"
    layout.write_text(NILSPOD)
    reader = FORMAT.open(path, ReadOptions(layout=layout))
    table = np.fromfile(path, "<i2").reshape(-1, 10)
    counts, _, _, chunks = all_of(reader, 10_000)
    gyro = np.concatenate([chunk.gyro_counts for chunk in chunks])
    assert np.array_equal(counts, table[:, 3:6])
    assert np.array_equal(gyro, table[:, :3])
    assert problems(chunks) == []
    assert reader.recording.samples == len(table)
    assert 0.95 < np.median(np.linalg.norm(counts / reader.recording.lsb_per_g, axis=1)) < 1.05


def in_bounded_memory(code: str, *arguments: object) -> str:
    """What code prints with 200 MB more than its libraries take."""
    head = (
        "import resource, sys\nfrom pathlib import Path\n"
        "import accelcal_cli.formats.raw.reader, pyarrow\n"
        "from accelcal_cli.core.formats import ReadOptions\nfrom accelcal_cli.formats.raw import FORMAT\n"
        "used = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (used + (200 << 20),) * 2)\n"
    )
    command = [sys.executable, "-c", head + code, *map(str, arguments)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout.strip()


def test_long_frames_are_read_in_bounded_memory(tmp_path: Path) -> None:
    """20 000 frames of 64 KiB, in a file that takes no room on the disk."""
    with (tmp_path / "a.bin").open("wb") as file:
        file.truncate(20_000 << 16)
    (tmp_path / "a.layout.toml").write_text(dump(frame_bytes=1 << 16) + xyz("int16", 2))
    code = (
        "chunks = FORMAT.open(Path(sys.argv[1]), ReadOptions()).chunks(1 << 18)\n"
        "print(len(next(chunk for chunk in chunks if len(chunk))))"
    )
    assert in_bounded_memory(code, tmp_path / "a.bin") == "256"


@pytest.mark.parametrize("zone", [None, "Europe/Berlin"])
def test_pages_stamped_beyond_the_year_9999_are_refused(tmp_path: Path, zone: str | None) -> None:
    page = struct.pack("<I", 0xFFFF_0000) + b"\1" * 60
    keys = dump(page_bytes=64, page_header_bytes=4) + xyz("int16", 2)
    layout = keys + '[page]\ntime = { offset = 0, type = "uint32", per_unit = 60 }\n'
    (tmp_path / "a.bin").write_bytes(page * 3)
    (tmp_path / "a.layout.toml").write_text(layout)
    with pytest.raises(UnreadableError, match="begins outside the years 1 to 9999"):
        FORMAT.open(tmp_path / "a.bin", ReadOptions(timezone=zone))
