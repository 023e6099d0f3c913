"""The older kind of ActiGraph recordings: activity.bin, without times and checksums."""

from __future__ import annotations

import io
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.core.recording import Device, Validity
from accelcal_cli.formats.gt3x import sniff
from tests.formats.gt3x.reading import opened, random_counts, whole
from tests.formats.make_gt3x import OLD_SERIAL, START_US, old_info, packed, written_old, zipped

RATE = 30
VALUES = random_counts(1001)
DOCUMENT = bytes.fromhex("006008EBD007009EBF007008EBF0")
"""The example of fileformats/activity.bin.md, three samples in the order y, x, z."""


def test_the_documents_example(tmp_path: Path) -> None:
    path = written_old(tmp_path / "a.gt3x", DOCUMENT)
    assert whole(path).counts.tolist() == [[8, 6, -323], [9, 7, -321], [8, 7, -321]]
    given = np.round(whole(path).counts / opened(path).recording.lsb_per_g, 3)
    assert given.tolist() == [[0.023, 0.018, -0.947], [0.026, 0.021, -0.941], [0.023, 0.021, -0.941]]


@pytest.mark.parametrize("rows", [1, 2, 1000, 1001])
def test_samples_and_times(tmp_path: Path, rows: int) -> None:
    path = written_old(tmp_path / "a.gt3x", packed(VALUES[:rows]))
    found = whole(path, 77)
    assert (found.counts == VALUES[:rows]).all()
    assert found.times.tolist() == [START_US + (2 * k * 10**6 + RATE) // (2 * RATE) for k in range(rows)]
    assert (found.breaks, found.found, opened(path).recording.samples) == ([], [], rows)


def test_settings(tmp_path: Path) -> None:
    path = written_old(tmp_path / "a.gt3x", packed(VALUES))
    recording = opened(path).recording
    assert recording.device == Device("GT3XPlus", OLD_SERIAL, "2.5.0")
    assert (recording.lsb_per_g, recording.range_g, recording.rate_hz) == (341, 6, 30)
    assert (recording.start_us, recording.duration_s) == (START_US, 1001 / 30)
    assert sniff(probe_file(path, ReadOptions())) == 100
    with pytest.raises(UsageError, match="no second sensor"):
        opened(path, sensor="imu")


def test_without_info_txt_the_rate_must_be_given(tmp_path: Path) -> None:
    path = tmp_path / "a.gt3x"
    path.write_bytes(zipped({"activity.bin": packed(VALUES)}))
    with pytest.raises(UnreadableError, match="--rate"):
        opened(path)
    found = whole(path, rate_hz=30.0)
    assert (found.counts == VALUES).all()
    assert found.found == [("damaged_header", None, 0, 1), ("no_start_time", None, 0, 1)]
    assert (opened(path, rate_hz=30.0).recording.start_us, found.times[0]) == (None, 0)


def asleep(lengths: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Runs of equal samples, and which rows of them a device at 30 Hz filled."""
    runs = random_counts(len(lengths), 5)
    place = np.concatenate([np.arange(length) for length in lengths])
    return np.repeat(runs, lengths, axis=0), (np.repeat(lengths, lengths) >= RATE) & (place > 0)


@pytest.mark.parametrize("piece", [9, 18, 27, 90, 9 << 16])
def test_samples_that_repeat_for_a_second_were_filled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, piece: int
) -> None:
    """Wherever pieces of the file end."""
    monkeypatch.setattr("accelcal_cli.formats.gt3x.sensors.ACTIVITY_PIECE_BYTES", piece)
    counts, filled = asleep([1, 1, 29, 30, 1, 31, 2, 500, 1, 1, 60])
    found = whole(written_old(tmp_path / "a.gt3x", packed(counts)))
    assert (found.counts == counts).all()
    assert ((found.validity == Validity.FILLED) == filled).all()
    first = int(np.argmax(filled))
    assert (found.breaks, found.found) == ([], [("idle_sleep", (9 * first + 1) // 2, first, filled.sum())])


def test_a_short_run_at_the_end_was_measured(tmp_path: Path) -> None:
    counts, _ = asleep([5, 29])
    assert not whole(written_old(tmp_path / "a.gt3x", packed(counts))).validity.any()


def test_truncation_at_every_byte_of_a_stored_file(tmp_path: Path) -> None:
    data = zipped({"info.txt": old_info(), "activity.bin": packed(VALUES[:40])}, zipfile.ZIP_STORED)
    begin = data.index(b"activity.bin") + 12
    path = tmp_path / "a.gt3x"
    for size in range(180):
        path.write_bytes(data[: begin + size])
        rows, left = 2 * size // 9, size - (2 * size // 9 * 9 + 1) // 2
        if not rows:
            with pytest.raises(UnreadableError, match="holds no acceleration"):
                opened(path)
            continue
        found = whole(path)
        assert (found.counts == VALUES[:rows]).all()
        part = [("truncated", size - left, rows, left)] if left else []
        assert found.found == [("damaged_archive", None, 0, 1), *part, ("truncated", size, rows, 180 - size)]
        assert opened(path).recording.samples is None


def test_damage_within_is_refused_as_nothing_tells_which_values_are_wrong(tmp_path: Path) -> None:
    data = zipped({"info.txt": old_info(), "activity.bin": packed(VALUES)}, zipfile.ZIP_STORED)
    place = data.index(b"activity.bin") + 500
    mutants = [
        data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :],
        data[:place] + data[place + 9 :],
        data[:place] + bytes(9) + data[place:],
    ]
    tight = zipped({"info.txt": old_info(), "activity.bin": packed(VALUES)})
    size = zipfile.ZipFile(io.BytesIO(tight)).getinfo("activity.bin").compress_size
    place = tight.index(b"activity.bin") + 1500
    mutants.append(tight[:place] + bytes([tight[place] ^ 1]) + tight[place + 1 :])
    short = tight.replace(*(struct.pack("<I", size - lost) for lost in (0, 10)))
    assert short != tight
    mutants.append(short)
    for mutant in mutants:
        path = tmp_path / "a.gt3x"
        path.write_bytes(mutant)
        with pytest.raises(
            UnreadableError, match=r"a\.gt3x: activity\.bin in it is damaged: .*copy it again"
        ):
            whole(path)
