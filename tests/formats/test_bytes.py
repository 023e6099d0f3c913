"""Deflate data: what comes out, and where damage ends it. Neither library nor thread ahead changes that."""

from __future__ import annotations

import gzip
import io
import random
import threading
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core import unpacking as inflate
from accelcal_cli.core.errors import AccelcalError, UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.unpacking import PACKINGS, Inflater, Piece, UnpackFault, unpacked
from accelcal_cli.formats import open_recording
from accelcal_cli.formats._bytes import ByteSource
from tests.formats.cuts import cuts, every_byte
from tests.formats.make_gt3x import info, seconds, zipped

TEXT = b"".join(b"%d,%.4f,%.4f,1.0\n" % (10 * n, 0.01 * (n % 7), 0.002 * (n % 31)) for n in range(400))
MIXED = TEXT[:3000] + bytes(2000) + random.Random(1).randbytes(700) + TEXT[:900]
WAYS = [
    (9, zlib.Z_DEFAULT_STRATEGY),
    (1, zlib.Z_FIXED),
    (6, zlib.Z_HUFFMAN_ONLY),
    (0, zlib.Z_DEFAULT_STRATEGY),
]
"""Levels and strategies that make blocks of all kinds."""


def deflated(data: bytes, level: int = 9, strategy: int = zlib.Z_DEFAULT_STRATEGY) -> bytes:
    packer = zlib.compressobj(level, zlib.DEFLATED, -zlib.MAX_WBITS, 8, strategy)
    return packer.compress(data) + packer.flush()


HEAD = b"\x1f\x8b\x08\0\0\0\0\0\0\xff"


def member(data: bytes, head: bytes = HEAD) -> bytes:
    ends = zlib.crc32(data).to_bytes(4, "little") + len(data).to_bytes(4, "little")
    return head + deflated(data) + ends


def gunzipped(file: io.BytesIO) -> Iterator[Piece]:
    return unpacked(file, PACKINGS[0])


def taken(packed: bytes) -> tuple[bytes, UnpackFault | None, int]:
    """What comes out of a gzip file, why it ends, and how far it was unpacked."""
    pieces = [*gunzipped(io.BytesIO(packed))]
    assert all(piece.data for piece in pieces[:-1]) and not pieces[-1].data
    assert [piece.fault for piece in pieces[:-1]] == [None] * (len(pieces) - 1)
    return b"".join(piece.data for piece in pieces), pieces[-1].fault, pieces[-1].end_byte


def told(packed: bytes) -> tuple[bytes, type[Exception] | None]:
    """What Python's gzip module gives, byte by byte, and what it raises."""
    data, file = b"", gzip.GzipFile(fileobj=io.BytesIO(packed))
    try:
        while piece := file.read(1):
            data += piece
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        return data, type(error)
    return data, None


def mutants(data: bytes, number: int, seed: int) -> Iterator[bytes]:
    dice = random.Random(seed)
    for _ in range(number):
        spoiled = bytearray(data)
        for _ in range(dice.choice((1, 1, 1, 2, 6))):
            spoiled[dice.randrange(min(len(spoiled), dice.choice((60, 10**9))))] ^= 1 << dice.randrange(8)
        yield bytes(spoiled[: dice.randrange(len(spoiled))] if dice.random() < 0.2 else spoiled)


Both = Callable[[Callable[[], object]], None]


@pytest.fixture
def both() -> Both:
    """Asserts that something is the same with zlib-ng and with zlib."""
    fast = pytest.importorskip("zlib_ng.zlib_ng")

    def same(found: Callable[[], object]) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(inflate, "deflate", zlib)
            plain = found()
            patch.setattr(inflate, "deflate", fast)
            assert found() == plain

    return same


# --- gzip files, against Python's own module


