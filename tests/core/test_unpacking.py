"""Files packed in every way that is read: what comes out, what ends them, what a million members cost."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import random
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.core.unpacking import (
    PACKED_SUFFIXES,
    UnpackFault,
    packing_of,
    plain_name,
    unpacked,
)
from accelcal_cli.pipeline.jobs import stem
from tests.formats.make_csv import read, written

TEXT = b"".join(b"%d,%.4f,%.4f,1.0\n" % (10 * n, 0.01 * (n % 7), 0.002 * (n % 31)) for n in range(40_000))


def in_zstd(data: bytes) -> bytes:
    out = pa.BufferOutputStream()
    with pa.CompressedOutputStream(out, "zstd") as stream:
        stream.write(data)
    return bytes(out.getvalue())


PACK: dict[str, Callable[[bytes], bytes]] = {
    ".gz": gzip.compress,
    ".bz2": bz2.compress,
    ".xz": lzma.compress,
    ".zst": in_zstd,
}
every_packing = pytest.mark.parametrize("suffix", PACK)


def taken(packed: bytes) -> tuple[bytes, UnpackFault | None]:
    packing = packing_of(packed)
    assert packing is not None
    pieces = [*unpacked(io.BytesIO(packed), packing)]
    assert pieces[-1].end_byte <= len(packed)
    return b"".join(piece.data for piece in pieces), pieces[-1].fault


def test_every_suffix_is_tried() -> None:
    assert set(PACK) == set(PACKED_SUFFIXES)


@every_packing
def test_members_come_back_whole_and_empty_ones_cost_nothing(suffix: str) -> None:
    pack = PACK[suffix]
    assert taken(pack(TEXT)) == (TEXT, None)
    assert taken(pack(b"") * 3 + pack(TEXT) + pack(b"") + pack(b"end")) == (TEXT + b"end", None)
    assert taken(pack(b"")) == (b"", None)


@every_packing
def test_a_cut_gives_what_is_before_it(suffix: str) -> None:
    packed = PACK[suffix](TEXT) + PACK[suffix](TEXT[::-1])
    for size in (len(packed) * 2 // 5, len(packed) * 3 // 4, len(packed) - 1):
        data, fault = taken(packed[:size])
        assert fault is UnpackFault.CUT_OFF
        assert (TEXT + TEXT[::-1]).startswith(data)
        assert data or suffix == ".bz2"  # whose text is one block


@every_packing
def test_bytes_behind_the_data_are_something_else(suffix: str) -> None:
    assert taken(PACK[suffix](TEXT) + b"rubbish, and more of it") == (TEXT, UnpackFault.OTHER)


@pytest.mark.parametrize("suffix", [".gz", ".bz2", ".xz"])
def test_damage_within_is_told(suffix: str) -> None:
    """Arrow writes no checksum into a frame of Zstandard: there only what cannot be is seen, as below."""
    whole = random.Random(6).randbytes(3000) + TEXT
    dice, packed = random.Random(5), PACK[suffix](whole)
    for place in (dice.randrange(200, 2500) for _ in range(5)):
        spoiled = packed[:place] + bytes([packed[place] ^ 0x55]) + packed[place + 1 :]
        assert taken(spoiled)[1] is UnpackFault.DAMAGED


def test_zstandard_keeps_all_that_is_before_a_damaged_block() -> None:
    packed = in_zstd(TEXT)
    half = len(packed) // 2
    data, fault = taken(packed[:half] + b"\xff" * 2000 + packed[half + 2000 :])
    assert fault is UnpackFault.DAMAGED and TEXT.startswith(data) and len(data) >= 1 << 17


def test_a_window_of_zstandard_beyond_its_memory_is_no_damage() -> None:
    frame = bytes.fromhex("28b52ffd 00 90 0b0000") + b"x"
    data, fault = taken(frame)
    assert (data, fault) == (b"", UnpackFault.TOO_LARGE)


def test_what_begins_like_a_packing_by_chance_is_none() -> None:
    for head in (b"BZh,x,y,z\n1,2,3", b"BZh9rows\n", b"\xfd7z", b"", b"(\xb5/"):
        assert packing_of(head) is None


EMPTY = {
    "gzip": gzip.compress(b"", mtime=0),
    "gzip without a block": gzip.compress(b"", 0, mtime=7),
    "named": b"\x1f\x8b\x08\x08abcdefname\0" + b"\x03\0" + bytes(8),
    "bgzip": bytes.fromhex("1f8b08040000000000ff0600424302001b0003000000000000000000"),
    "bzip2": bz2.compress(b""),
    "xz": lzma.compress(b""),
    "xz without a check": lzma.compress(b"", check=lzma.CHECK_NONE),
}


@pytest.mark.parametrize("kind", EMPTY)
def test_h6_a_million_empty_members_are_passed_over(kind: str) -> None:
    pack = {"bz": bz2.compress, "xz": lzma.compress}.get(kind[:2], gzip.compress)
    pack = pack if kind != "bgzip" else gzip.compress
    packed = EMPTY[kind] * 1_000_000 + pack(b"1,2,3\n")
    began = time.process_time()
    assert taken(packed) == (b"1,2,3\n", None)
    assert time.process_time() - began < 1.0


@pytest.mark.parametrize("name", ["a.csv", "A.CSV"])
@every_packing
def test_names_lose_both_suffixes(name: str, suffix: str) -> None:
    assert plain_name(f"{name}{suffix.upper()}") == name
    assert stem(Path(f"{name}{suffix}")) == name[0]


@every_packing
def test_a_table_is_read_and_a_cut_one_up_to_the_cut(tmp_path: Path, suffix: str) -> None:
    lines = ["time,x,y,z", *(f"{n / 50:.2f},0.1,0.2,{0.95 + n / 1e6:.6f}" for n in range(90_000))]
    text = "\n".join([*lines, ""]).encode()
    whole, packed = read(written(tmp_path, text)), PACK[suffix](text)
    found = read(written(tmp_path, packed, f"b.csv{suffix}"))
    assert len(found.counts) == 90_000 and found.same_as(whole)
    cut = read(written(tmp_path, packed[: len(packed) * 4 // 5], f"c.csv{suffix}"))
    rows = len(cut.counts)
    assert 20_000 < rows < 90_000 and np.array_equal(cut.counts, whole.counts[:rows])
    assert "truncated" in cut.codes


@pytest.mark.parametrize("suffix", [".bz2", ".xz", ".zst"])
def test_nothing_that_can_be_unpacked_is_told(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.csv{suffix}"
    path.write_bytes(PACK[suffix](TEXT)[:12])
    with pytest.raises(
        UnreadableError, match=r"damaged \w+ data \(it is cut short\); copy it again from its"
    ):
        probe_file(path, ReadOptions())


def test_an_xz_file_that_takes_too_much_memory_is_told_how_to_be_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "a b.csv.xz"
    path.write_bytes(lzma.compress(TEXT, filters=[{"id": lzma.FILTER_LZMA2, "dict_size": 1 << 28}]))
    with pytest.raises(UnreadableError, match=r"more than 128 MB of memory; unpack it first: unxz -k '.*a b"):
        probe_file(path, ReadOptions())
