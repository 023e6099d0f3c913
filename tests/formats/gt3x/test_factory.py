"""The maker's calibration beside the samples: its values, by hand and by the vendor's reader."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import Reason, UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import FLOAT_LSB_PER_G
from accelcal_cli.formats import find_format
from accelcal_cli.output.sentences import sentence
from accelcal_cli.pipeline import survey
from tests.cli.run import run, verify
from tests.formats.gt3x.reading import opened, random_counts, whole
from tests.formats.make_gt3x import (
    ACTIVITY,
    ACTIVITY2,
    ACTIVITY3,
    ASLEEP,
    AWAKE,
    START_S,
    activity,
    battery,
    event,
    info,
    old_info,
    packed,
    record,
    seconds,
    temperature,
    written,
    zipped,
)
from tests.recordings import directions, still_counts
from tests.schema import check_report

Capture = pytest.CaptureFixture[str]
RATES = (30, 32, 50, 64, 100)
PAIRS = ("XX", "YY", "ZZ", "XY", "XZ", "YZ")
LINE = {"isCalibrated": False, "calibrationMethod": 1, "tempLow": 20.5, "tempHigh": 40.25} | {
    "adxlTempLow": 1500, "adxlTempHigh": 1850, "mcuTempLow": 900, "mcuTempHigh": 1100,
}  # fmt: skip
GRID = Fraction(1, int(FLOAT_LSB_PER_G))


def factory(seed: int, rates: tuple[int, ...] = RATES) -> dict[str, object]:
    """A calibration.json as it may come: offsets in counts, sensitivities in hundredths of counts per g."""
    dice = np.random.default_rng(seed)
    values: dict[str, object] = {"isCalibrated": False, "calibrationMethod": 2}
    for rate in rates:
        values |= {f"offset{axis}_{rate}": int(dice.integers(-60, 60)) for axis in "XYZ"}
        values |= {
            f"sensitivity{pair}_{rate}": int(
                dice.integers(23_500, 27_500) if pair[0] == pair[1] else dice.integers(-600, 600)
            )
            for pair in PAIRS
        }
    return values


def by_hand(counts: np.ndarray, values: dict, rate: int) -> list[list[Fraction]]:
    """Acceleration [g] of the first samples in exact fractions."""

    def across(pair: str) -> Fraction:
        name = f"sensitivity{''.join(sorted(pair))}_{rate}"
        said = Fraction(str(values[name])) / 100
        return 1 / said if pair[0] == pair[1] else 1 / (said + 250) - Fraction(1, 250)

    matrix = [[across(a + b) for b in "XYZ"] for a in "XYZ"]
    offset = [Fraction(str(values[f"offset{axis}_{rate}"])) for axis in "XYZ"]
    shifted = [[int(v) - o for v, o in zip(row, offset, strict=True)] for row in counts.tolist()]
    return [[sum(map(lambda s, v: s * v, line, row)) for line in matrix] for row in shifted]


def by_vendor(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Acceleration (n, 3), and time and temperatures (k, 3), of the vendor's reader."""
    module = pytest.importorskip("pygt3x.reader")
    with module.FileReader(str(path)) as reader:
        bare = reader.calibrate_acceleration(reader.acceleration[:, 1:4])
        return np.asarray(bare), np.asarray(reader.calibrate_temperature())


@pytest.mark.parametrize("seed", range(50))
def test_values_are_the_vendors_and_those_by_hand(tmp_path: Path, seed: int) -> None:
    rate, kind = RATES[seed % 5], (ACTIVITY2, ACTIVITY, ACTIVITY3)[seed % 3]
    counts, values = random_counts(3 * rate, seed), factory(seed)
    text = info(rate, Acceleration_Min="-30.0", Acceleration_Max="30.0")
    path = written(tmp_path / "a.agdc", seconds(counts, rate, kind), text, calibration=values)
    found = whole(path)
    assert found.counts.dtype == np.int32 and not found.problems
    assert opened(path).recording.lsb_per_g == FLOAT_LSB_PER_G
    for row, exact in zip(found.counts[:40].tolist(), by_hand(counts[:40], values, rate), strict=True):
        assert all(
            abs(v * GRID - e) <= GRID * Fraction(50_001, 100_000) for v, e in zip(row, exact, strict=True)
        )
    theirs, _ = by_vendor(path)
    assert np.abs(found.counts / FLOAT_LSB_PER_G - theirs).max() < 1e-6


