"""A watch finds what `calibrate` finds in the same bytes, at any moment."""

from __future__ import annotations

import bz2
import contextlib
import gzip
import io
import json
import lzma
import pickle
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.settings import DEFAULT, PAPER, Settings
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.jobs import Job, Request
from accelcal_cli.watching import watch as engine
from accelcal_cli.watching.watch import StepResult, Unpacker, Watch
from tests.cli.run import exit_code
from tests.conftest import ROOT
from tests.formats import make_genea, make_parmay, make_wav
from tests.recordings import LSB_PER_G, directions, paper_recording, still_counts, write_raw

SAMPLES = ROOT / "sample_data"
SIMULATED = {"cwa": "a.cwa", "geneactiv": "a.bin", "raw": "a.raw"}
NAMES = ("outcome", "reason", "values", "message", "calibration", "calibration_error_mg", "coverage")


@pytest.fixture
def few_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only with three times as many orientations: fits take nearly all of the time."""
    monkeypatch.setattr(engine, "GROWTH", 0.5)


def calibrated(path: Path, data: bytes, settings: Settings, folder: Path) -> dict[str, Any]:
    """What `calibrate` reports of these bytes."""
    prefix = folder / path.name
    prefix.write_bytes(data)
    job = Job(prefix, folder / "a.parquet", folder / "a.json")
    report = calibrate(job, Request(settings=settings, report_only=True, force=True)).report
    return found_in(report | {"samples": report["recording"]["samples"]})


def found_in(event: dict[str, Any]) -> dict[str, Any]:
    """What is compared: of the nine subsets `calibrate` tells nothing by default."""
    found = json.loads(json.dumps({name: event[name] for name in (*NAMES, "samples")}))
    del found["coverage"]["subsets_full_after_h"]
    return found


def pieces(data: bytes, random: Random, longest: int = 200_000) -> Iterator[bytes]:
    while data:
        size = random.randint(1, longest)
        yield data[:size]
        data = data[size:]


def unpacked(name: str, folder: Path) -> Path:
    """A sample recording, as it is without gzip."""
    source = SAMPLES / name
    path = folder / source.name.removesuffix(".gz")
    path.write_bytes(gzip.decompress(source.read_bytes()) if name.endswith(".gz") else source.read_bytes())
    return path


def simulated(name: str, folder: Path) -> Path:
    """Six hours of wear in a format of which no sample lies here."""
    path = folder / SIMULATED[name]
    words = ("--format", name, "--days", "0.25", "--rate", "50", "--seed", "4", "-q")
    assert exit_code("simulate", path, *words) == 0
    return path


def made(name: str, folder: Path) -> Path:
    """Ten hours in postures of the wrist, by a writer of a format that cannot be simulated."""
    maker, scale = {"genea": (make_genea, 1), "parmay": (make_parmay, 16), "wav": (make_wav, 16)}[name]
    counts = np.concatenate([still_counts(directions(240), seed) for seed in range(5)])
    return maker.make(folder, counts.astype(np.int64) * scale, 25.0, LSB_PER_G * scale).path


@pytest.mark.usefixtures("few_fits")
@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("recording.bin", 1),
        pytest.param("recording.bin", 10, marks=pytest.mark.nightly),
        pytest.param("evening.csv.gz", 10, marks=pytest.mark.nightly),
        pytest.param("cwa", 5, marks=pytest.mark.nightly),
        pytest.param("geneactiv", 5, marks=pytest.mark.nightly),
        pytest.param("raw", 5, marks=pytest.mark.nightly),
        pytest.param("genea", 3, marks=pytest.mark.nightly),
        pytest.param("parmay", 3, marks=pytest.mark.nightly),
        pytest.param("wav", 3, marks=pytest.mark.nightly),
    ],
)
def test_at_any_byte_the_coefficients_are_those_of_calibrate(name: str, number: int, tmp_path: Path) -> None:
    """The prefix may end within a page or a line, before the head has come or after it."""
    maker = unpacked if "." in name else simulated if name in SIMULATED else made
    path = maker(name, tmp_path)
    data, random = path.read_bytes()[: 1_400_000 if number == 1 else None], Random(number)
    (tmp_path / "prefix").mkdir()
    for layout in tmp_path.glob("*.toml"):
        (tmp_path / "prefix" / layout.name).write_bytes(layout.read_bytes())
    watch, fed, outcomes = Watch(path, ReadOptions(), DEFAULT), 0, set()
    for stop in sorted(random.sample(range(600_000, len(data)), number)):
        for piece in pieces(data[fed:stop], random):
            watch.take(piece)
        fed = stop
        event = watch.end().events[-1]
        assert event["bytes"] == stop
        expected = calibrated(path, data[:stop], DEFAULT, tmp_path / "prefix")
        assert found_in(event) == expected
        outcomes.add(expected["outcome"])
    assert "calibrated" in outcomes


FITS = ("fitted", "refitted")


@pytest.mark.usefixtures("few_fits")
def test_each_fit_is_that_of_calibrate_in_the_bytes_that_it_names(tmp_path: Path) -> None:
    path = unpacked("recording.bin", tmp_path)
    data = path.read_bytes()
    (tmp_path / "prefix").mkdir()
    watch = Watch(path, ReadOptions(), DEFAULT)
    events = [event for piece in pieces(data, Random(3)) for event in watch.take(piece).events]
    fits = [event for event in events if event["event"] in FITS]
    assert [event["event"] for event in fits[:2]] == list(FITS)
    for event in (fits[0], fits[-1]):
        found = calibrated(path, data[: event["bytes"]], DEFAULT, tmp_path / "prefix")
        assert found_in(event) == found
        assert event["calibration"]["fixed_point"]["parameters"]["k_xx"] > 1 << 28


def test_profile_paper_fits_when_its_subsets_are_full_not_at_the_end(tmp_path: Path) -> None:
    path = paper_recording(tmp_path)
    data, settings = path.read_bytes(), PAPER
    (tmp_path / "prefix").mkdir()
    (tmp_path / "prefix" / "paper.layout.toml").write_bytes((tmp_path / "paper.layout.toml").read_bytes())
    watch = Watch(path, ReadOptions(), settings)
    events = [event for piece in pieces(data, Random(4)) for event in watch.take(piece).events]
    (fitted,) = [event for event in events if event["event"] == "fitted"]
    found = calibrated(path, data[: fitted["bytes"]], settings, tmp_path / "prefix")
    assert found_in(fitted) == found
    before = calibrated(path, data[: fitted["bytes"] // 2], settings, tmp_path / "prefix")
    assert before["outcome"] == "refused", "it waited too long"
    hours = fitted["coverage"]["subsets_full_after_h"]
    assert 0 < hours <= fitted["hours"] < 0.8 * len(data) / 6 / 25 / 3600
    counts = [sum(map(sum, event["subsets"])) for event in events if event["event"] == "progress"]
    assert counts == sorted(counts)
    assert counts[-1] == 18


@pytest.mark.usefixtures("few_fits")
def test_coefficients_that_no_longer_hold_are_told_and_replaced(tmp_path: Path) -> None:
    """After 16 hours the offset of x jumps by 40 mg: two hours later that is told, later what it was."""
    path = tmp_path / "a.raw"
    hours = [still_counts(directions(120), seed) for seed in range(36)]
    for number, counts in enumerate(hours):
        counts[:, 0] += 10 * (number >= 16)
    write_raw(path, np.concatenate([part[::8] for part in hours]))
    layout = tmp_path / "a.layout.toml"
    layout.write_text(layout.read_text().replace("rate_hz = 25.0", "rate_hz = 3.125"))
    watch = Watch(path, ReadOptions(), DEFAULT)
    events = [event for piece in pieces(path.read_bytes(), Random(1)) for event in watch.take(piece).events]
    kinds = [event["event"] for event in events if event["event"] != "progress"]
    assert kinds[0] == "fitted"
    assert kinds[-4:] == ["drifted", "refitted", "drifted", "refitted"]
    first, _, known, last = [event for event in events if event["event"] in ("drifted", "refitted")][-4:]
    assert first["hours"] < 16 + 6 and first["in_force_mg"] > 10
    assert "its offsets jump at 2024-03-04T16:00:00, by up to 39." in known["message"]
    assert [knot["sample"] for knot in last["calibration"]["course"]["knots"]] == [0, 16 * 11_250]
    assert last["calibration_error_mg"]["ci95"][0] < 0.5


def hours_of_rest(path: Path, number: int, jump: int) -> bytes:
    """240 postures in two hours at 6.25 Hz, moving in between; from an even hour on x is 40 mg more."""
    write_raw(path, still_counts(directions(1)))
    layout = path.with_suffix(".layout.toml")
    layout.write_text(layout.read_text().replace("rate_hz = 25.0", "rate_hz = 6.25"))
    poses = np.concatenate([directions(200), directions(40)])
    parts = [still_counts(poses, seed).reshape(240, -1, 3) for seed in range(number // 2)]
    for place, counts in enumerate(parts):
        counts[:, :150, 0] += np.random.RandomState(place).randint(-200, 200, (240, 150)).astype(np.int16)
        counts[..., 0] += 10 * (place >= jump // 2)
    return np.concatenate([counts.reshape(-1, 3)[::4] for counts in parts]).astype("<i2").tobytes()


@pytest.mark.nightly
def test_profile_paper_looks_back_a_day_in_memory_that_does_not_grow(tmp_path: Path) -> None:
    path, sizes = tmp_path / "a.raw", []
    data = hours_of_rest(path, 56, 44)
    watch, events = Watch(path, ReadOptions(), PAPER), []
    for begin in range(0, len(data), 135_000):
        events += watch.take(data[begin : begin + 135_000]).events
        sizes.append(len(pickle.dumps(watch)))
    (told,) = [event for event in events if event["event"] == "drifted"]
    assert 44 + 2 < told["hours"] < 44 + 8
    assert 10 < told["in_force_mg"] < 40 and told["new_mg"] < 5
    assert "jump at 2024-03-05T20:00:00, by up to 39." in told["message"]
    assert max(sizes[40:]) < 1.02 * max(sizes[25:40])


@pytest.mark.usefixtures("few_fits")
def test_rows_come_from_the_first_fit_on_each_once(tmp_path: Path) -> None:
    path = unpacked("recording.bin", tmp_path)
    data = path.read_bytes()[:2_000_000]
    watch, whole = Watch(path, ReadOptions(), DEFAULT), StepResult()
    for piece in pieces(data, Random(5)):
        more = watch.take(piece)
        whole.events += more.events
        whole.rows += more.rows
    whole.rows += watch.end().rows
    fitted = next(event for event in whole.events if event["event"] == "fitted")
    samples = [number for one in whole.rows for number in range(one.chunk.first_sample, _end(one))]
    assert samples == list(range(fitted["samples"], len(data) // 512 * 80 - 80))


def _end(one: Any) -> int:
    end: int = one.chunk.first_sample + len(one.chunk)
    return end


def events_of(path: Path, data: Iterator[bytes]) -> list[dict[str, Any]]:
    watch, unpacker = Watch(path, ReadOptions(), DEFAULT), Unpacker(path)
    events = [event for piece in data for part in unpacker.take(piece) for event in watch.take(part).events]
    return events + watch.end().events


@pytest.mark.usefixtures("few_fits")
@pytest.mark.parametrize(
    ("name", "size"),
    [("recording.bin", 700_000), pytest.param("evening.csv.gz", 9_000_000, marks=pytest.mark.nightly)],
)
def test_gzip_that_grows_gives_the_coefficients_of_calibrate(name: str, size: int, tmp_path: Path) -> None:
    """Members are appended one after the other, and the last one is cut short."""
    plain, random = unpacked(name, tmp_path), Random(6)
    data, last = plain.read_bytes()[:size], plain.read_bytes()[size : size + 60_000]
    members = [gzip.compress(piece, 1) for piece in pieces(data, random, size // 2)]
    packed = b"".join([members[0], bytes(100), *members[1:], gzip.compress(last)])[:-20]
    path = tmp_path / f"{plain.name}.gz"
    found = events_of(path, pieces(packed, random, 50_000))
    assert found[-1]["bytes"] == len(gzip_prefix(packed)) > len(data)
    assert "fitted" in [event["event"] for event in found]
    (tmp_path / "prefix").mkdir()
    expected = calibrated(path, packed, DEFAULT, tmp_path / "prefix")
    assert found_in(found[-1]) == expected


def gzip_prefix(packed: bytes) -> bytes:
    """What a gzip file that is cut short still gives."""
    parts = []
    with gzip.open(io.BytesIO(packed)) as file, contextlib.suppress(EOFError):
        while part := file.read1(1 << 16):
            parts.append(part)
    return b"".join(parts)


@pytest.mark.parametrize("longest", [1, 7, 1000])
def test_an_unpacker_gives_the_bytes_in_whatever_pieces_they_come(longest: int, tmp_path: Path) -> None:
    data, random = Random(1).randbytes(3000) + bytes(3 << 20) + b"end", Random(longest)
    packed = gzip.compress(data[:5], 0) + bytes(3) + gzip.compress(b"") + gzip.compress(data[5:]) + bytes(2)
    for sent, held in ((packed, data), (data[:20_000], data[:20_000]), (b"\x1f", b""), (b"\x1fa", b"\x1fa")):
        unpacker = Unpacker(tmp_path / "a")
        parts = [part for piece in pieces(sent, random, longest) for part in unpacker.take(piece)]
        assert b"".join(parts) == held
        assert max(map(len, parts), default=0) <= engine.UNPACKED_BYTES


def test_damaged_gzip_ends_a_watch(tmp_path: Path) -> None:
    good = gzip.compress(bytes(range(256)) * 40)
    for damaged in (good[:500] + b"\xff" * 40 + good[540:], good[:-5] + b"\1" + good[-4:], good + b"more"):
        with pytest.raises(UnreadableError, match=r"a\.csv\.gz: damaged gzip data"):
            list(Unpacker(tmp_path / "a.csv.gz").take(damaged))


@pytest.mark.parametrize(("pack", "command"), [(bz2.compress, "bunzip2"), (lzma.compress, "unxz")])
def test_other_packings_are_to_be_unpacked_on_the_way(
    tmp_path: Path, pack: Callable[[bytes], bytes], command: str
) -> None:
    packed = pack(gzip.decompress((SAMPLES / "evening.csv.gz").read_bytes()))
    watch = Watch(tmp_path / "a.csv.packed", ReadOptions(), DEFAULT)
    with pytest.raises(
        UnreadableError, match=rf"is packed with \w+; unpack it on the way: {command} -c FILE"
    ):
        for piece in pieces(packed, Random(1)):
            watch.take(piece)
        watch.end()


def test_what_cannot_be_watched_says_why(tmp_path: Path) -> None:
    for name, why in (
        ("night.h5", "hdf5 are not read while they grow"),
        ("evening.csv.gz", "is compressed twice"),
    ):
        path = SAMPLES / name
        watch = Watch(path, ReadOptions(), DEFAULT)
        with pytest.raises(UnreadableError, match=why):
            for piece in pieces(path.read_bytes(), Random(1)):
                watch.take(piece)
            watch.end()
    with pytest.raises(UnreadableError, match="nothing came"):
        Watch(tmp_path / "a.csv", ReadOptions(), DEFAULT).end()


@pytest.mark.nightly
@pytest.mark.usefixtures("few_fits")
def test_memory_is_bounded_over_14_days(tmp_path: Path) -> None:
    """Each day is a MiB and a half; what grows are sums by the hour, a few hundred bytes each."""
    path = write_raw(tmp_path / "a.raw", still_counts(directions(1)))
    layout = tmp_path / "a.layout.toml"
    layout.write_text(layout.read_text().replace("rate_hz = 25.0", "rate_hz = 3.125"))
    watch, peaks = Watch(path, ReadOptions(), DEFAULT), []
    for day in range(14):
        poses = directions(2880)[np.random.RandomState(day).permutation(2880) % 90 * 32]
        data = still_counts(poses, day)[: 2880 * 94].astype("<i2").tobytes()
        tracemalloc.start()
        for piece in pieces(data, Random(day)):
            watch.take(piece)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert watch.end().events[-1]["calibration"] is not None
    assert max(peaks[7:]) < max(peaks[1:7]) + (16 << 20)
