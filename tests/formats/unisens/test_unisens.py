"""Unisens folders: which file is which, types and scales of numbers, signals beside the accelerations."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import AccelcalError, UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk, Recording
from accelcal_cli.formats import belongs_to, find_format, open_recording
from tests.formats.cuts import cuts, every_byte
from tests.formats.make_unisens import START_US, description, folder, signal
from tests.formats.reading import column as joined
from tests.formats.reading import told

COUNTS = np.random.RandomState(3).randint(-9000, 9000, (960, 3))
ACC = signal("acc.bin", "acc")
DATA = COUNTS.astype("<i2").tobytes()
OPTIONS = ReadOptions()


def read(path: Path, options: ReadOptions = OPTIONS, size: int = 250) -> tuple[Recording, list[Chunk]]:
    with open_recording(path, options) as reader:
        return reader.recording, list(reader.chunks(size))


def test_the_description_and_the_file_are_the_same_recording(tmp_path: Path) -> None:
    xml = folder(tmp_path, description(ACC), acc=DATA)
    for path, other in ((xml, tmp_path / "acc.bin"), (tmp_path / "acc.bin", xml)):
        assert find_format(path, OPTIONS).name == "unisens"
        recording, chunks = read(path)
        assert (recording.rate_hz, recording.lsb_per_g, recording.range_g) == (64.0, 2048.0, 16.0)
        assert (recording.device.model, recording.device.serial) == ("Move4", "01234")
        assert (recording.start_us, recording.timezone, recording.duration_s) == (START_US, None, 15.0)
        assert recording.companion == other
        assert (joined(chunks) == COUNTS).all()
        assert (joined(chunks, "time_us") == START_US + np.arange(960) * 15_625).all()
        assert told(chunks) == []
        assert sum(chunk.used_bytes for chunk in chunks) == recording.total_bytes == len(DATA)


@pytest.mark.parametrize(
    ("data_type", "order", "code"),
    [
        ("int16", "BIG", ">i2"),
        ("int32", "LITTLE", "<i4"),
        ("int8", "LITTLE", "<i1"),
        ("uint16", "BIG", ">u2"),
    ],
)
def test_whole_numbers_of_any_type(tmp_path: Path, data_type: str, order: str, code: str) -> None:
    values = np.abs(COUNTS) // 100
    acc = signal("acc.bin", "acc", data_type=data_type, order=order)
    xml = folder(tmp_path, description(acc), acc=values.astype(code).tobytes())
    assert (joined(read(xml)[1]) == values).all()


def test_a_baseline_is_zero_g(tmp_path: Path) -> None:
    acc = signal("acc.bin", "acc", baseline=2048, adcZero=7, lsbValue=0.00294, adcResolution=12)
    recording, chunks = read(folder(tmp_path, description(acc), acc=DATA))
    assert (joined(chunks) == COUNTS - 2048).all()
    assert recording.lsb_per_g == 1 / 0.00294
    assert recording.range_g == 2048 * 0.00294


@pytest.mark.parametrize(("data_type", "code"), [("double", "<f8"), ("float", "<f4")])
def test_floating_point_numbers_are_put_on_a_fine_grid(tmp_path: Path, data_type: str, code: str) -> None:
    values = COUNTS / 4096
    values[100, 1], values[219, 2] = np.nan, 1e30
    acc = signal("acc.bin", "acc", data_type=data_type, lsbValue=1)
    xml = folder(tmp_path, description(acc), acc=values.astype(code).tobytes())
    recording, chunks = read(xml, size=20)
    kept = np.delete(np.arange(960), [100, 219])
    assert (joined(chunks) / recording.lsb_per_g == values[kept]).all()
    size = 3 * np.dtype(code).itemsize
    assert told(chunks) == [
        ("missing_value", 100 * size, 100, 1, size),
        ("missing_value", 219 * size, 218, 1, size),
    ]
    assert [chunk.first_sample + int(row) for chunk in chunks for row in chunk.breaks] == [100, 218]


@pytest.mark.parametrize(
    ("unit", "lsb", "expected"), [("mg", 0.5, 2000.0), ("m/s²", 0.01, 980.665), ("G", 0.001, 1000.0)]
)
def test_units(tmp_path: Path, unit: str, lsb: float, expected: float) -> None:
    xml = folder(tmp_path, description(signal("acc.bin", "acc", unit=unit, lsbValue=lsb)), acc=DATA)
    assert read(xml)[0].lsb_per_g == pytest.approx(expected)


def test_another_unit_or_scale_must_be_given(tmp_path: Path) -> None:
    xml = folder(tmp_path, description(signal("acc.bin", "acc", unit=None)), acc=DATA)
    with pytest.raises(UnreadableError, match="--unit or --lsb-per-g"):
        read(xml)
    assert read(xml, ReadOptions(unit="g"))[0].lsb_per_g == 2048.0
    assert read(xml, ReadOptions(lsb_per_g=100.0))[0].lsb_per_g == 100.0
    xml = folder(tmp_path, description(signal("acc.bin", "acc", lsbValue=0)), acc=DATA)
    with pytest.raises(UnreadableError, match="impossible scale"):
        read(xml)


def test_axes_by_the_names_of_their_channels(tmp_path: Path) -> None:
    channels = ("time", "Z", "Y", "X")
    table = np.hstack([np.zeros((960, 1)), COUNTS[:, ::-1]]).astype("<i2")
    acc = signal("acc.bin", "acc", channels=channels)
    assert (joined(read(folder(tmp_path, description(acc), acc=table.tobytes()))[1]) == COUNTS).all()
    acc = signal("acc.bin", "acc", channels=("a", "b", "c", "d"))
    with pytest.raises(UnreadableError, match="which channels"):
        read(folder(tmp_path, description(acc), acc=DATA))


def test_rotation_rates_and_temperatures_beside_the_accelerations(tmp_path: Path) -> None:
    turn = signal("angularrate.bin", "angularrate", unit="dps", lsbValue=0.07, channels=("X", "Y", "Z"))
    warm = signal("temp.bin", "temp", unit="°C", sampleRate=1, lsbValue=0.01, channels=("t",))
    heat = np.arange(14) * 10 + 3000
    files = {
        "acc": DATA,
        "angularrate": COUNTS[::-1].astype("<i2").tobytes(),
        "temp": heat.astype("<i2").tobytes(),
    }
    xml = folder(tmp_path, description(ACC, turn, warm), **files)
    for size in (1, 7, 250, 10**6):
        recording, chunks = read(xml, size=size)
        assert recording.gyro_dps_per_lsb == (0.07, 0.07, 0.07)
        assert (joined(chunks, "gyro_counts") == COUNTS[::-1]).all()
        assert (joined(chunks, "temperature_mc") == np.repeat([*heat, heat[-1]], 64) * 10).all()
    (tmp_path / "angularrate.bin").write_bytes(files["angularrate"][:-6])
    recording, _ = read(xml)
    assert recording.gyro_dps_per_lsb is None
    assert any("angularrate.bin was not used" in note for note in recording.notes)
    (tmp_path / "temp.bin").unlink()
    assert not read(xml)[0].has_temperature


@every_byte
def test_cut_anywhere(tmp_path: Path, step: int) -> None:
    xml = folder(tmp_path, description(ACC), acc=DATA)
    for length in cuts(DATA[:400], step):
        (tmp_path / "acc.bin").write_bytes(DATA[:length])
        whole, left = divmod(length, 6)
        if not whole:
            with pytest.raises(UnreadableError, match=r"acc\.bin"):
                read(xml)
            continue
        _, chunks = read(xml, size=10)
        assert (joined(chunks) == COUNTS[:whole]).all()
        assert told(chunks) == ([("truncated", 6 * whole, whole, left, left)] if left else [])


def test_a_description_cut_anywhere_is_refused_or_right(tmp_path: Path) -> None:
    text = description(ACC).encode()
    xml = folder(tmp_path, "", acc=DATA)
    for length in cuts(text, 7):
        xml.write_bytes(text[:length])
        try:
            _, chunks = read(xml, ReadOptions(format="unisens"))
        except AccelcalError as error:
            assert str(xml) in str(error)
        else:
            assert (joined(chunks) == COUNTS).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<unisens/>", "no signal of class acc"),
        ("<?xml version='1.0'?><other/>", "not a description"),
        ("<!DOCTYPE x [<!ENTITY a 'b'>]><unisens>&a;</unisens>", "declarations"),
        ("<?xml version='1.0' encoding='nonsense'?><unisens/>", "damaged"),
        (description(signal("acc.bin", "acc", sampleRate=0)), "impossible sampling rate"),
        (description(signal("../acc.bin", "acc")), "not a file in its folder"),
        (description(signal("gone.bin", "acc")), "not a file in its folder"),
        (description(signal("acc.bin", "acc", data_type="int24")), "in no binary file"),
    ],
)
def test_descriptions_of_no_use(tmp_path: Path, text: str, message: str) -> None:
    xml = folder(tmp_path, text, acc=DATA)
    with pytest.raises(UnreadableError, match=message):
        read(xml, ReadOptions(format="unisens"))


def test_a_time_with_an_offset_is_utc_and_one_may_be_missing(tmp_path: Path) -> None:
    recording, _ = read(folder(tmp_path, description(ACC, start="2008-07-04T15:27:57.250+02:00"), acc=DATA))
    assert (recording.start_us, recording.timezone, recording.has_offsets) == (START_US, "UTC", True)
    recording, chunks = read(folder(tmp_path, description(ACC, start="today"), acc=DATA))
    assert recording.start_us is None
    assert [code for code, *_ in told(chunks)] == ["no_start_time"]


def test_a_rate_that_contradicts_the_description_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="64 Hz, not 25"):
        read(folder(tmp_path, description(ACC), acc=DATA), ReadOptions(rate_hz=25.0))


def test_a_compressed_signal_is_refused(tmp_path: Path) -> None:
    xml = folder(tmp_path, description(ACC), acc=gzip.compress(DATA))
    with pytest.raises(UnreadableError, match="compressed"):
        read(xml)


def test_a_folder_goes_by_the_name_of_its_accelerations(tmp_path: Path) -> None:
    ecg = signal("ecg.bin", "ecg", channels=("a",), unit="mV")
    table = ACC.replace("acc.bin", "acc.csv")
    xml = folder(tmp_path, description(table, ACC, ecg), acc=DATA, ecg=bytes(50), other=b"x")
    others = {path.name: belongs_to(path) is not None for path in (*tmp_path.iterdir(), tmp_path / "acc.csv")}
    expected = dict.fromkeys(("unisens.xml", "ecg.bin", "acc.csv"), True)
    assert others == expected | {"acc.bin": False, "other.bin": False}
    (tmp_path / "acc.bin").unlink()
    assert belongs_to(xml) is None, "what is left of the folder is not lost in silence"


def test_a_preview_enters_the_file_anywhere(tmp_path: Path) -> None:
    with open_recording(folder(tmp_path, description(ACC), acc=DATA), OPTIONS) as reader:
        pieces = list(reader.preview(48, 4))
    assert [piece.first_sample for piece in pieces] == [0, 240, 480, 720]
    assert (pieces[2].counts == COUNTS[480:528]).all()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-16-le"])
def test_h8_declarations_are_refused_in_any_encoding(tmp_path: Path, encoding: str) -> None:
    bomb = f"<?xml version='1.0' encoding='{encoding[:6]}'?>" * (encoding != "utf-16-le")
    bomb += "<!DOCTYPE x [<!ENTITY a 'b'><!ENTITY c '&a;&a;'>]><unisens measurementId='&c;'/>"
    (tmp_path / "unisens.xml").write_bytes(bomb.encode(encoding))
    with pytest.raises(UnreadableError, match="has declarations, which Unisens does not use"):
        read(tmp_path / "unisens.xml", ReadOptions(format="unisens"))


@pytest.mark.parametrize("step", ["1e300", "1e306", "-1", "nan", "100001"])
@pytest.mark.filterwarnings("error")
def test_h7_a_gyroscope_of_an_impossible_step_is_not_used(tmp_path: Path, step: str) -> None:
    gyro = signal("gyro.bin", "gyro", unit="dps", lsbValue=step)
    xml = folder(tmp_path, description(ACC, gyro), acc=DATA, gyro=DATA)
    recording, chunks = read(xml)
    if recording.gyro_dps_per_lsb is not None:
        assert max(recording.gyro_dps_per_lsb) <= 1, "an unusable step is no step"
    assert np.array_equal(joined(chunks), COUNTS)


@pytest.mark.parametrize(("baseline", "zero"), [(2048, 0), (0, 0), (100, 100)])
def test_t19_a_baseline_that_signed_data_contradict_is_not_used(
    tmp_path: Path, baseline: int, zero: int
) -> None:
    """Rest is 1 g without 2048; where it is 1 g with the baseline, this is taken away as ever."""
    counts = (np.tile([0, 0, 2048], (960, 1)) + zero).astype("<i2")
    xml = folder(tmp_path, description(signal("acc.bin", "acc", baseline=baseline)), acc=counts.tobytes())
    recording, chunks = read(xml)
    assert (joined(chunks) == [0, 0, 2048]).all()
    assert any("does not fit the signed data" in note for note in recording.notes) == (baseline == 2048)


def test_t11_a_comma_stands_for_decimals_too(tmp_path: Path) -> None:
    text = description(signal("acc.bin", "acc", lsbValue="0,00048828125", sampleRate="64,0"))
    recording, _ = read(folder(tmp_path, text, acc=DATA))
    assert (recording.lsb_per_g, recording.rate_hz) == (2048.0, 64.0)
