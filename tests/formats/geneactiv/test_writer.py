"""The GENEActiv writer: its text against the vendor's description, and back through the reader."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import OutputError, UsageError
from accelcal_cli.core.recording import Chunk, Device
from accelcal_cli.formats.geneactiv.writer import ENCODER
from tests.formats.writing import START_US, chunks, counts, read_back, recording, times, written

KEYS = [
    "Recorded Data",
    "Device Unique Serial Code",
    "Sequence Number",
    "Page Time",
    "Unassigned",
    "Temperature",
    "Battery voltage",
    "Device Status",
    "Measurement Frequency",
]


def parts(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """The header's lines, and the lines of each page by their keys; the digits have the key `data`."""
    head, *rest = path.read_bytes().decode("ascii").split("Recorded Data\r\n")
    pages = []
    for text in rest:
        *told, data, end = ("Recorded Data\r\n" + text).split("\r\n")
        pairs = [line.partition(":") for line in told]
        assert ([pair[0] for pair in pairs], end) == (KEYS, "")
        pages.append({key: value for key, _, value in pairs} | {"data": data})
    return head.split("\r\n"), pages


def signed(digits: str) -> int:
    return (int(digits, 16) + 2048) % 4096 - 2048


def samples(data: str) -> list[list[int]]:
    assert len(data) == 3_600
    assert re.fullmatch("([0-9A-F]{9}000){300}", data)
    return [[signed(data[at + 3 * axis :][:3]) for axis in range(3)] for at in range(0, 3_600, 12)]


def header(path: Path) -> dict[str, str]:
    pairs = (line.partition(":") for line in parts(path)[0])
    return {key: value.strip() for key, _, value in pairs if key}


@pytest.mark.parametrize("size", [1, 299, 300, 601, 5_000])
def test_the_pages_are_those_of_the_description(tmp_path: Path, size: int) -> None:
    values = counts(1_200)
    _, pages = parts(written(tmp_path, ENCODER, recording(), values, size=size))
    assert np.array_equal(np.concatenate([samples(page["data"]) for page in pages]), values)
    assert [page["Sequence Number"] for page in pages] == ["0", "1", "2", "3"]
    assert [page["Page Time"] for page in pages] == [f"2024-03-04 00:00:{s:02d}:000" for s in (0, 6, 12, 18)]
    assert {page["Device Unique Serial Code"] for page in pages} == {"000042"}
    assert {(page["Measurement Frequency"], page["Temperature"]) for page in pages} == {("50.0", "")}


def test_the_header_has_59_lines(tmp_path: Path) -> None:
    what = recording(timezone="+01:00", device=Device("simulated", "SIM7\n\x00é"))
    path = written(tmp_path, ENCODER, what, counts(900))
    lines, _ = parts(path)
    assert (len(lines) - 1, lines[-2:]) == (59, ["", ""])
    told = header(path)
    assert told["Device Unique Serial Code"] == "000007"
    assert told["Config Notes"] == "simulated SIM7???"
    assert (told["Time Zone"], told["Start Time"]) == ("GMT +01:00", "2024-03-04 00:00:00:000")
    assert (told["Accelerometer Range"], told["Measurement Frequency"]) == ("-8 to 8", "50.0 Hz")
    assert [told[f"{axis} gain"] for axis in "xyz"] == ["25600"] * 3
    assert [told[f"{axis} offset"] for axis in "xyz"] == ["0"] * 3
    assert told["Number of Pages"] == "3"


@pytest.mark.parametrize("zone", [("UTC", "GMT +00:00"), ("Europe/Berlin", ""), (None, "")])
def test_zones(tmp_path: Path, zone: tuple[str | None, str]) -> None:
    path = written(tmp_path, ENCODER, recording(timezone=zone[0]), counts(300))
    assert header(path)["Time Zone"] == zone[1]


def test_g_is_exact(tmp_path: Path) -> None:
    told = header(written(tmp_path, ENCODER, recording(), counts(300)))
    gain, offset = int(told["x gain"]), int(told["x offset"])
    raw = np.arange(-2048, 2048)
    assert np.array_equal((raw * 100 - offset) / gain, raw / 256)


