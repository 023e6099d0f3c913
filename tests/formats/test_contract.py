"""What every format must hold, on a file made by its `make_<name>.py`."""

from __future__ import annotations

import gzip
import importlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import AccelcalError, NoFormatError
from accelcal_cli.core.formats import HEAD_BYTES, Format, Probe, ReadOptions, probe_file, wide_text
from accelcal_cli.core.recording import Chunk, Reader
from accelcal_cli.formats import all_formats, find_format, open_recording
from accelcal_cli.formats.raw import find_layout
from tests.formats.expected import Expected
from tests.formats.reading import breaks, check_same, joined, rows, times

HERE = Path(__file__).parent
RATE_HZ = 50.0
LSB_PER_G = 256.0
FORMATS = all_formats()


def counts() -> np.ndarray:
    random = np.random.RandomState(11)
    return random.randint(-500, 500, (1200, 3)).astype(np.int16)


@pytest.fixture(params=FORMATS, ids=lambda item: item.name)
def made(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Format, Expected]:
    maker = importlib.import_module(f"tests.formats.make_{request.param.name}")
    return request.param, maker.make(tmp_path, counts(), RATE_HZ, LSB_PER_G)


def whole(reader: Reader, chunk_samples: int) -> list[Chunk]:
    return list(reader.chunks(chunk_samples))


@pytest.mark.parametrize("item", FORMATS, ids=lambda item: item.name)
def test_each_format_has_its_test_and_its_maker(item: Format) -> None:
    assert list(HERE.glob(f"*/test_{item.name}.py"))
    assert (HERE / f"make_{item.name}.py").exists()


def test_its_content_is_recognised(made: tuple[Format, Expected]) -> None:
    item, expected = made
    assert find_format(expected.path, expected.options).name == item.name


def test_none_is_taken_for_text_in_utf_16(made: tuple[Format, Expected]) -> None:
    _, expected = made
    files = [file for file in expected.path.parent.iterdir() if file.is_file()]
    assert [wide_text(file.read_bytes()[:HEAD_BYTES]) for file in files] == [None] * len(files)


def test_every_sample_and_time_comes_back(made: tuple[Format, Expected]) -> None:
    item, expected = made
    with item.open(expected.path, expected.options) as reader:
        chunks = whole(reader, 300)
        lsb = reader.recording.lsb_per_g
        assert reader.recording.rate_hz == expected.rate_hz
        if expected.serial is not None:
            assert reader.recording.device.serial == expected.serial
    np.testing.assert_array_equal(rows(chunks) / lsb, expected.counts_g)
    assert breaks(chunks) == []
    if expected.times_us is not None:
        assert np.abs(times(chunks) - expected.times_us).max() <= expected.tolerance_us


def all_names(path: Path) -> Iterator[Path]:
    data = path.read_bytes()
    for suffix in ("", *sorted({suffix for item in FORMATS for suffix in item.suffixes})):
        plain = path.with_name(f"{path.name.split('.')[0]}{suffix}")
        plain.write_bytes(data)
        yield plain
        packed = path.with_name(f"{plain.name}.gz")
        packed.write_bytes(gzip.compress(data, 1))
        yield packed


@pytest.mark.parametrize("layout", [None, Path("named.layout.toml")])
def test_the_suffix_decides_only_whom_to_ask_first(
    made: tuple[Format, Expected], layout: Path | None
) -> None:
    _, expected = made
    options = replace(expected.options, layout=layout or expected.options.layout)
    for path in all_names(expected.path):
        probe = probe_file(path, options)
        confidence, name = max((item.sniff(probe), item.name) for item in FORMATS)
        if confidence:
            assert find_format(path, options).name == name
        else:
            with pytest.raises(NoFormatError):
                find_format(path, options)


def test_an_opal_file_is_one_with_a_suffix_that_hdf5_alone_has(tmp_path: Path) -> None:
    expected = importlib.import_module("tests.formats.make_opal").make(tmp_path, counts(), RATE_HZ, LSB_PER_G)
    path = expected.path.rename(tmp_path / "a.hdf5")
    assert find_format(path, ReadOptions()).name == "opal"


def never_asked(_: Probe) -> int:
    raise AssertionError("the format of the suffix was certain")


def test_who_has_a_suffix_to_itself_and_is_certain_is_the_only_one_asked(
    made: tuple[Format, Expected], monkeypatch: pytest.MonkeyPatch
) -> None:
    item, expected = made
    probe = probe_file(expected.path, expected.options)
    if probe.suffix not in item.suffixes or item.sniff(probe) < 100 or probe.options.layout is not None:
        pytest.skip("is not certain by its suffix and content")
    others = [replace(other, suffixes=(), sniff=never_asked) for other in FORMATS if other is not item]
    monkeypatch.setattr("accelcal_cli.formats.all_formats", lambda: (*others, item))
    assert find_format(expected.path, expected.options) is item


