"""A watch finds what `calibrate` finds in the same bytes, at any moment, however often it was stopped."""

from __future__ import annotations

import bz2
import gzip
import hashlib
import json
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.errors import AccelcalError, UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.settings import DEFAULT, PAPER, Settings
from accelcal_cli.pipeline import watch as engine
from accelcal_cli.pipeline import watch_state
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.jobs import Job, Request
from accelcal_cli.pipeline.watch import Happened, Standing, Watch
from tests.cli.run import exit_code
from tests.conftest import ROOT
from tests.formats import make_genea, make_parmay, make_wav
from tests.recordings import LSB_PER_G, directions, paper_recording, still_counts, write_raw

SAMPLES = ROOT / "sample_data"
SIMULATED = {"cwa": "a.cwa", "geneactiv": "a.bin", "raw": "a.raw"}
NAMES = ("outcome", "message", "calibration", "sphere_mg", "coverage")


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
    return {name: report[name] for name in NAMES} | {"samples": report["recording"]["samples"]}


def found_in(event: dict[str, Any]) -> dict[str, Any]:
    return json.loads(json.dumps({name: event[name] for name in (*NAMES, "samples")}))


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
    data, random = path.read_bytes(), Random(number)
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
    before = calibrated(path, data[: fitted["bytes"] - 200_000], settings, tmp_path / "prefix")
    assert before["outcome"] == "refused", "it waited too long"
    hours = fitted["coverage"]["subsets_full_after_h"]
    assert 0 < hours <= fitted["hours"] < 0.8 * len(data) / 6 / 25 / 3600
    counts = [sum(map(sum, event["subsets"])) for event in events if event["event"] == "progress"]
    assert counts == sorted(counts)
    assert counts[-1] == 18


def stopped_and_resumed(path: Path, data: bytes, settings: Settings, stops: list[int], state: Path) -> bytes:
    """The state after watches that are each stopped at a byte and go on from their file."""
    for stop in [*stops, len(data)]:
        standing = watch_state.load(state, "options")
        watch = Watch(path, ReadOptions(), settings, standing)
        first = watch.standing.taken
        for piece in pieces(data[first:stop], Random(stop)):
            watch.take(piece)
        watch.end()
        watch_state.save(state, watch.standing, "options")
    return state.read_bytes()


@pytest.mark.usefixtures("few_fits")
@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("recording.bin", PAPER),
        pytest.param("recording.bin", DEFAULT, marks=pytest.mark.nightly),
        pytest.param("evening.csv.gz", DEFAULT, marks=pytest.mark.nightly),
    ],
)
def test_stopped_twenty_times_the_state_is_the_same_byte_for_byte(
    name: str, settings: Settings, tmp_path: Path
) -> None:
    path = unpacked(name, tmp_path)
    data = path.read_bytes()[: 2_000_000 if settings is PAPER else None]
    stops = sorted(Random(7).sample(range(100_000, len(data)), 20))
    found = stopped_and_resumed(path, data, settings, stops, tmp_path / "often")
    assert found == stopped_and_resumed(path, data, settings, [], tmp_path / "never")
    assert len(found) < 10_000


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
    assert last["sphere_mg"]["mean"] < 0.5


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
def test_profile_paper_looks_back_a_day_in_a_state_that_does_not_grow(tmp_path: Path) -> None:
    path, state, sizes = tmp_path / "a.raw", tmp_path / "state", []
    data = hours_of_rest(path, 56, 44)
    watch, events = Watch(path, ReadOptions(), PAPER), []
    for begin in range(0, len(data), 135_000):
        events += watch.take(data[begin : begin + 135_000]).events
        watch_state.save(state, watch.standing, "options")
        sizes.append(state.stat().st_size)
    (told,) = [event for event in events if event["event"] == "drifted"]
    assert 44 + 2 < told["hours"] < 44 + 8
    assert 10 < told["in_force_mg"] < 40 and told["new_mg"] < 5
    assert "jump at 2024-03-05T20:00:00, by up to 39." in told["message"]
    assert max(sizes[40:]) < 1.02 * max(sizes[25:40])