@pytest.mark.parametrize("halves", range(6, 61))
def test_every_rate_comes_back(tmp_path: Path, halves: int) -> None:
    wanted = recording(rate_hz=round(600 / halves, 1), start_us=START_US + 1_000_000)
    made = ENCODER.sampling(wanted)
    assert (made.rate_hz, made.unit_samples) == (600 / halves, 300)
    what = recording(rate_hz=made.rate_hz, start_us=wanted.start_us)
    found = read_back(written(tmp_path, ENCODER, what, counts(3_000)))
    assert np.array_equal(found.counts, counts(3_000))
    assert np.abs(found.times - times(3_000, what)).max() <= 1
    assert (found.recording.rate_hz, found.problems, found.breaks) == (wanted.rate_hz, [], [])


@pytest.mark.parametrize(("past_us", "told"), [(998_500, "00:999"), (999_499, "00:999"), (999_500, "01:000")])
def test_stamps_are_rounded_to_milliseconds(tmp_path: Path, past_us: int, told: str) -> None:
    what = recording(start_us=START_US + past_us)
    path = written(tmp_path, ENCODER, what, counts(900))
    assert parts(path)[1][0]["Page Time"][-6:] == told
    assert np.abs(read_back(path).times - times(900, what)).max() <= 500


def test_the_reader_knows_the_device(tmp_path: Path) -> None:
    heat = np.repeat(np.array([24_949, -250], np.int32), 300)
    what = recording(has_temperature=True)
    path = written(tmp_path, ENCODER, what, counts(600), heat=heat)
    found = read_back(path)
    about = found.recording
    assert (about.device.serial, about.device.model) == ("000042", "GENEActiv 1.1")
    assert (about.start_us, about.timezone, about.duration_s) == (START_US, None, 12.0)
    assert (about.lsb_per_g, about.range_g) == (256.0, 8.0)
    assert [page["Temperature"] for page in parts(path)[1]] == ["24.9", "-0.2"]
    assert found.temperature_mc is not None
    assert found.temperature_mc[::300].tolist() == [24_900, -200]


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"rate_hz": 99.0}, "99 Hz; use --rate 100"),
        ({"rate_hz": 66.0}, "66 Hz; use --rate 66.6667"),
        ({"rate_hz": 200.0}, "200 Hz; use --rate 100"),
        ({"rate_hz": 5.0}, "5 Hz; use --rate 10"),
        ({"lsb_per_g": 341.0}, "341 counts per g over +-8 g; use --lsb-per-g 256 --range-g 8"),
        ({"range_g": 16.0}, "256 counts per g over +-16 g; use --lsb-per-g 256 --range-g 8"),
    ],
)
def test_settings_that_no_geneactiv_has(tmp_path: Path, told: dict[str, float], words: str) -> None:
    with pytest.raises(UsageError) as caught:
        written(tmp_path, ENCODER, recording(**told), counts(300))
    assert words in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    for beyond in (2_048, -2_049):
        values = counts(300)
        values[200, 1] = beyond
        with pytest.raises(OutputError, match="12 bits"):
            written(tmp_path, ENCODER, recording(), values)
    with pytest.raises(OutputError, match="ends within 300 samples"):
        written(tmp_path, ENCODER, recording(), counts(500))
    gap = Chunk(0, counts(600), next(chunks(counts(600), recording())).clock, 0, breaks=np.array([300]))
    with pytest.raises(OutputError, match="gap"):
        ENCODER.write(tmp_path / "a.bin", recording(), [gap])
    for second in (946_684_799, 4_102_444_800):
        with pytest.raises(OutputError, match="before 2000 or after 2099"):
            written(tmp_path, ENCODER, recording(start_us=second * 1_000_000), counts(300))
    with pytest.raises(OutputError, match="no start time"):
        written(tmp_path, ENCODER, recording(start_us=None), counts(300))
    with pytest.raises(OutputError, match="cannot be written"):
        ENCODER.write(tmp_path, recording(), [])


def test_any_chunks_give_the_same_bytes(tmp_path: Path) -> None:
    heat = np.arange(1_200, dtype=np.int32) * 3 + 20_000
    what, files = recording(has_temperature=True), []
    for size in (7, 300, 999, 5_000):
        path = tmp_path / f"{size}.bin"
        ENCODER.write(path, what, chunks(counts(1_200), what, size, heat))
        files.append(path.read_bytes())
    assert set(files) == {files[0]}