@pytest.mark.parametrize("size", [0, 1, (1 << 18) - 1, 1 << 18, (1 << 18) + 1, 3 << 18, 1_000_000])
def test_a_file_comes_back_whole(size: int) -> None:
    for data in (bytes(size), (MIXED * (size // len(MIXED) + 1))[:size]):
        packed = member(data)
        assert taken(packed) == (data, None, len(packed))


def test_members_follow_one_another_and_zeros_fill_up() -> None:
    every = b"\x1f\x8b\x08\x1e\0\0\0\0\0\xff" + b"\3\0abc" + b"name\0" + b"comment\0" + b"\1\2"
    packed = member(MIXED) + member(b"") + member(TEXT, every) + bytes(70_000) + member(b"end") + bytes(9)
    assert taken(packed) == (MIXED + TEXT + b"end", None, len(packed)) == (*told(packed), len(packed))


@pytest.mark.parametrize(
    ("packed", "found"),
    [
        (member(TEXT) + b"rubbish", (TEXT, UnpackFault.OTHER, len(member(TEXT)))),
        (member(TEXT) + bytes(3) + b"\x1f", (TEXT, UnpackFault.CUT_OFF, len(member(TEXT)) + 4)),
        (member(TEXT)[:-8] + bytes(8), (TEXT, UnpackFault.DAMAGED, len(member(TEXT)))),
        (member(TEXT) + b"\x1f\x8b\x07" + bytes(7), (TEXT, UnpackFault.DAMAGED, len(member(TEXT)) + 10)),
        (member(TEXT)[:-1], (TEXT, UnpackFault.CUT_OFF, len(member(TEXT)) - 1)),
        (member(TEXT) + member(b"")[:4], (TEXT, UnpackFault.CUT_OFF, len(member(TEXT)) + 4)),
    ],
)
def test_what_ends_a_file_is_told(packed: bytes, found: tuple[bytes, UnpackFault, int]) -> None:
    assert taken(packed) == found


@every_byte
def test_a_file_cut_short_gives_what_python_gives_of_it(step: int) -> None:
    packed = member(MIXED) + member(TEXT)
    for size in cuts(packed, step, len(member(b""))):
        data, fault, end = taken(packed[:size])
        whole = size == len(member(MIXED))
        assert (data, fault, end) == (told(packed[:size])[0], None if whole else UnpackFault.CUT_OFF, size)


def test_a_damaged_file_gives_all_that_is_before_the_damage() -> None:
    kinds = {None: None, EOFError: UnpackFault.CUT_OFF}
    number = 0
    for packed in mutants(member(MIXED) + member(TEXT), 100, 4):
        (data, fault, _), (known, error) = taken(packed), told(packed)
        if error is not gzip.BadGzipFile:
            assert fault is kinds.get(error, UnpackFault.DAMAGED)
            number += error is zlib.error
        if error is zlib.error:
            assert data.startswith(known)
        else:
            assert data == known
    assert number > 10


def test_damage_ends_a_stream_at_the_same_byte_however_it_is_fed() -> None:
    for level, strategy in WAYS:
        for packed in mutants(deflated(MIXED, level, strategy), 6, 5):
            found = set()
            for step in (1, 7, 100, len(packed) + 1):
                inflater, parts = Inflater(), []
                for start in range(0, len(packed), step):
                    inflater.put(packed[start : start + step])
                    while not (inflater.needs_input or inflater.damaged or inflater.complete):
                        parts.append(inflater.take())
                found.add((b"".join(parts), inflater.damaged, inflater.complete))
            assert len(found) == 1


# --- the same with both libraries


def test_every_truncation_and_mutants_of_gzip_are_the_same(both: Both) -> None:
    packed = member(MIXED) + bytes(40) + member(TEXT)
    for size in range(len(packed) + 1):
        both(lambda size=size: taken(packed[:size]))
    for mutant in mutants(packed, 300, 6):
        both(lambda mutant=mutant: taken(mutant))
    for level, strategy in WAYS:
        for mutant in mutants(deflated(MIXED, level, strategy), 200, 7):
            both(lambda mutant=mutant: taken(HEAD + mutant + bytes(8)))


def log_of_30_hz() -> bytes:
    counts = np.random.default_rng(2).integers(-300, 300, (30 * 40, 3)).astype(np.int16)
    counts[400:900] = counts[400]
    return zipped({"info.txt": info(30), "log.bin": b"".join(seconds(counts, 30))})


def outcome(path: Path, threads: int = 1, **options: object) -> object:
    """All that a reader says of a file: its rows and problems, or its error."""
    found: list[object] = []
    try:
        with open_recording(path, ReadOptions(**options), threads) as reader:  # type: ignore[arg-type]
            for chunk in reader.chunks(1000):
                times = chunk.time_us.tobytes()
                found.append((chunk.counts.tobytes(), times, chunk.breaks.tolist(), chunk.problems))
    except AccelcalError as error:
        found.append(str(error))
    return found


@pytest.mark.parametrize("number", [15, pytest.param(800, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("name", ["a.gt3x", "a.csv.gz"])
def test_damaged_recordings_are_read_the_same(tmp_path: Path, name: str, number: int, both: Both) -> None:
    data = log_of_30_hz() if name == "a.gt3x" else member(b"t,x,y,z\n" + TEXT)
    options = {} if name == "a.gt3x" else {"unit": "g", "rate_hz": 100.0}
    cuts = (data[:size] for size in range(1, len(data), max(1, len(data) // number)))
    for spoiled in (*cuts, *mutants(data, number, 8)):
        (tmp_path / name).write_bytes(spoiled)
        both(lambda: outcome(tmp_path / name, **options))


# --- a thread ahead


@pytest.mark.parametrize("name", ["a.gt3x", "a.csv.gz"])
def test_a_thread_ahead_changes_nothing(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of sound and of damaged files; unpacked in small steps, so that several are ahead."""
    monkeypatch.setattr(inflate, "STEP_BYTES", 100)
    monkeypatch.setattr("accelcal_cli.formats.gt3x.records.PIECE_BYTES", 500)
    data = log_of_30_hz() if name == "a.gt3x" else member(b"t,x,y,z\n" + TEXT)
    options = {} if name == "a.gt3x" else {"unit": "g", "rate_hz": 100.0}
    for spoiled in (data, data[: len(data) // 2], *mutants(data, 8, 9)):
        (tmp_path / name).write_bytes(spoiled)
        alone = outcome(tmp_path / name, **options)
        assert outcome(tmp_path / name, 2, **options) == alone
        assert outcome(tmp_path / name, 4, **options) == alone
    assert not ahead()


def ahead() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("prefetch")]


@pytest.mark.parametrize("name", ["a.gt3x", "a.csv.gz"])
def test_leaving_early_ends_the_thread(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("accelcal_cli.formats.gt3x.records.PIECE_BYTES", 500)
    monkeypatch.setattr(inflate, "MOST_BYTES", 500)
    (tmp_path / name).write_bytes(log_of_30_hz() if name == "a.gt3x" else member(b"t,x,y,z\n" + 30 * TEXT))
    options = ReadOptions() if name == "a.gt3x" else ReadOptions(unit="g", rate_hz=100.0)
    with open_recording(tmp_path / name, options, 2) as reader:
        chunks = reader.chunks(60)
        assert len(next(chunks))
        assert ahead()
        chunks.close()  # type: ignore[attr-defined]
        assert not ahead()


@pytest.mark.parametrize("threads", [1, 2])
def test_places_in_the_file_go_with_the_bytes_that_were_taken(tmp_path: Path, threads: int) -> None:
    """Not with those that are unpacked ahead; here in files of 36 MB that are packed in 36 kB."""
    (tmp_path / "a.gz").write_bytes(member(bytes(12_000_000)) * 3)
    with ByteSource(tmp_path / "a.gz", threads) as source:
        places = []
        while len(source.read(inflate.MOST_BYTES)):
            places.append(source.disk_position())
        assert len(places) == 36 and places == sorted(places)
        assert 0 < places[0] < source.file_bytes / 30
        assert places[-1] < source.file_bytes == source.disk_position()
        assert not source.broken


def test_no_more_is_unpacked_ahead_than_is_bounded(tmp_path: Path) -> None:
    (tmp_path / "a.gz").write_bytes(member(bytes(100_000_000)))
    tracemalloc.start()
    with ByteSource(tmp_path / "a.gz", 2) as source:
        while len(source.read(inflate.MOST_BYTES)):
            pass
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * inflate.MOST_BYTES


@pytest.mark.parametrize("threads", [1, 2])
def test_a_failing_disk_is_told_where_the_bytes_would_have_come(tmp_path: Path, threads: int) -> None:
    (tmp_path / "a.gz").write_bytes(member(random.Random(3).randbytes(3 * inflate.STEP_BYTES)))

    class Failing(io.FileIO):
        def readinto(self, buffer: object) -> int:  # type: ignore[override]
            if self.tell() >= 2 * inflate.STEP_BYTES:
                raise OSError(5, "Input/output error")
            return super().readinto(buffer)  # type: ignore[arg-type]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "open", lambda path, _mode: io.BufferedReader(Failing(path)))
        source = ByteSource(tmp_path / "a.gz", threads)
    with source, pytest.raises(UnreadableError, match=r"a\.gz: cannot be read \(Input/output error\)"):
        while len(source.read(1000)):
            pass
    assert not ahead()


class Counted(io.BytesIO):
    """Counts the bytes that are read."""

    taken = 0

    def read(self, count: int | None = -1) -> bytes:
        piece = super().read(count)
        self.taken += len(piece)
        return piece


def test_h13_millions_of_short_gzip_members_are_not_read_again_and_again() -> None:
    """What follows a member is unread; a quarter of a megabyte of it was, for each of 20 bytes."""
    file = Counted(gzip.compress(b"") * 2000 + gzip.compress(b"1,2,3\n"))
    pieces = [*gunzipped(file)]
    assert b"".join(one.data for one in pieces) == b"1,2,3\n" and pieces[-1].fault is None
    assert file.taken < 2000 * 17_000


def test_the_name_of_a_gzip_member_has_an_end() -> None:
    named = b"\x1f\x8b\x08\x08" + bytes(6) + b"n" * 700_000 + b"\0" + gzip.compress(b"1,2,3\n")[10:]
    file = Counted(named)
    assert [*gunzipped(file)][-1].fault is UnpackFault.DAMAGED
    assert file.taken < 600_000
