"""The ActiGraph writer: its records against the vendor's documents, and back through the reader."""

from __future__ import annotations

import struct
import zipfile
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import OutputError, UsageError
from accelcal_cli.core.recording import Chunk, Device
from accelcal_cli.formats.gt3x.writer import ENCODER
from tests.formats.writing import START_US, chunks, counts, read_back, recording, times, written

START_S = START_US // 1_000_000
LINK = {"lsb_per_g": 256.0, "range_g": 8.0}
OLDER = {"lsb_per_g": 341.0, "range_g": 6.0}
BOTH = pytest.mark.parametrize("scale", [LINK, OLDER], ids=["16 bits", "12 bits"])
Record = tuple[int, int, bytes]


def records(path: Path) -> list[Record]:
    """Kind, second and payload of each record of log.bin."""
    data, at, found = zipfile.ZipFile(path).read("log.bin"), 0, []
    while at < len(data):
        separator, kind, second, size = struct.unpack_from("<BBIH", data, at)
        end = at + 8 + size
        assert separator == 0x1E
        assert ~reduce(xor, data[at:end]) & 0xFF == data[end]
        found.append((kind, second, data[at + 8 : end]))
        at = end + 1
    return found


def samples(record: Record) -> list[list[int]]:
    kind, _, payload = record
    if kind == 26:
        return [list(row) for row in struct.iter_unpack("<hhh", payload)]
    assert kind == 0
    digits = payload.hex()
    values = [(int(digits[at : at + 3], 16) + 2048) % 4096 - 2048 for at in range(0, len(digits), 3)]
    return [[values[at + 1], values[at], values[at + 2]] for at in range(0, len(values), 3)]


def info(path: Path) -> dict[str, str]:
    lines = zipfile.ZipFile(path).read("info.txt").decode("ascii").removesuffix("\r\n").split("\r\n")
    return dict(line.split(": ") for line in lines)


def parameter(word: int) -> float:
    """The vendor's encoding of floats, for positive ones: 24 bits of fraction, 8 of exponent."""
    return float((word & 0xFFFFFF) / (1 << 23) * 2 ** (word >> 24))


@BOTH
@pytest.mark.parametrize("size", [1, 49, 130, 5_000])
def test_the_records_are_those_of_the_documents(tmp_path: Path, scale: dict[str, float], size: int) -> None:
    values = counts(1_000)
    path = written(tmp_path, ENCODER, recording(**scale), values, size=size)
    (kind, second, _), *seconds = records(path)
    assert (kind, second) == (21, START_S)
    assert [one[:2] for one in seconds] == [(26 if scale is LINK else 0, START_S + k) for k in range(20)]
    assert {len(one[2]) for one in seconds} == {300 if scale is LINK else 225}
    assert np.array_equal(np.concatenate([samples(one) for one in seconds]), values)


@BOTH
def test_the_parameters_are_those_of_the_document(tmp_path: Path, scale: dict[str, float]) -> None:
    payload = records(written(tmp_path, ENCODER, recording(**scale), counts(50)))[0][2]
    told = {(space, number): word for space, number, word in struct.iter_unpack("<HHI", payload)}
    assert parameter(told[0, 55]) == scale["lsb_per_g"]
    assert (told[1, 10], told[1, 12]) == (50, START_S)


def test_info_is_that_of_the_document(tmp_path: Path) -> None:
    what = recording(timezone="-05:30", device=Device("simulated", "SIM00042\n"))
    told = info(written(tmp_path, ENCODER, what, counts(1_000)))
    assert (told["Serial Number"], told["Device Type"]) == ("TAS1D00000042", "Link")
    assert (told["Sample Rate"], told["TimeZone"]) == ("50", "-05:30:00")
    assert told["Subject Name"] == "simulated SIM00042?"
    assert int(told["Start Date"]) == 638_451_072_000_000_000
    assert int(told["Last Sample Time"]) - int(told["Start Date"]) == 20 * 10_000_000
    numbers = [float(told[f"Acceleration {name}"]) for name in ("Scale", "Min", "Max")]
    assert numbers == [256.0, -8.0, 8.0]
    older = info(written(tmp_path, ENCODER, recording(**OLDER, timezone="UTC"), counts(50)))
    assert (older["Serial Number"][:3], older["Acceleration Max"], older["TimeZone"]) == (
        "CLE",
        "6.0",
        "00:00:00",
    )
    assert "TimeZone" not in info(written(tmp_path, ENCODER, recording(), counts(50)))