@pytest.mark.usefixtures("few_fits")
def test_rows_come_from_the_first_fit_on_each_once(tmp_path: Path) -> None:
    path = unpacked("recording.bin", tmp_path)
    data = path.read_bytes()[:2_000_000]
    watch, happened = Watch(path, ReadOptions(), DEFAULT), Happened()
    for piece in pieces(data, Random(5)):
        more = watch.take(piece)
        happened.events += more.events
        happened.rows += more.rows
    happened.rows += watch.end().rows
    fitted = next(event for event in happened.events if event["event"] == "fitted")
    samples = [number for one in happened.rows for number in range(one.chunk.first_sample, _end(one))]
    assert samples == list(range(fitted["samples"], len(data) // 512 * 80 - 80))


def _end(one: Any) -> int:
    end: int = one.chunk.first_sample + len(one.chunk)
    return end


def standing_after(path: Path, size: int) -> Standing:
    watch = Watch(path, ReadOptions(), PAPER)
    watch.take(path.read_bytes()[:size])
    return watch.standing


def test_a_state_is_refused_where_it_is_damaged_or_of_others(tmp_path: Path) -> None:
    path, state = paper_recording(tmp_path), tmp_path / "state"
    watch_state.save(state, standing_after(path, 1_200_000), "mine")
    good = state.read_bytes()
    assert watch_state.load(state, "mine") is not None
    with pytest.raises(UsageError, match="other options"):
        watch_state.load(state, "others")
    for size in range(0, len(good), 97):
        state.write_bytes(good[:size])
        with pytest.raises(UnreadableError):
            watch_state.load(state, "mine")
    for place in range(0, len(good), 61):
        state.write_bytes(good[:place] + bytes([good[place] ^ 1]) + good[place + 1 :])
        with pytest.raises(AccelcalError):
            watch_state.load(state, "mine")
    state.write_bytes(good.replace(b'"accelcal_version":"', b'"accelcal_version":"9'))
    with pytest.raises(UnreadableError, match="is a state of accelcal 9"):
        watch_state.load(state, "mine")
    state.write_bytes(b"[1]\n")
    with pytest.raises(UnreadableError, match="no state of accelcal watch"):
        watch_state.load(state, "mine")


@pytest.mark.parametrize(
    "text",
    [
        b"[" + b" " * (1 << 27) + b"0]",
        b"[" * 100_000,
        b'["object","studies.lock:Lock"]',
        b'["object","pipeline.watch:Standing"]',
        b'["object","core.clock:UniformClock","start_us",0,"first_index",0,"rate",["fraction",1,1]]',
        b"7",
        b"",
    ],
    ids=["much", "deep", "others", "no fields", "another thing", "number", "nothing"],
)
def test_a_state_that_somebody_forged_does_nothing(text: bytes, tmp_path: Path) -> None:
    """Its seal is right, as anybody can make one."""
    path, state = paper_recording(tmp_path), tmp_path / "state"
    watch_state.save(state, standing_after(path, 100_000), "mine")
    head = json.loads(state.read_bytes().split(b"\n", 1)[0])
    packed = bz2.compress(text)
    assert len(packed) < 5000
    del head["sha256"]
    line = json.dumps(head, separators=(",", ":")).encode()
    head["sha256"] = hashlib.sha256(line + packed).hexdigest()
    state.write_bytes(json.dumps(head).encode() + b"\n" + packed)
    tracemalloc.start()
    with pytest.raises(UnreadableError, match="is a damaged state"):
        watch_state.load(state, "mine")
    assert tracemalloc.get_traced_memory()[1] < 200 << 20
    tracemalloc.stop()


def test_a_state_goes_on_in_its_own_recording_alone(tmp_path: Path) -> None:
    path = paper_recording(tmp_path)
    standing = standing_after(path, 1_200_000)
    other = tmp_path / "other.raw"
    for data in (path.read_bytes()[::-1], path.read_bytes()[:1_100_000]):
        other.write_bytes(data)
        with other.open("rb") as file, pytest.raises(UnreadableError, match="not the recording of the state"):
            Watch(path, ReadOptions(), PAPER, standing).go_on_in(file)
    with path.open("rb") as file:
        Watch(path, ReadOptions(), PAPER, standing).go_on_in(file)
        assert file.tell() == standing.taken == 1_196_032


def test_what_cannot_be_watched_says_why(tmp_path: Path) -> None:
    for name, why in (("night.h5", "hdf5 are not read while they grow"), ("evening.csv.gz", "is compressed")):
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
def test_memory_and_state_are_bounded_over_14_days(tmp_path: Path) -> None:
    """Each day is a MiB and a half; what grows are sums by the hour, a few hundred bytes each."""
    path = write_raw(tmp_path / "a.raw", still_counts(directions(1)))
    layout = tmp_path / "a.layout.toml"
    layout.write_text(layout.read_text().replace("rate_hz = 25.0", "rate_hz = 3.125"))
    watch, peaks, sizes, state = Watch(path, ReadOptions(), DEFAULT), [], [], tmp_path / "state"
    for day in range(14):
        poses = directions(2880)[np.random.RandomState(day).permutation(2880) % 90 * 32]
        data = still_counts(poses, day)[: 2880 * 94].astype("<i2").tobytes()
        tracemalloc.start()
        for piece in pieces(data, Random(day)):
            watch.take(piece)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        watch_state.save(state, watch.standing, "options")
        sizes.append(state.stat().st_size)
    assert watch.standing.force is not None
    assert max(peaks[7:]) < max(peaks[1:7]) + (16 << 20)
    assert sizes[-1] < 100_000
