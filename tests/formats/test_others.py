"""What is recorded besides motion and temperature: light, buttons, batteries and the like, as it came."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import open_recording
from accelcal_cli.formats.gt3x import records
from tests.cli.run import run
from tests.formats import (
    make_csv,
    make_cwa,
    make_embraceplus,
    make_geneactiv,
    make_gt3x,
    make_unisens,
)

Kept = dict[str, dict[int, float]]
"""Values by name and by the rows at which they were recorded."""


def chunks_of(path: Path, chunk_samples: int = 1000, threads: int = 1, **options: object) -> list:
    with open_recording(path, ReadOptions(**options), threads) as reader:
        reader.with_others = bool(reader.recording.others)
        return list(reader.chunks(chunk_samples))


def units(path: Path, **options: object) -> dict[str, str]:
    with open_recording(path, ReadOptions(**options)) as reader:
        return {one.name: one.unit for one in reader.recording.others}


def kept(path: Path, chunk_samples: int = 1000, threads: int = 1, **options: object) -> Kept:
    chunks = [chunk for chunk in chunks_of(path, chunk_samples, threads, **options) if len(chunk)]
    values = np.concatenate([chunk.others for chunk in chunks])
    assert values.dtype == np.float32
    return {
        name: {row: column[row] for row in np.flatnonzero(~np.isnan(column)).tolist()}
        for name, column in zip(units(path, **options), values.T.tolist(), strict=True)
    }


def single(value: float) -> float:
    return float(np.float32(value))


def counts(rows: int, width: int = 3) -> np.ndarray:
    return np.random.RandomState(3).randint(-300, 300, (rows, width)).astype(np.int16)


# .cwa: bytes 18 and 23 of a sector


def cwa(folder: Path, axes: int = 0x32) -> Path:
    width = {0x32: 3, 0x62: 6}[axes]
    pages = make_cwa.sectors(counts(400, width), axes=axes, scale=0x18)
    known = [(0, 201), (517, 0), (1023, 255), (300, 1), (7, 90), (7, 90), (8, 90), (0, 0), (1, 2), (3, 4)]
    pages = [
        replace(page, light=light, battery=volt) for page, (light, volt) in zip(pages, known, strict=False)
    ]
    return make_cwa.written(folder / "a.cwa", pages)


@pytest.mark.parametrize(("axes", "rows"), [(0x32, 80), (0x62, 40)])
def test_cwa_keeps_light_as_counts_and_the_voltage_of_each_sector(
    tmp_path: Path, axes: int, rows: int
) -> None:
    path = cwa(tmp_path, axes)
    found = kept(path)
    lights = [0, 517, 1023, 300, 7, 7, 8, 0, 1, 3][: 400 // rows]
    assert found["light"] == {rows * number: light for number, light in enumerate(lights)}
    assert found["battery"][0] == single(713 * 6 / 1024) and found["battery"][2 * rows] == single(
        767 * 6 / 1024
    )
    assert rows not in found["battery"]  # 0: unknown
    assert units(path) == {"light": "counts", "battery": "V"}


def test_cwa_leaves_the_values_of_a_damaged_sector_out(tmp_path: Path) -> None:
    path = cwa(tmp_path)
    data = bytearray(path.read_bytes())
    data[1024 + 512 + 18] ^= 1
    path.write_bytes(data)
    assert kept(path)["light"] == {0: 0, 80: 1023, 160: 300, 240: 7}


# GENEActiv: ten bits and one bit of each sample, and a line of each page


HEADER_LIGHT = {"Volts": 300, "Lux": 800}


def geneactiv(folder: Path, **head: str) -> Path:
    first, second = make_geneactiv.pages(counts(600))
    light = np.arange(300) * 3
    digits = [
        make_geneactiv.digits(row[None], int(level), int(level) % 2)
        for row, level in zip(first.rows, light, strict=True)
    ]
    pages = [replace(first, body="".join(digits), battery="4,1"), replace(second, battery="3.9875")]
    text = make_geneactiv.header(pages=2)
    for name, value in head.items():
        text = text.replace(f"{name}:{HEADER_LIGHT[name]}\n".encode(), value.encode())
    return make_geneactiv.written(folder / "a.bin", pages, text)


@pytest.mark.parametrize(
    ("head", "lux", "unit"),
    [
        ({}, lambda level: level * 800 // 300, "lux"),
        ({"Volts": "Volts:39\n", "Lux": "Lux:140\n"}, lambda level: level * 140 // 39, "lux"),
        ({"Volts": ""}, lambda level: level, "counts"),
        ({"Volts": "Volts:0\n"}, lambda level: level, "counts"),
    ],
)
def test_geneactiv_keeps_light_and_button_of_each_sample(
    tmp_path: Path, head: dict[str, str], lux: Callable[[int], int], unit: str
) -> None:
    path = geneactiv(tmp_path, **head)
    found = kept(path)
    assert [found["light"][row] for row in range(600)] == [
        *(lux(3 * row) for row in range(300)),
        *([lux(200)] * 300),
    ]
    assert list(found["button"].values()) == [*(row % 2 for row in range(300)), *([0] * 300)]
    assert found["battery"] == {0: single(4.1), 300: single(3.9875)}
    assert units(path) == {"light": unit, "button": "1 while it is pressed", "battery": "V"}


# .gt3x: records of their own, each of a second


def capsense(second: int, signal: int, worn: int) -> bytes:
    return make_gt3x.record(13, second, struct.pack("<HHBB", signal, 6000, worn, 9))


def gt3x(folder: Path, rate: int = 50) -> Path:
    begin = make_gt3x.START_S
    log: list[bytes] = [make_gt3x.record(make_gt3x.LUX, begin - 1, b"\x01\0")]  # before the first sample
    for number in range(20):
        second = begin + number + 10 * (number >= 12)
        if number == 12:  # asleep for ten seconds, in which it records others
            log += [make_gt3x.event(second - 10, make_gt3x.ASLEEP), make_gt3x.battery(second - 7, 3987)]
            log += [capsense(second - 5, 1234, 0), make_gt3x.event(second, make_gt3x.AWAKE)]
        if number in (0, 5, 15):
            log.append(make_gt3x.record(make_gt3x.LUX, second, struct.pack("<H", 100 * number)))
        if number == 3:
            log.append(make_gt3x.record(4, second, b"\x48"))
            log.append(make_gt3x.record(make_gt3x.LUX, second, b"\1"))  # too small to hold a value
        log.append(make_gt3x.activity(second, counts(rate) + number))
    log += [make_gt3x.battery(begin + 500), make_gt3x.record(make_gt3x.LUX, begin + 500, b"\1")]
    return make_gt3x.written(folder / "a.gt3x", log)


def test_gt3x_keeps_records_at_the_first_sample_of_their_second(tmp_path: Path) -> None:
    path = gt3x(tmp_path)
    found = kept(path)
    assert found["light"] == {0: 0, 5 * 50: 500, 25 * 50: 1500}
    assert found["battery"] == {15 * 50: single(3.987)}  # written while it slept
    assert (found["capsense"], found["worn"]) == ({17 * 50: 1234}, {17 * 50: 0})
    assert found["heart_rate"] == {3 * 50: 72}
    assert units(path)["battery"] == "V" and "capsense_reference" in units(path)


@pytest.mark.parametrize("piece_bytes", [310, 700, 2000])
def test_gt3x_keeps_them_wherever_its_pieces_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, piece_bytes: int
) -> None:
    path = gt3x(tmp_path)
    whole = np.concatenate([chunk.others for chunk in chunks_of(path)])
    with open_recording(path, ReadOptions()) as reader:
        monkeypatch.setattr(records, "PIECE_BYTES", piece_bytes)
        reader.with_others = True
        found = np.concatenate([chunk.others for chunk in reader.chunks(1000)])
    np.testing.assert_array_equal(found, whole)


def test_gt3x_has_no_columns_for_what_it_does_not_record(tmp_path: Path) -> None:
    path = make_gt3x.written(tmp_path / "a.gt3x", make_gt3x.seconds(counts(500), 50))
    assert units(path) == {}
    assert all(chunk.others is None for chunk in chunks_of(path))


# Unisens and EmbracePlus: signals of their own rates


PRESS = {"sampleRate": 8, "lsbValue": 0.25, "unit": "Pa", "baseline": -1000}
LIGHT, HUMIDITY = (
    {"sampleRate": 1, "lsbValue": 2, "unit": "lx"},
    {"sampleRate": 64, "lsbValue": 1, "unit": "%"},
)


def unisens(folder: Path) -> Path:
    signals = [
        make_unisens.signal("acc.bin", "acc"),
        make_unisens.signal("press.bin", "press", channels=("press",), data_type="int32", **PRESS),
        make_unisens.signal("light.bin", "light", channels=("visible", "ir"), **LIGHT),
        make_unisens.signal("hum.bin", "", channels=("h",), data_type="float", **HUMIDITY),
        make_unisens.signal("ecg.bin", "ecg", channels=("ecg",), sampleRate=256, unit="mV"),
        make_unisens.signal("temp.bin", "temp", channels=("temp",), sampleRate=1, unit="C"),
        make_unisens.signal("../far.bin", "light", channels=("far",), sampleRate=1),
    ]  # fmt: skip
    return make_unisens.folder(
        folder / "rec",
        make_unisens.description(*signals),
        acc=counts(130).astype("<i2").tobytes(),
        press=np.arange(400_000, 400_012, dtype="<i4").tobytes(),
        light=np.array([[5, 6], [7, 8], [9, 10]], "<i2").tobytes(),
        hum=np.array([0.5, np.nan, np.inf, *range(127)], "<f4").tobytes(),
        ecg=bytes(1040),
        temp=bytes(6),
    )


def test_unisens_keeps_signals_at_the_rows_of_their_samples(tmp_path: Path) -> None:
    path = unisens(tmp_path)
    found = kept(path)
    assert found["pressure"] == {8 * number: (401_000 + number) / 4 for number in range(12)}
    assert found["light_visible"] == {0: 10, 64: 14, 128: 18}
    assert found["light_ir"] == {0: 12, 64: 16, 128: 20}
    assert found["hum"][0] == 0.5 and 1 not in found["hum"] and found["hum"][129] == 126
    assert units(path) == {"pressure": "Pa", "light_visible": "lx", "light_ir": "lx", "hum": "%"}


def test_unisens_places_samples_of_a_rate_that_does_not_divide(tmp_path: Path) -> None:
    signals = [
        make_unisens.signal("acc.bin", "acc", sampleRate=64),
        make_unisens.signal("baro.bin", "baro", channels=("p",), sampleRate=10, lsbValue=1, unit="hPa"),
    ]
    path = make_unisens.folder(
        tmp_path / "rec",
        make_unisens.description(*signals),
        acc=counts(64).astype("<i2").tobytes(),
        baro=np.arange(1, 11, dtype="<i2").tobytes(),
    )
    rows = [0, 7, 13, 20, 26, 32, 39, 45, 52, 58]  # 6.4 rows each, the first one at or after it
    assert kept(path)["pressure"] == {row: number for number, row in enumerate(rows, 1)}


def embraceplus(folder: Path) -> Path:
    path = folder / "a.avro"
    path.write_bytes(make_embraceplus.written(counts(200), 2048.0))
    return path


def test_embraceplus_keeps_skin_conductance_and_presses(tmp_path: Path) -> None:
    path = embraceplus(tmp_path)
    assert kept(path) == {"eda": {0: 0.5, 16: 0.25}, "button": {1: 1}}
    assert units(path) == {"eda": "uS", "button": "1 where it was pressed"}


# Tables: by the names of columns

HEAD = "time,x [g],y [g],z [g],{}\n"


def table(folder: Path, names: str, cells: list[str]) -> Path:
    rows = [
        f"{make_csv.stamp(20_000 * row)},0.5,{row % 7 / 7:.4f},0.75,{cell}\n"
        for row, cell in enumerate(cells)
    ]
    return make_csv.written(folder, HEAD.format(names) + "".join(rows))


@pytest.mark.parametrize(
    ("name", "column", "unit"),
    [
        ("light", "light", "unknown"),
        ("Lux", "light", "Lux"),
        ("Light (lux)", "light", "lux"),
        ("ambient_light_lx", "light", "lx"),
        ("vbat_mV", "battery", "mV"),
        ("Battery [V]", "battery", "V"),
        ("Button", "button", "unknown"),
        ("pressure_hPa", "pressure", "hPa"),
        ("Barometer (Pa)", "pressure", "Pa"),
        ("HR", "heart_rate", "unknown"),
        ("Heart Rate (bpm)", "heart_rate", "bpm"),
        ("Humidity [%]", "humidity", "%"),
        ("GSR", "eda", "unknown"),
    ],
)
def test_tables_keep_columns_of_other_quantities(tmp_path: Path, name: str, column: str, unit: str) -> None:
    cells = [f"{1000.5 + row / 4}" if row % 3 == 0 else "" for row in range(300)]
    path = table(tmp_path, name, cells)
    assert units(path) == {column: unit}
    assert kept(path) == {column: {row: single(1000.5 + row / 4) for row in range(0, 300, 3)}}


@pytest.mark.parametrize("name", ["battery_temperature", "steps", "note", "mag_x", "flight"])
def test_tables_keep_no_others(tmp_path: Path, name: str) -> None:
    assert units(table(tmp_path, name, ["20"] * 300)) == {}


def test_several_columns_of_a_quantity_keep_their_names(tmp_path: Path) -> None:
    path = table(tmp_path, "light_red,light_ir,battery", ["1,2,3"] * 300)
    assert list(units(path)) == ["light_red", "light_ir", "battery"]
    assert kept(path)["light_ir"][299] == 2


def test_a_cell_that_is_not_a_number_costs_no_row(tmp_path: Path) -> None:
    cells = ["3.5"] * 300
    cells[100:103] = ["weak", "", "-"]
    path = table(tmp_path, "battery", cells)
    chunks = chunks_of(path)
    assert sum(map(len, chunks)) == 300 and not [one for chunk in chunks for one in chunk.problems]
    assert list(kept(path)["battery"]) == [*range(100), *range(103, 300)]


def test_the_unit_alone_names_a_quantity_and_cells_with_units_are_told(tmp_path: Path) -> None:
    path = table(tmp_path, "Licht [lux],battery,Helligkeit", ["5,80%,12 lux"] * 300)
    assert units(path) == {"light": "lux"} and kept(path)["light"][299] == 5
    with open_recording(path, ReadOptions()) as reader:
        notes = [note for note in reader.recording.notes if note.startswith("not read")]
    assert notes == ["not read: column 5 ('battery') holds '80%', not numbers"]
    assert "also holds   light\n" in run("inspect", path).out


def test_a_column_that_may_tell_sensors_apart_is_kept_as_well(tmp_path: Path) -> None:
    path = table(tmp_path, "button", [str(int(row in (50, 51))) for row in range(300)])
    assert kept(path)["button"] == {row: float(row in (50, 51)) for row in range(300)}


def test_the_same_columns_from_other_kinds_of_file(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    text = table(tmp_path, "light,button", [f"{row % 9 / 2},{row % 2}" for row in range(300)])
    import pyarrow.csv

    read = pyarrow.csv.read_csv(text)
    path = tmp_path / "a.parquet"
    pq.write_table(read.set_column(5, "button", read["button"].cast(pa.int16())), path)
    assert kept(path) == kept(text) and units(path) == units(text)


def test_the_table_of_geneactiv_has_lux(tmp_path: Path) -> None:
    from tests.formats.csv.test_geneactiv import SAMPLE

    path = make_csv.written(tmp_path, SAMPLE)
    assert units(path) == {"light": "lux", "button": "unknown"}


# All formats

FORMATS = [cwa, geneactiv, gt3x, unisens, embraceplus]


@pytest.mark.parametrize("make", FORMATS)
def test_nothing_depends_on_chunks_and_threads(tmp_path: Path, make: Callable[[Path], Path]) -> None:
    path = make(tmp_path)
    whole = kept(path)
    assert any(whole.values())
    for chunk_samples, threads in ((1, 1), (37, 3), (100, 2), (1 << 20, 3)):
        assert kept(path, chunk_samples, threads) == whole


@pytest.mark.parametrize("make", FORMATS)
def test_they_are_read_only_where_they_are_asked_for(tmp_path: Path, make: Callable[[Path], Path]) -> None:
    path = make(tmp_path)
    with open_recording(path, ReadOptions()) as reader:
        assert reader.recording.others
        bare = list(reader.chunks(1000))
        reader.with_others = True
        full = list(reader.chunks(1000))
    assert all(chunk.others is None for chunk in bare)
    for one, two in zip(bare, full, strict=True):
        assert (one.counts == two.counts).all() and (one.time_us == two.time_us).all()
        assert (one.problems, one.used_bytes, one.breaks.tolist()) == (
            two.problems,
            two.used_bytes,
            two.breaks.tolist(),
        )
        assert two.others is not None and two.others.shape == (len(two), len(reader.recording.others))
    assert units(path, only_motion=True) == {}


@pytest.mark.parametrize("chunk_samples", [1, 50, 1 << 20])
@pytest.mark.parametrize("threads", [1, 3])
def test_tables_do_not_depend_on_blocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chunk_samples: int, threads: int
) -> None:
    from accelcal_cli.formats.tables.text import source

    cells = [f"{row}" if row % 4 else "" for row in range(2000)]
    cells[1000] = "bad"
    path = table(tmp_path, "light", cells)
    whole = kept(path)
    monkeypatch.setattr(source, "BLOCK_BYTES", 2000)
    assert kept(path, chunk_samples, threads) == whole