@pytest.mark.parametrize(
    "chunk_samples",
    [1, pytest.param(7, marks=pytest.mark.nightly), 80, pytest.param(1000, marks=pytest.mark.nightly), 10**6],
)
def test_the_rows_do_not_depend_on_the_chunk_size(made: tuple[Format, Expected], chunk_samples: int) -> None:
    item, expected = made
    with item.open(expected.path, expected.options) as reader:
        one, other = whole(reader, 300), whole(reader, chunk_samples)
    check_same(one, other)


@pytest.mark.parametrize("chunk_samples", [7, 1000])
def test_the_rows_do_not_depend_on_the_threads(made: tuple[Format, Expected], chunk_samples: int) -> None:
    _, expected = made
    with open_recording(expected.path, expected.options) as one:
        alone = whole(one, chunk_samples)
    with open_recording(expected.path, expected.options, threads=3) as several:
        together = whole(several, chunk_samples)
        assert several.threads == 3
    assert (rows(alone) == rows(together)).all()
    assert (times(alone) == times(together)).all()
    assert [len(chunk) for chunk in alone] == [len(chunk) for chunk in together]


def test_chunks_follow_one_another(made: tuple[Format, Expected]) -> None:
    item, expected = made
    with item.open(expected.path, expected.options) as reader:
        position, byte = 0, 0
        for chunk in reader.chunks(100):
            assert chunk.first_sample == position
            assert chunk.end_byte >= byte
            position, byte = position + len(chunk), chunk.end_byte
            assert chunk.counts.dtype in (np.int16, np.int32)
            assert chunk.counts.shape == (len(chunk), 3)
        if reader.recording.samples is not None:
            assert reader.recording.samples == position
        assert byte <= reader.recording.total_bytes


def test_chunks_do_not_share_memory_that_changes(made: tuple[Format, Expected]) -> None:
    item, expected = made
    with item.open(expected.path, expected.options) as reader:
        kept = [(chunk, chunk.counts.copy()) for chunk in reader.chunks(64)]
    assert all((chunk.counts == copy).all() for chunk, copy in kept)


def test_a_preview_is_part_of_the_recording(made: tuple[Format, Expected]) -> None:
    item, expected = made
    with item.open(expected.path, expected.options) as reader:
        everything = {tuple(row) for row in rows(whole(reader, 500)).tolist()}
        pieces = list(reader.preview(50, 4))
    assert 1 <= len(pieces) <= 4
    assert {tuple(row) for row in rows(pieces).tolist()} <= everything


@pytest.mark.parametrize("name", ["cwa", "edf", "flash", "genea", "geneactiv", "parmay", "raw", "wav"])
def test_a_gzip_file_reads_alike_and_one_cut_short_is_told(name: str, tmp_path: Path) -> None:
    maker = importlib.import_module(f"tests.formats.make_{name}")
    expected = maker.make(tmp_path, counts(), RATE_HZ, LSB_PER_G)
    options = replace(expected.options, format=name)
    with open_recording(expected.path, options) as reader:
        plain = joined(reader.recording, reader.chunks(300))
    packed, path = gzip.compress(expected.path.read_bytes(), 1), expected.path.with_name("packed.gz")
    for data, end in ((packed, 1200), (packed[: len(packed) * 3 // 4], 1199)):
        path.write_bytes(data)
        with open_recording(path, replace(options, layout=find_layout(expected.path, options))) as reader:
            first, *others = (joined(reader.recording, reader.chunks(size)) for size in (1, 300, 10**6))
        assert all(first.same_as(other) for other in others)
        count = len(first.counts)
        assert 600 <= count <= end and (count == 1200) == (end == 1200)
        assert np.array_equal(first.counts, plain.counts[:count])
        assert end < 1200 or np.array_equal(first.times, plain.times)
        warm = None if plain.temperature is None else plain.temperature[:count]
        assert first.temperature is warm or np.array_equal(first.temperature, warm)
        assert first.breaks == []
        assert set(first.codes) - {"no_start_time"} == ({"truncated"} if end < 1200 else set())


def test_a_file_of_no_format_is_refused_with_a_hint(tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    path.write_bytes(bytes(range(256)) * 100)
    with pytest.raises(AccelcalError, match="--format"):
        open_recording(path, ReadOptions())