def test_the_rate_chooses_the_numbers_and_text_is_a_number_too(tmp_path: Path) -> None:
    counts, values = random_counts(100), factory(7)
    spoken = {name: str(value) if "_" in name else value for name, value in values.items()}
    one, other = (
        written(tmp_path / f"{rate}.gt3x", seconds(counts, rate), info(rate), calibration=spoken)
        for rate in (50, 100)
    )
    assert not (whole(one).counts == whole(other).counts).any()
    for path, rate in ((one, 50), (other, 100)):
        told = opened(path).recording.factory.acceleration
        assert (told.sample_rate_hz, told.offset_counts[1]) == (rate, values[f"offsetY_{rate}"])


@pytest.mark.parametrize(
    "values", [None, {}, {"isCalibrated": True}, {"isCalibrated": True, "offsetX_50": 9}]
)
def test_calibrated_counts_stay_as_they_are(tmp_path: Path, values: dict | None) -> None:
    counts = random_counts(100)
    beside = {} if values is None else {"calibration": values}
    path = written(tmp_path / "a.gt3x", seconds(counts, 50), **beside)
    found, about = whole(path), opened(path).recording
    assert (found.counts == counts).all() and found.counts.dtype == np.int16
    assert (about.lsb_per_g, about.factory, about.notes) == (256.0, None, ())


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"calibrationMethod": 3}, "is of the unknown method '3'"),
        ({"calibrationMethod": None}, "is of the unknown method 'None'"),
        ({"calibrationMethod": True}, "is of the unknown method 'True'"),
        ({"offsetZ_50": None}, "does not say what 50 Hz needs"),
        ({"sensitivityXZ_50": "a"}, "does not say what 50 Hz needs"),
        ({"sensitivityXX_50": float("nan")}, "does not say what 50 Hz needs"),
        ({"sensitivityXX_50": 0}, "makes no sense"),
        ({"sensitivityYY_50": 1.01e8}, "makes no sense"),
        ({"sensitivityYZ_50": -25_000}, "makes no sense"),
        ({"offsetX_50": 1e300}, "makes no sense"),
    ],
)
def test_what_cannot_be_applied_is_refused_and_counts_can_be_asked_for(
    tmp_path: Path, change: dict, text: str
) -> None:
    counts = random_counts(100)
    path = written(tmp_path / "a.gt3x", seconds(counts, 50), calibration=factory(1) | change)
    with pytest.raises(UnreadableError, match=f"which its counts need, {text}") as caught:
        opened(path)
    assert "--lsb-per-g" in caught.value.hint
    assert (whole(path, lsb_per_g=256.0).counts == counts).all()
    about = opened(path, lsb_per_g=256.0).recording
    assert "was not applied, as --lsb-per-g is given" in about.notes[0] and about.factory is None


@pytest.mark.parametrize("data", [b"", b"{", b"[1]", b"\xff", b"[" * 100_000])
def test_a_damaged_part_is_told_and_not_used(tmp_path: Path, data: bytes) -> None:
    counts = random_counts(100)
    parts = {"log.bin": b"".join(seconds(counts, 50)), "info.txt": info(), "calibration.json": data}
    path = tmp_path / "a.gt3x"
    path.write_bytes(zipped(parts))
    found = whole(path)
    assert (found.counts == counts).all()
    assert [(problem.code, "calibration.json" in problem.message) for problem in found.problems] == [
        ("damaged_header", True)
    ]


def test_the_older_kind_says_that_it_has_no_use_for_it(tmp_path: Path) -> None:
    data = {"activity.bin": packed(random_counts(60)), "info.txt": old_info()}
    path = tmp_path / "a.gt3x"
    path.write_bytes(zipped(data | {"calibration.json": json.dumps(factory(1))}))
    assert (whole(path).counts == random_counts(60)).all()
    assert any("it is not for activity.bin" in note for note in opened(path).recording.notes)


def test_a_file_without_samples_is_told_as_such(tmp_path: Path) -> None:
    path = written(tmp_path / "a.gt3x", [battery(START_S)], info(Sample_Rate=None), calibration=factory(1))
    with pytest.raises(UnreadableError, match=r"holds no acceleration in log\.bin"):
        opened(path)


def test_it_is_found_without_the_zip_files_directory(tmp_path: Path) -> None:
    counts, values = random_counts(100), factory(2)
    parts = {"calibration.json": json.dumps(values), "temperature_calibration.json": json.dumps(LINE)}
    data = zipped(parts | {"info.txt": info(), "log.bin": b"".join(seconds(counts, 50))})
    sound, cut = tmp_path / "a.agdc", tmp_path / "b.agdc"
    sound.write_bytes(data)
    cut.write_bytes(data[: data.index(b"PK\x01\x02")])
    assert (whole(sound).counts == whole(cut).counts).all()
    assert "damaged_archive" in [problem.code for problem in whole(cut).problems]