def test_the_zip_file(tmp_path: Path) -> None:
    """Deflated, and without the date of its making."""
    path = written(tmp_path, ENCODER, recording(), counts(50))
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        parts = [(part.filename, part.compress_type, part.date_time[0]) for part in archive.infolist()]
    assert parts == [("log.bin", zipfile.ZIP_DEFLATED, 1980), ("info.txt", zipfile.ZIP_DEFLATED, 1980)]


@BOTH
@pytest.mark.parametrize("rate_hz", [30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 100.0])
def test_every_rate_comes_back(tmp_path: Path, scale: dict[str, float], rate_hz: float) -> None:
    what = recording(rate_hz=rate_hz, **scale)
    rows = ENCODER.sampling(what).unit_samples * 12
    assert rows == rate_hz * 12
    found = read_back(written(tmp_path, ENCODER, what, counts(rows)))
    about = found.recording
    assert np.array_equal(found.counts, counts(rows))
    assert np.abs(found.times - times(rows, what)).max() <= 1
    assert (about.rate_hz, found.problems, found.breaks) == (rate_hz, [], [])
    assert {"lsb_per_g": about.lsb_per_g, "range_g": about.range_g} == scale
    assert (about.start_us, about.timezone, about.duration_s) == (START_US, None, 12.0)


def test_temperature_has_no_place(tmp_path: Path) -> None:
    heat = np.full(100, 30_000, np.int32)
    path = written(tmp_path, ENCODER, recording(has_temperature=True), counts(100), heat=heat)
    found = read_back(path)
    assert found.temperature_mc is None
    assert not found.recording.has_temperature


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"rate_hz": 25.0}, "25 Hz; use --rate 30"),
        ({"rate_hz": 128.0}, "128 Hz; use --rate 100"),
        ({"rate_hz": 85.7}, "85.7 Hz; use --rate 90"),
        ({"lsb_per_g": 341.0}, "use --lsb-per-g 256 --range-g 8 or --lsb-per-g 341 --range-g 6"),
        ({"range_g": 16.0}, "use --lsb-per-g 256 --range-g 8 or --lsb-per-g 341 --range-g 6"),
    ],
)
def test_settings_that_no_actigraph_has(tmp_path: Path, told: dict[str, float], words: str) -> None:
    with pytest.raises(UsageError) as caught:
        written(tmp_path, ENCODER, recording(**told), counts(300))
    assert words in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    values = counts(100)
    values[60, 2] = 2_048
    written(tmp_path, ENCODER, recording(**LINK), values)
    with pytest.raises(OutputError, match="12 bits"):
        written(tmp_path, ENCODER, recording(**OLDER), values)
    with pytest.raises(OutputError, match="16 bits"):
        written(tmp_path, ENCODER, recording(), values.astype(np.int32) * 17)
    with pytest.raises(OutputError, match="ends within 50 samples"):
        written(tmp_path, ENCODER, recording(), counts(120))
    gap = Chunk(0, counts(100), next(chunks(counts(100), recording())).clock, 0, breaks=np.array([50]))
    with pytest.raises(OutputError, match="gap"):
        ENCODER.write(tmp_path / "a.gt3x", recording(), [gap])
    with pytest.raises(OutputError, match="whole second"):
        written(tmp_path, ENCODER, recording(start_us=START_US + 1), counts(100))
    with pytest.raises(OutputError, match="before 1970 or after 2106"):
        written(tmp_path, ENCODER, recording(start_us=-1_000_000), counts(100))
    with pytest.raises(OutputError, match="no start time"):
        written(tmp_path, ENCODER, recording(start_us=None), counts(100))
    with pytest.raises(OutputError, match="cannot be written"):
        ENCODER.write(tmp_path, recording(), [])


def test_any_chunks_give_the_same_bytes(tmp_path: Path) -> None:
    files = []
    for size in (7, 50, 333, 5_000):
        path = tmp_path / f"{size}.gt3x"
        ENCODER.write(path, recording(), chunks(counts(1_000), recording(), size))
        files.append(zipfile.ZipFile(path).read("log.bin"))
    assert set(files) == {files[0]}
