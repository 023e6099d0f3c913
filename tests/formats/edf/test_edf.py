"""EDF, EDF+ and BDF: records written by hand, and what other readers and writers make of them."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.errors import AccelcalError, UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.formats import find_format
from accelcal_cli.formats.edf import FORMAT
from tests.formats.cuts import cuts, every_byte
from tests.formats.make_edf import START_US, Signal, header, onsets, records, written, xyz
from tests.formats.reading import Read, joined

RNG = np.random.default_rng(8)
SAMPLES, RECORDS = 20, 12
COUNTS = RNG.integers(-2048, 2048, (SAMPLES * RECORDS, 3)).astype(np.int16)
AXES = xyz(COUNTS, SAMPLES)
NUMBERS = [f"+{number}" for number in range(RECORDS)]


def read_file(path: Path, chunk_samples: int = 70, **options: Any) -> Read:
    with FORMAT.open(path, ReadOptions(**options)) as reader:
        return joined(reader.recording, reader.chunks(chunk_samples))


def read(folder: Path, data: bytes, chunk_samples: int = 70, name: str = "a.edf", **options: Any) -> Read:
    path = folder / name
    path.write_bytes(data)
    return read_file(path, chunk_samples, **options)


@pytest.mark.parametrize("reserved", ["", "EDF+C"])
def test_counts_times_and_device_are_those_of_the_file(tmp_path: Path, reserved: str) -> None:
    signals = [*AXES, onsets(NUMBERS)] if reserved else AXES
    found = read(tmp_path, written(signals, reserved=reserved))
    assert found.counts.dtype == np.int16
    assert np.array_equal(found.counts, COUNTS)
    assert np.array_equal(found.times, START_US + np.arange(len(COUNTS)) * 50_000)
    about = found.recording
    assert (about.rate_hz, about.lsb_per_g, about.range_g) == (20.0, 256.0, 8.0)
    assert (about.start_us, about.samples, about.duration_s) == (START_US, len(COUNTS), 12.0)
    assert about.device.model == "Wrist Logger"
    assert (found.breaks, found.problems) == ([], [])


def test_bdf_has_24_bits(tmp_path: Path) -> None:
    counts = RNG.integers(-(1 << 23), 1 << 23, (60, 3))
    limits = ("-8", "8", -(1 << 23), 1 << 23)
    signals = [
        Signal(f"accel_{axis}", "g", limits, column.reshape(-1, 20))
        for axis, column in zip("xyz", counts.T, strict=True)
    ]
    found = read(tmp_path, written(signals, bdf=True), name="a.bdf")
    assert np.array_equal(found.counts, counts)
    assert found.recording.lsb_per_g == 1 << 20


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        *[
            (name, "g")
            for name in ("Acc {}", "accel_{}", "Accelerometer-{}", "ACC{}", "Acc{}", "{} axis acc", "{}")
        ],
        *[("Acceleration {}", unit) for unit in ("mg", "m/s2", "m/s^2", "milli-g", "M/S2")],
    ],
)
def test_signals_are_found_by_label_and_unit(tmp_path: Path, names: str, unit: str) -> None:
    other = Signal("EMG", "uV", ("-1", "1", -5, 5), np.zeros((RECORDS, 3)))
    signals = [
        other,
        *(replace(one, unit=unit, label=names.format(axis)) for one, axis in zip(AXES, "XYZ", strict=True)),
    ]
    found = read(tmp_path, written(signals[::-1]))
    assert np.array_equal(found.counts, COUNTS)
    per_g = {"g": 1.0, "mg": 1000.0, "milli-g": 1000.0}.get(unit, 9.80665)
    assert found.recording.lsb_per_g == pytest.approx(256 * per_g, rel=1e-15)


def test_half_counts_are_made_whole(tmp_path: Path) -> None:
    """-16 to 16 g on -32768 to 32767: a digital 0 is half a step above 0 g."""
    signals = [replace(one, limits=("-16", "16", -32768, 32767)) for one in AXES]
    found = read(tmp_path, written(signals))
    assert np.array_equal(found.counts, 2 * COUNTS.astype(int) + 1)
    assert found.recording.lsb_per_g == 65535 / 16
    truth = -16 + (COUNTS + 32768.0) * 32 / 65535
    assert np.abs(found.g - truth).max() < 1e-12
    assert found.recording.range_g == 16.0


def test_axes_of_different_scales_share_a_step(tmp_path: Path) -> None:
    limits = [("-8", "8", -2048, 2048), ("-4", "4", -2048, 2048), ("0", "12", 0, 2048)]
    signals = [replace(one, limits=limit) for one, limit in zip(AXES, limits, strict=True)]
    found = read(tmp_path, written(signals))
    assert np.array_equal(found.counts, COUNTS.astype(int) * [2, 1, 3])
    assert found.recording.lsb_per_g == 512.0


def test_scales_without_a_common_step_are_rounded_to_the_grid_of_decimals(tmp_path: Path) -> None:
    limits = [("-8.00123", "8", -2048, 2047), ("-7.98765", "8", -2047, 2047), ("-8", "7.99991", -2043, 2039)]
    axes = zip(AXES, limits, strict=True)
    signals = [replace(one, limits=limit, values=one.values.copy()) for one, limit in axes]
    found = read(tmp_path, written(signals))
    low, high = (np.array([float(limit[place]) for limit in limits]) for place in (0, 1))
    first, last = (np.array([limit[place] for limit in limits]) for place in (2, 3))
    truth = low + (COUNTS - first) * (high - low) / (last - first)
    assert np.abs(found.g - truth).max() <= 0.5 / 2**24 + 1e-12
    assert any("0.06 micro-g" in note for note in found.recording.notes)
    signals[0].values[1, 3] = -32768
    again = read(tmp_path, written(signals))
    assert np.array_equal(again.counts, np.delete(found.counts, SAMPLES + 3, axis=0)), "128 g have no count"
    assert (again.breaks, again.codes) == ([SAMPLES + 3], ["missing_value"])


def test_gyroscope_and_temperature_come_along(tmp_path: Path) -> None:
    turning = RNG.integers(-2000, 2000, COUNTS.shape).astype(np.int16)
    gyro = [
        replace(one, label=f"Gyro {axis}", unit="deg/s", limits=("-250", "250", -2000, 2000))
        for one, axis in zip(xyz(turning, SAMPLES), "XYZ", strict=True)
    ]
    warm = Signal(
        "Temp rectal", "degC", ("0", "50", 0, 500), np.arange(2 * RECORDS).reshape(RECORDS, 2) + 300
    )
    found = read(tmp_path, written([*gyro, *AXES, warm]))
    assert np.array_equal(found.counts, COUNTS)
    assert np.array_equal(found.gyro, turning)
    assert found.recording.gyro_dps_per_lsb == (0.125,) * 3
    heat = found.temperature
    assert np.array_equal(heat, np.repeat((np.arange(2 * RECORDS) + 300) * 100, SAMPLES // 2))


def test_sensor_columns_unit_and_scale_of_the_user(tmp_path: Path) -> None:
    wrist, ankle = (xyz(counts, SAMPLES, names=f"{place} acc {{}}") for place, counts in
                    (("wrist", COUNTS), ("ankle", -COUNTS)))  # fmt: skip
    data = written([*wrist, *ankle])
    with pytest.raises(UsageError, match=r"several accelerometers.*--sensor NAME \(wrist, ankle\)"):
        read(tmp_path, data)
    assert np.array_equal(read(tmp_path, data, sensor="Ankle").counts, -COUNTS)
    assert np.array_equal(read(tmp_path, data, columns=("5", "wrist acc Y", "3")).counts[:, 0], -COUNTS[:, 2])
    assert read(tmp_path, data, sensor="wrist", unit="counts", lsb_per_g=100.0).recording.lsb_per_g == 100.0
    assert read(tmp_path, data, sensor="wrist", unit="mg").recording.lsb_per_g == 256_000.0
    with pytest.raises(UsageError, match="no sensor is called 'hip'"):
        read(tmp_path, data, sensor="hip")
    with pytest.raises(UsageError, match=r"no signal of this file; its signals are 0 \(wrist acc X\)"):
        read(tmp_path, data, columns=("a", "b", "c"))
    with pytest.raises(UsageError, match="made at 20 Hz, not 50"):
        read(tmp_path, data, sensor="wrist", rate_hz=50.0)


def test_t1_each_lists_the_accelerometers(tmp_path: Path) -> None:
    signals = [
        signal for place in ("wrist", "ankle") for signal in xyz(COUNTS, SAMPLES, names=f"{place} acc {{}}")
    ]
    with pytest.raises(UsageError) as error:
        read(tmp_path, written(signals), sensor="each")
    assert error.value.sensors == ("wrist", "ankle")
    for sensor in error.value.sensors:
        assert np.array_equal(read(tmp_path, written(signals), sensor=f"{sensor},each").counts, COUNTS)
    assert np.array_equal(read(tmp_path, written([*AXES]), sensor="each").counts, COUNTS)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"unit": "uV"}, "cannot tell which signals are x, y and z"),
        ({"label": "EMG"}, "cannot tell which signals are x, y and z"),
        ({"unit": "", "label": "Acc X"}, r"the unit of the acceleration is not known.*--unit"),
        ({"unit": "mg", "label": "Acc X"}, "the unit of the acceleration is not known"),
        ({"limits": ("a", "1", 0, 1)}, r"the range of signal 'Acc X' is not usable \(a, 1, 0, 1\)"),
        ({"limits": ("1", "1", 0, 1)}, "not usable"),
        ({"limits": ("-1", "1", 5, 5)}, "not usable"),
        ({"values": np.zeros((RECORDS, 5))}, "x, y and z have different rates"),
    ],
)
def test_what_cannot_be_used_is_named(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    change = {"label": "X"} | change if change.get("unit") == "uV" else change
    with pytest.raises(UnreadableError, match=words):
        read(tmp_path, written([replace(AXES[0], **change), *AXES[1:]]))


def test_impossible_scales_are_refused(tmp_path: Path) -> None:
    signals = [replace(one, limits=("-9999999", "9999999", -1, 1)) for one in AXES]
    with pytest.raises(UnreadableError, match="1e-07 counts in one g are impossible"):
        read(tmp_path, written(signals))


def test_gaps_of_edf_plus_d_stay_gaps(tmp_path: Path) -> None:
    times = ["+0", "+1", "+2", "+10.5", "+11.5", *[f"+{number + 0.5}" for number in range(12, 19)]]
    found = read(tmp_path, written([*AXES, onsets(times)], reserved="EDF+D"))
    assert np.array_equal(found.counts, COUNTS)
    starts = START_US + (np.array([float(text) for text in times]) * 1e6).astype(int)
    assert np.array_equal(found.times, (starts[:, None] + np.arange(SAMPLES) * 50_000).ravel())
    assert (found.breaks, found.codes) == ([3 * SAMPLES], ["clock_gap"])


def test_a_record_of_edf_plus_d_without_a_time_is_left_out_and_told(tmp_path: Path) -> None:
    texts = ["+0", "+1", "x2", *NUMBERS[3:]]
    found = read(tmp_path, written([*AXES, onsets(texts)], reserved="EDF+D"))
    assert np.array_equal(found.counts, np.delete(COUNTS, slice(2 * SAMPLES, 3 * SAMPLES), axis=0))
    assert (found.breaks, found.codes) == ([2 * SAMPLES], ["bad_page"])
    assert found.problems[0].lost_bytes == 2 * (3 * SAMPLES + 16)


def test_the_first_annotation_has_the_fraction_of_the_start(tmp_path: Path) -> None:
    found = read(tmp_path, written([*AXES, onsets(["+0.2500006", *NUMBERS[1:]])], reserved="EDF+C"))
    assert found.times[0] == found.recording.start_us == START_US + 250_001


@pytest.mark.parametrize(
    ("start", "recording", "us"),
    [
        (("01.01.70", "00.00.01"), "", 3_155_760_001_000_000),
        (("02.03.99", "00.00.00"), "", 920_332_800_000_000),
        (("99.03.99", "00.00.00"), "", None),
        (("29.02.63", "00.00.00"), "", None),
        (("02.03.63", "01.00.00"), "Startdate 02-MAR-2063 X X X", 2_940_022_800_000_000),
        (("02.03.yy", "01.00.00"), "Startdate 02-MAR-2163 X X X", 6_095_696_400_000_000),
        (("XX.XX.XX", "01.00.00"), "Startdate X X X X", None),
    ],
)
def test_dates(tmp_path: Path, start: tuple[str, str], recording: str, us: int | None) -> None:
    found = read(tmp_path, written(AXES, start=start, recording=recording))
    assert FORMAT.sniff(probe_file(tmp_path / "a.edf", ReadOptions())) == 100
    assert found.recording.start_us == us
    assert found.codes == ([] if us is not None else ["no_start_time"])


def test_the_header_may_count_wrong_or_not_at_all(tmp_path: Path) -> None:
    assert read(tmp_path, written(AXES, records=-1)).codes == []
    for claimed in (RECORDS - 1, RECORDS + 5):
        for data in (written(AXES, records=claimed), gzip.compress(written(AXES, records=claimed))):
            found = read(tmp_path, data)
            assert np.array_equal(found.counts, COUNTS)
            assert found.codes == ["truncated" if claimed > RECORDS else "wrong_count"]
            assert f"says {claimed} data records, and the file holds 12" in found.problems[0].message


def test_damaged_headers_are_refused_with_their_place(tmp_path: Path) -> None:
    data = written(AXES)
    for place, text, words in (
        (252, b"   x", "number of signals in its header is 'x'"),
        (184, b"1025    ", "length of the header"),
        (236, b"many    ", "number of records"),
        (244, b"0       ", "length of a record"),
        (244, b"1e-9    ", "length of a record|impossible"),
        (256 + 3 * 216, b"16777216", "its records would have"),
    ):
        with pytest.raises(UnreadableError, match=words):
            read(tmp_path, data[:place] + text + data[place + len(text) :])


def test_it_is_recognised_by_its_signature(tmp_path: Path) -> None:
    path = tmp_path / "night.dat"
    for data in (written(AXES), written(AXES, bdf=True), gzip.compress(written(AXES))):
        path.write_bytes(data)
        assert find_format(path, ReadOptions()) is FORMAT
        assert FORMAT.sniff(probe_file(path, ReadOptions())) == 100


@every_byte
@pytest.mark.parametrize("reserved", ["", "EDF+D"])
def test_truncation_at_every_byte_gives_a_prefix_or_one_clear_error(
    tmp_path: Path, reserved: str, step: int
) -> None:
    few = xyz(COUNTS[:60], SAMPLES)
    data = written([*few, onsets(NUMBERS[:3])] if reserved else few, reserved=reserved)
    size = len(records([*few, onsets(NUMBERS[:3])] if reserved else few)[0])
    start = len(data) - 3 * size
    for end in cuts(data, step):
        try:
            found = read(tmp_path, data[:end])
        except AccelcalError as error:
            assert "a.edf" in str(error) and error.hint
            assert end < start + size
            continue
        whole = (end - start) // size
        assert np.array_equal(found.counts, COUNTS[: whole * SAMPLES])
        assert set(found.codes) == {"truncated"}
        assert sum(problem.lost_bytes for problem in found.problems) == (end - start) % size


def test_edfio_and_pyedflib_agree_both_ways(tmp_path: Path) -> None:
    edfio = pytest.importorskip("edfio")
    path = tmp_path / "ours.edf"
    path.write_bytes(written([*AXES, onsets(NUMBERS)], reserved="EDF+C"))
    theirs = edfio.read_edf(path)
    found = read_file(path)
    assert np.array_equal(np.stack([one.digital for one in theirs.signals], axis=1), found.counts)
    assert np.abs(np.stack([one.data for one in theirs.signals], axis=1) - found.g).max() < 1e-12
    g = RNG.normal(0, 1, (1000, 3))
    signals = [
        edfio.EdfSignal(
            column, 50, label=f"Accel {axis}", physical_dimension="m/s2", physical_range=(-90, 80)
        )
        for axis, column in zip("XYZ", g.T * 9.80665, strict=True)
    ]
    edfio.Edf(signals, annotations=[edfio.EdfAnnotation(1.5, None, "lights off")]).write(path)
    found, again = read_file(path), edfio.read_edf(path)
    metres = np.stack([one.data for one in again.signals], axis=1)
    assert np.abs(found.g * 9.80665 - metres).max() < 1e-6
    assert found.recording.rate_hz == 50.0


def test_pyedflib_agrees(tmp_path: Path) -> None:
    pyedflib = pytest.importorskip("pyedflib")
    path = tmp_path / "ours.edf"
    path.write_bytes(written([*AXES, onsets(NUMBERS)], reserved="EDF+C"))
    with pyedflib.EdfReader(str(path)) as theirs:
        digital = np.stack([theirs.readSignal(axis, digital=True) for axis in range(3)], axis=1)
        physical = np.stack([theirs.readSignal(axis) for axis in range(3)], axis=1)
    found = read_file(path)
    assert np.array_equal(digital, found.counts)
    assert np.abs(physical - found.g).max() < 1e-12


def test_a_header_alone_is_no_recording(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match="has no usable data record"):
        read(tmp_path, header(AXES))
