"""omconvert's sound files: channels and scales, what the last channel says, and damage."""

from __future__ import annotations

import wave
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk, Recording, Validity
from accelcal_cli.formats import find_format, open_recording
from tests.formats.cuts import cuts, every_byte
from tests.formats.make_wav import AXES, START_US, chunk, comment, form, header, samples
from tests.formats.reading import breaks, told
from tests.formats.reading import column as joined

COUNTS = np.random.RandomState(3).randint(-9000, 9000, (1000, 3))
DATA = samples(COUNTS)
OPTIONS = ReadOptions()
UNAVAILABLE, CLIPPED, WARM, LIGHT = 0x8000, 0x4000, 0x0C00, 0x0800


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.wav"


def written(path: Path, data: bytes = DATA, head: bytes | None = None) -> Path:
    path.write_bytes((header(len(data)) if head is None else head) + data)
    return path


def read(path: Path, options: ReadOptions = OPTIONS, size: int = 300) -> tuple[Recording, list[Chunk]]:
    with open_recording(path, options) as reader:
        return reader.recording, list(reader.chunks(size))


def test_the_header_tells_device_time_scale_and_rate(path: Path) -> None:
    recording, chunks = read(written(path))
    assert (recording.lsb_per_g, recording.range_g, recording.rate_hz) == (4096.0, 8.0, 100.0)
    assert (recording.device.model, recording.device.serial, recording.device.firmware) == (
        "CWA",
        "37727",
        "44",
    )
    assert (recording.start_us, recording.timezone, recording.duration_s) == (START_US, None, 10.0)
    assert any("resampled" in note for note in recording.notes)
    assert (joined(chunks, "counts") == COUNTS).all()
    assert (joined(chunks, "time_us") == START_US + np.arange(1000) * 10_000).all()
    assert (told(chunks), breaks(chunks)) == ([], [])
    assert sum(chunk.used_bytes for chunk in chunks) == len(DATA)


def test_the_samples_are_those_of_python_s_own_reader(path: Path) -> None:
    """`wave` reads what is of kind 1: the same file, without the longer form."""
    plain = form(4, 100, tag=1)
    written(path, head=header(len(DATA), fmt=chunk(b"fmt ", plain[8:24])))
    with wave.open(str(path)) as file:
        assert (file.getnchannels(), file.getframerate()) == (4, 100)
        values = np.frombuffer(file.readframes(-1), "<i2").reshape(-1, 4)
    assert (joined(read(path)[1], "counts") == values[:, :3]).all()


def test_a_scale_of_16(path: Path) -> None:
    recording, _ = read(written(path, head=header(len(DATA), said=comment(scales=(16, 16, 16)))))
    assert (recording.lsb_per_g, recording.range_g) == (2048.0, 16.0)


def test_samples_not_measured_are_a_gap_and_clipped_ones_are_marked(path: Path) -> None:
    aux = np.zeros(1000, np.int64)
    aux[100:150] = UNAVAILABLE
    aux[400] |= UNAVAILABLE | LIGHT | 5
    aux[500:503] = CLIPPED
    values = COUNTS.copy()
    values[600, 1] = 32_767
    _, chunks = read(written(path, samples(values, aux)))
    kept = np.delete(np.arange(1000), [*range(100, 150), 400])
    assert (joined(chunks, "counts") == values[kept]).all()
    assert breaks(chunks) == [100, 350]
    assert (joined(chunks, "time_us") == START_US + kept * 10_000).all()
    assert told(chunks) == [
        ("missing_value", 1024 + 800, 100, 50, 0),
        ("missing_value", 1024 + 3200, 350, 1, 0),
    ]
    flags = np.concatenate(
        [np.zeros(len(part)) if part.validity is None else part.validity for part in chunks]
    )
    assert np.flatnonzero(flags == Validity.CLIPPED).tolist() == [449, 450, 451, 549]


def test_temperatures_are_held_until_the_next(path: Path) -> None:
    aux = np.zeros(1000, np.int64)
    aux[[102, 502, 602]] = WARM | np.array([256, 260, 0])
    aux[[101, 501]] = LIGHT | 700
    recording, chunks = read(written(path, samples(COUNTS, aux)))
    warm = joined(chunks, "temperature_mc")
    assert recording.has_temperature
    assert (warm == np.repeat([25_000, 25_000, 26_172], [102, 400, 498])).all()


def test_rotation_rates_of_an_ax6(path: Path) -> None:
    labels = (*AXES, "Gyro-X", "Gyro-Y", "Gyro-Z")
    data = samples(np.hstack([COUNTS, COUNTS[::-1]]))
    said = comment(labels, (8, 8, 8, 2000, 2000, 2000))
    recording, chunks = read(written(path, data, header(len(data), channels=7, said=said)))
    assert recording.gyro_dps_per_lsb == (2000 / 32_768,) * 3
    assert (joined(chunks, "gyro_counts") == COUNTS[::-1]).all()
    assert (joined(chunks, "counts") == COUNTS).all()