def test_clipping_is_of_raw_counts_and_sleep_repeats_a_sample(tmp_path: Path) -> None:
    counts = np.array([[10, 20, 256]] * 100, np.int16)
    counts[3, 1], counts[7, 0], counts[9, 2] = 2047, -2048, 2046
    log = [activity(START_S, counts[:50]), activity(START_S + 1, counts[50:])]
    log += [event(START_S + 2, ASLEEP), battery(START_S + 4), event(START_S + 5, AWAKE)]
    found = whole(written(tmp_path / "a.gt3x", log, calibration=factory(3)))
    assert np.flatnonzero(found.validity == 2).tolist() == [3, 7]
    assert (found.validity[100:] == 1).all() and len(found.validity) == 250
    assert (found.counts[100:] == found.counts[99]).all()


def test_a_thermometer_alone_leaves_clipping_to_others(tmp_path: Path) -> None:
    counts = np.array([[10, 20, 256]] * 100, np.int16)
    counts[3, 1] = 2047
    log = [temperature(START_S, 1600), *seconds(counts, 50)]
    path = written(tmp_path / "a.agdc", log, temperature_calibration=LINE)
    with survey.open_marked(path, ReadOptions()) as reader:
        (chunk,) = reader.chunks(1000)
    assert chunk.validity is not None and np.flatnonzero(chunk.validity).tolist() == [3]


def test_beyond_the_grid_is_cut_off_and_marked(tmp_path: Path) -> None:
    counts = np.array([[32_767, 0, 0], [0, -32_768, 0], [0, 0, 300]] * 10, np.int16)
    values = factory(4) | {f"sensitivity{axis * 2}_30": 5000 for axis in "XYZ"}
    text = info(30, Acceleration_Min=None, Acceleration_Max=None)
    found = whole(written(tmp_path / "a.gt3x", seconds(counts, 30), text, calibration=values))
    assert found.validity.tolist() == [2, 2, 0] * 10
    assert np.abs(found.counts).max() == 127 * FLOAT_LSB_PER_G


@pytest.mark.parametrize("chunk_samples", [1, 70, 100_000])
def test_the_size_of_chunks_changes_nothing(tmp_path: Path, chunk_samples: int) -> None:
    log = [temperature(START_S, 1600)]
    for k, one in enumerate(seconds(random_counts(500), 50)):
        log += [one, temperature(START_S + k, 1600 + k)] if k % 3 == 0 else [one]
    path = written(tmp_path / "a.agdc", log, calibration=factory(5), temperature_calibration=LINE)
    assert whole(path, chunk_samples).same_as(whole(path, 250))


def test_without_a_scale_anywhere_the_calibration_has_it(tmp_path: Path) -> None:
    text = info(50, 1.0, Serial_Number="ABC1", Acceleration_Min=None, Acceleration_Max=None)
    path = written(tmp_path / "a.agdc", seconds(random_counts(100), 50), text, calibration=factory(6))
    assert opened(path).recording.range_g is None


def test_temperatures_lie_on_the_line_and_last_until_the_next(tmp_path: Path) -> None:
    ones = seconds(random_counts(300), 50)
    log = [ones[0], record(30, START_S, b"\0\xe8\x03"), ones[1], temperature(START_S + 1, 1500), ones[2]]
    log += [temperature(START_S + 2, 1675), ones[3], temperature(START_S + 3, -30_000), ones[4]]
    log += [temperature(START_S + 4, 1850), ones[5]]
    path = written(tmp_path / "a.agdc", log, temperature_calibration=LINE)
    with opened(path) as reader:
        heat = np.concatenate([chunk.temperature_mc for chunk in reader.chunks(70)])
        about = reader.recording
    assert heat[::50].tolist() == [20_500, 20_500, 20_500, 30_375, 30_375, 40_250]
    assert (heat.reshape(6, 50) == heat[::50, None]).all()
    assert about.has_temperature and about.lsb_per_g == 256.0
    assert about.factory.temperature.celsius == (20.5, 40.25) and about.factory.acceleration is None
    # the vendor's reader takes a reading of all places for one record of both thermometers
    both = [temperature(START_S + k, 1500 + 70 * k, 950 + 3 * k) for k in range(6)]
    other = written(
        tmp_path / "b.agdc",
        [part for pair in zip(both, ones, strict=True) for part in pair],
        temperature_calibration=LINE,
    )
    with opened(other) as reader:
        heat = np.concatenate([chunk.temperature_mc for chunk in reader.chunks(70)])
    assert np.abs(heat[::50] / 1000 - by_vendor(other)[1][:, 2]).max() < 0.0006