def test_other_sounds_are_no_recordings(path: Path) -> None:
    written(path, head=header(len(DATA), said="Time: 2018-03-18 17:24:47.536"))
    with pytest.raises(UnreadableError, match="format not recognised"):
        find_format(path, OPTIONS)
    with pytest.raises(UnreadableError, match="channels of x, y and z"):
        read(path, ReadOptions(format="wav"))
    written(path, head=header(len(DATA), fmt=form(4, 100, bits=8)))
    with pytest.raises(UnreadableError, match="8 bits"):
        read(path)


def test_without_one_scale_it_must_be_given(path: Path) -> None:
    written(path, head=header(len(DATA), said=comment(scales=(8, 8, 0))))
    with pytest.raises(UnreadableError, match="--lsb-per-g"):
        read(path)
    assert read(path, ReadOptions(lsb_per_g=4096.0))[0].lsb_per_g == 4096.0


def test_the_time_may_stand_in_the_date_alone_or_nowhere(path: Path) -> None:
    said = comment().replace("Time: ", "Tim: ")
    assert read(written(path, head=header(len(DATA), said=said)))[0].start_us == START_US
    recording, chunks = read(written(path, head=header(len(DATA), said=said, date="yesterday")))
    assert recording.start_us is None
    assert [code for code, *_ in told(chunks)] == ["no_start_time"]


def test_a_rate_that_contradicts_the_header_is_refused(path: Path) -> None:
    with pytest.raises(UsageError, match="100 Hz, not 25"):
        read(written(path), ReadOptions(rate_hz=25.0))


@every_byte
def test_cut_anywhere(path: Path, step: int) -> None:
    data = written(path, DATA[:1200]).read_bytes()
    for length in cuts(data, step):
        path.write_bytes(data[:length])
        whole, left = divmod(max(0, length - 1024), 8)
        if not whole:
            with pytest.raises(UnreadableError, match=r"a\.wav"):
                read(path, ReadOptions(format="wav"))
            continue
        _, chunks = read(path)
        assert (joined(chunks, "counts") == COUNTS[:whole]).all()
        end = 1024 + 8 * whole
        part = [("truncated", end, whole, left, left)] if left else []
        assert told(chunks) == [*part, ("truncated", end, whole, 150 - whole, 0)]


def test_chunks_behind_the_samples_are_none_of_them(path: Path) -> None:
    path.write_bytes(header(len(DATA)) + DATA + chunk(b"LIST", b"INFO1234"))
    _, chunks = read(path)
    assert (joined(chunks, "counts") == COUNTS).all()
    assert told(chunks) == []


def test_a_size_that_is_too_small_does_not_hide_samples(path: Path) -> None:
    written(path, head=header(0))
    _, chunks = read(path, size=250)
    assert (joined(chunks, "counts") == COUNTS).all()
    assert [code for code, *_ in told(chunks)] == ["damaged_header"]


def test_damaged_chunks_before_samples_at_their_usual_place(path: Path) -> None:
    head = bytearray(header(len(DATA)))
    junk = head.index(b"JUNK")
    head[junk + 4 : junk + 8] = b"\xff" * 4
    _, chunks = read(written(path, head=bytes(head)))
    assert (joined(chunks, "counts") == COUNTS).all()
    assert [code for code, *_ in told(chunks)] == ["damaged_header"]
    head[1016:1020] = b"atad"
    with pytest.raises(UnreadableError, match="chunks"):
        read(written(path, head=bytes(head)))


def test_a_preview_enters_the_file_anywhere(path: Path) -> None:
    with open_recording(written(path), OPTIONS) as reader:
        pieces = list(reader.preview(50, 4))
    assert [piece.first_sample for piece in pieces] == [0, 250, 500, 750]
    assert (pieces[2].counts == COUNTS[500:550]).all()
    assert pieces[2].time_us[0] == START_US + 5_000_000
    assert not any(piece.problems for piece in pieces)


def test_a_recording_that_begins_later_than_its_file(path: Path) -> None:
    aux = np.zeros(1000, np.int64)
    aux[:300] = UNAVAILABLE
    recording, chunks = read(written(path, samples(COUNTS, aux)))
    assert recording.start_us == joined(chunks, "time_us")[0] == START_US + 3_000_000
    assert breaks(chunks) == []
    aux[:] = UNAVAILABLE
    with pytest.raises(UnreadableError, match="no sample that was measured"):
        read(written(path, samples(COUNTS, aux)))