@pytest.mark.parametrize(
    ("values", "first_mc"),
    [
        ({"isCalibrated": True}, 23_000),
        ({"isCalibrated": False, "calibrationMethod": 2}, None),
        (LINE | {"adxlTempHigh": 1500}, None),
        (LINE | {"tempHigh": "hot"}, None),
        ({}, None),
    ],
)
def test_temperatures_whose_meaning_nothing_says_are_left_out(
    tmp_path: Path, values: dict, first_mc: int | None
) -> None:
    log = [temperature(START_S, 23), *seconds(random_counts(100), 50)]
    path = written(tmp_path / "a.agdc", log, temperature_calibration=values)
    with opened(path) as reader:
        (chunk,) = reader.chunks(1000)
        about = reader.recording
    assert about.has_temperature == (first_mc is not None) and about.factory is None
    heat = chunk.temperature_mc
    assert (None if heat is None else int(heat[0])) == first_mc
    assert any("no temperatures were read" in note for note in about.notes) == (first_mc is None)


def test_an_agdc_is_known_by_its_content_and_its_name(tmp_path: Path) -> None:
    path = written(tmp_path / "a.agdc", seconds(random_counts(100), 50), calibration=factory(1))
    assert find_format(path, ReadOptions()).name == "gt3x"
    nameless = path.rename(tmp_path / "recording")
    assert find_format(nameless, ReadOptions()).name == "gt3x"
    stub = tmp_path / "broken.agdc"
    stub.write_bytes(b"PK\x03\x04 broken")
    assert find_format(stub, ReadOptions()).name == "gt3x"


def leap(folder: Path, seed: int = 1) -> Path:
    """A recording that can be calibrated, of a bare sensor."""
    folder.mkdir(exist_ok=True)
    log = seconds(still_counts(directions(60), seed), 25)
    text = info(25, Serial_Number="LEAP1", Device_Type="LEAP")
    return written(folder / "leap.agdc", log, text, calibration=factory(8, (25,)))


def test_report_parquet_and_page_say_it_and_verify_gives_it_again(tmp_path: Path, capsys: Capture) -> None:
    path = leap(tmp_path)
    assert run(capsys, "calibrate", path, "-q").code == 0
    report = json.loads((tmp_path / "leap.calibration.json").read_text())
    check_report(report)
    told = report["recording"]["factory_calibration"]
    values = factory(8, (25,))
    assert told["temperature"] is None and told["acceleration"]["source"] == "calibration.json"
    assert told["acceleration"]["offset_counts"] == [values[f"offset{axis}_25"] for axis in "XYZ"]
    matrix = np.array(told["acceleration"]["g_per_count"])
    assert (matrix == matrix.T).all() and matrix[0, 0] == 1 / (values["sensitivityXX_25"] * 0.01)
    note = "the maker's calibration (calibration.json, for 25 Hz) was applied before any other"
    assert note in report["recording"]["notes"]
    ran, _ = verify(capsys, tmp_path / "leap.calibration.json", path)
    assert ran.code == 0
    assert note in run(capsys, "inspect", path).out
    assert run(capsys, "report", tmp_path / "leap.calibration.json").code == 0
    assert "calibration.json, for 25 Hz" in (tmp_path / "leap.html").read_text()
    ran = run(capsys, "export", tmp_path / "leap.calibration.json", "--to", "ggir")
    assert ran.code == 2 and "bare sensor" in ran.err
    shown = json.loads(run(capsys, "export", tmp_path / "leap.calibration.json", "--to", "json").out)
    assert shown["recording"]["factory_calibration"] == told


def test_coefficients_of_raw_counts_are_told_apart(tmp_path: Path, capsys: Capture) -> None:
    path = leap(tmp_path)
    raw = tmp_path / "raw"
    assert run(capsys, "calibrate", path, "-q", "-d", raw, "--report-only", "--lsb-per-g", 256).code == 0
    assert "factory_calibration" not in json.loads((raw / "leap.calibration.json").read_text())["recording"]
    words = ("--coefficients", raw / "leap.calibration.json", "-d", tmp_path / "out", "--json", "-q")
    assert "or the file was read differently" in run(capsys, "apply", path, *words).err
    report = json.loads(run(capsys, "apply", leap(tmp_path / "b", 2), *words).out)
    told = {"code": "factory_calibration_differs", "values": {"applied_here": True}}
    assert told in report["notes"] and sentence(Reason(**told)) in report["message"]
