"""Parquet: units and columns from metadata and names, row groups of any size, damage, and our own files."""

from __future__ import annotations

import csv
import json
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from accelcal_cli.core.errors import NoRecordingError, UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import FLOAT_LSB_PER_G
from accelcal_cli.formats import open_recording
from accelcal_cli.formats.tables import PARQUET
from accelcal_cli.parquet import pages
from tests.cli.run import exit_code, run, run_process
from tests.formats.cuts import every_byte, table_cuts
from tests.formats.make_hdf5 import START_US, even_times
from tests.formats.make_hdf5 import read as read_of
from tests.formats.make_parquet import make, table
from tests.formats.table_values import ROWS, TIMES, values
from tests.recordings import LSB_PER_G, RATE_HZ, directions, still_counts

HOUR = 3_600_000_000
GRAVITY = 9.80665
read = partial(read_of, chunk_samples=250, form=PARQUET)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.parquet"


def write(path: Path, columns: dict[str, Any], metadata: dict[str, str] | None = None, **how: Any) -> Path:
    made = pa.table(columns)
    pq.write_table(
        made.replace_schema_metadata({**(made.schema.metadata or {}), **(metadata or {})}), path, **how
    )
    return path


def times(rows: int = ROWS) -> pa.Array:
    return pa.array(even_times(rows, 50.0)).cast(pa.timestamp("us"))


def axes(grid: np.ndarray) -> dict[str, np.ndarray]:
    return {name: np.ascontiguousarray(grid[:, axis]) for axis, name in enumerate("xyz")}


@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_row_groups_of_any_length_give_the_same_bits(path: Path, kind: str) -> None:
    made = table(values(3000).astype(kind), even_times(3000, 50.0))
    found = []
    for rows in (1, 7, 1000, 3000):
        pq.write_table(made, path, row_group_size=rows)
        found.append(read(path))
    assert (found[0].g == values(3000)).all()
    assert (found[0].times == even_times(3000, 50.0)).all()
    assert found[0].problems == []
    assert all(one.same_as(found[0]) for one in found)


@pytest.mark.nightly
def test_a_million_rows_in_row_groups_of_1000_and_of_a_million(path: Path) -> None:
    made = table(values(1_000_000).astype("f4"), even_times(1_000_000, 50.0))
    found = []
    for rows in (1000, 1_000_000):
        pq.write_table(made, path, row_group_size=rows)
        found.append(read(path, chunk_samples=100_000))
    assert (found[0].g == values(1_000_000)).all()
    assert found[0].same_as(found[1])


@pytest.mark.nightly
def test_a_long_row_group_is_read_a_few_pages_at_a_time(path: Path) -> None:
    rows = 2_000_000
    noise = np.random.RandomState(1).standard_normal((rows, 3))
    pq.write_table(table(noise.astype("f4"), even_times(rows, 50.0)), path, row_group_size=rows)
    with open_recording(path, ReadOptions()) as reader:
        before = pa.total_allocated_bytes()
        most = max(pa.total_allocated_bytes() - before for _ in reader.chunks(50_000))
    assert most < 20 << 20 < path.stat().st_size


def test_other_writers_say_the_same(path: Path) -> None:
    frame = pl.DataFrame({"time": TIMES, **axes(values())})
    frame = frame.with_columns(pl.col("time").cast(pl.Datetime("us")))
    frame.write_parquet(path, row_group_size=100)
    first = read(path)
    duckdb.sql("select * from frame").write_parquet(str(path))
    second = read(path)
    assert (first.g == values()).all()
    assert first.same_as(second)
    back = pq.read_table(path, columns=list("xyz"))
    assert (first.g == np.stack([back[name].to_numpy() for name in "xyz"], axis=1)).all()


def test_a_unit_is_stated_in_the_metadata_of_all(path: Path) -> None:
    write(path, {"time": times(), **axes(values() * GRAVITY)}, {"unit": "m/s2"})
    assert np.abs(read(path).g - values()).max() <= 0.5 / FLOAT_LSB_PER_G


def structure(grid: np.ndarray) -> pa.Array:
    return pa.StructArray.from_arrays([pa.array(grid[:, axis]) for axis in range(3)], list("xyz"))


@pytest.mark.parametrize(
    "accel",
    [
        lambda grid: pa.FixedSizeListArray.from_arrays(pa.array(grid.ravel()), 3),
        lambda grid: pa.array(grid.tolist()),
        lambda grid: pa.array(grid.tolist(), pa.large_list(pa.float32())),
        structure,
    ],
    ids=["fixed", "list", "large", "struct"],
)
def test_lists_of_three_and_structures(path: Path, accel: Any) -> None:
    write(path, {"time": times(), "accel": accel(values())}, row_group_size=100)
    assert (read(path).g == values()).all()


def test_whole_numbers_are_counts_and_stay_whole(path: Path) -> None:
    counts = np.rint(values() * 256).astype("i2")
    write(path, {"time": times(), **axes(counts)}, {"lsb_per_g": "256", "serial": "7"})
    found = read(path)
    assert found.counts.dtype == np.int16
    assert (found.counts == counts).all()
    assert (found.recording.lsb_per_g, found.recording.device.serial) == (256.0, "7")


@pytest.mark.parametrize("kind", [pa.float32(), pa.float64(), pa.int16(), pa.int32(), pa.int64()], ids=str)
@pytest.mark.parametrize("groups", [1, 100])
def test_rows_without_a_value_are_reported_and_break_the_recording(
    path: Path, kind: Any, groups: int
) -> None:
    rows = [[int(256 * cell) for cell in row] for row in values().tolist()]
    counts = np.array(rows, float)
    y: list[Any] = [row[1] for row in rows]
    y[100:103] = [None] * 3
    columns = {"x": [row[0] for row in rows], "y": y, "z": [row[2] for row in rows]}
    arrays = {name: pa.array(column, kind) for name, column in columns.items()}
    write(path, {"time": times(), **arrays}, {"lsb_per_g": "256", "unit": "counts"}, row_group_size=groups)
    found = read(path, chunk_samples=64)
    kept = np.delete(np.arange(ROWS), [100, 101, 102])
    assert (found.counts == counts[kept]).all()
    assert [(one.code, one.sample, one.count) for one in found.problems] == [("missing_value", 100, 3)]
    assert found.breaks == [100]
    assert (found.times == TIMES[kept]).all()


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_rows_without_a_time_are_left_out(path: Path, unit: str) -> None:
    stamps = pa.array([*TIMES.tolist()[:50], None, None, *TIMES.tolist()[52:]], pa.timestamp("us"))
    write(path, {"time": stamps.cast(pa.timestamp(unit)), **axes(values())})
    found = read(path)
    assert (found.g == np.delete(values(), [50, 51], axis=0)).all()
    assert [one.code for one in found.problems] == ["missing_value"]


@pytest.mark.parametrize(
    ("column", "zone", "start_us"),
    [
        (lambda us: pa.array(us).cast(pa.timestamp("us")), None, START_US),
        (lambda us: pa.array(us * 1000).cast(pa.timestamp("ns")), None, START_US),
        (lambda us: pa.array(us).cast(pa.timestamp("us", "Europe/Berlin")), "Europe/Berlin", START_US + HOUR),
        (lambda us: pa.array(us // 1000).cast(pa.timestamp("ms", "UTC")), "UTC", START_US),
        (lambda us: pa.array(us).cast(pa.timestamp("us", "+05:30")), "+05:30", START_US + 11 * HOUR // 2),
        (lambda us: pa.array(us).cast(pa.timestamp("us", "Atlantis/Main")), "UTC", START_US),
        (lambda us: us / 86_400e6 + 25_569, None, START_US),
        (lambda us: pa.array(us - us[0]).cast(pa.duration("us")), None, None),
    ],
    ids=["us", "ns", "zoned", "ms", "offset", "unknown", "days", "duration"],
)
def test_times_of_all_kinds(path: Path, column: Any, zone: str | None, start_us: int | None) -> None:
    write(path, {"time": column(TIMES), **axes(values())})
    found = read(path)
    about = found.recording
    assert (about.rate_hz, about.timezone, about.start_us) == (50.0, zone, start_us)
    assert np.abs(found.times - (TIMES - TIMES[0] + (start_us or 0))).max() <= 10
    assert found.codes == ([] if start_us else ["no_start_time"])


def test_a_pandas_frame_with_its_index(path: Path) -> None:
    import pandas as pd

    index = pd.to_datetime(TIMES, unit="us")
    frame = pd.DataFrame(axes(values()), index=index)
    frame.attrs["serial"] = "A1"
    for name in ("time", None):
        frame.rename_axis(name).to_parquet(path)
        found = read(path)
        assert (found.g == values()).all()
        assert (found.times == TIMES).all()
        assert found.recording.device.serial == "A1"


def test_a_date_and_a_time_of_day_are_one_time(path: Path) -> None:
    days = pa.array(TIMES // 86_400_000_000, pa.int64()).cast(pa.int32()).cast(pa.date32())
    hours = pa.array(TIMES % 86_400_000_000).cast(pa.time64("us"))
    for columns in ({"date": days, "time": hours}, {"date": days, "time": times()}):
        write(path, {**columns, **axes(values())})
        found = read(path)
        assert (found.times == TIMES).all()
        assert (found.recording.start_us, found.problems) == (START_US, [])


def test_lists_with_holes_are_rows_without_a_value(path: Path) -> None:
    rows: list[Any] = np.rint(values() * 256).astype(int).tolist()
    rows[5], rows[7], rows[8] = [1, None, 3], None, [1, 2]
    for kind in (pa.int16(), pa.int64(), pa.float32()):
        write(path, {"time": times(), "accel": pa.array(rows, pa.list_(kind))}, {"lsb_per_g": "256"})
        found = read(path)
        assert (found.g * 256 == np.rint(np.delete(values(), [5, 7, 8], axis=0) * 256)).all()
        assert [(one.code, one.sample, one.count) for one in found.problems] == [
            ("missing_value", 5, 1),
            ("missing_value", 6, 2),
        ]


def test_only_the_columns_that_are_needed_are_read(path: Path) -> None:
    made = table(values(), TIMES).append_column("light", pa.array(np.arange(ROWS)))
    pq.write_table(made, path, compression="none", use_dictionary=False, row_group_size=ROWS)
    column = pq.read_metadata(path).row_group(0).column(4)
    broken(path, column.data_page_offset, column.total_compressed_size)
    assert read(path).problems == []


def broken(path: Path, start: int, size: int) -> None:
    whole = bytearray(path.read_bytes())
    whole[start : start + size] = b"\xff" * size
    path.write_bytes(whole)


@pytest.mark.parametrize("groups", [100, 5])
def test_a_damaged_row_group_loses_its_own_rows_alone(path: Path, groups: int) -> None:
    pq.write_table(table(values(), TIMES), path, row_group_size=groups)
    column = pq.read_metadata(path).row_group(3).column(2)
    start = column.dictionary_page_offset or column.data_page_offset
    broken(path, start, column.total_compressed_size)
    found = read(path)
    kept = np.delete(np.arange(ROWS), np.arange(3 * groups, 4 * groups))
    assert (found.g == values()[kept]).all()
    assert (found.times == TIMES[kept]).all()
    assert [(one.code, one.sample, one.count) for one in found.problems] == [("bad_page", 3 * groups, groups)]
    assert found.breaks == [3 * groups]
    assert (
        found.problems[0].byte_offset == pq.read_metadata(path).row_group(3).column(0).dictionary_page_offset
    )


def test_a_page_with_a_wrong_checksum_is_lost(path: Path) -> None:
    made = table(values(), TIMES)
    how: dict[str, Any] = {"compression": "none", "use_dictionary": False, "write_page_checksum": True}
    pq.write_table(made, path, row_group_size=200, **how)
    column = pq.read_metadata(path).row_group(1).column(1)
    whole = bytearray(path.read_bytes())
    whole[column.data_page_offset + column.total_compressed_size - 3] ^= 1
    path.write_bytes(whole)
    found = read(path)
    assert (found.g == np.delete(values(), np.arange(200, 400), axis=0)).all()
    assert found.codes == ["bad_page"]


@every_byte
def test_a_file_that_was_cut_short_is_refused_with_a_hint(tmp_path: Path, step: int) -> None:
    data = make(tmp_path, np.rint(values() * 256).astype("i2"), 50.0, 256.0).path.read_bytes()
    path = tmp_path / "cut.parquet"
    for size in table_cuts(data, step):
        path.write_bytes(data[:size])
        with pytest.raises(UnreadableError) as failure:
            read(path, format="parquet")
        assert failure.value.hint


@pytest.mark.parametrize("head", [b"PARE", b"PAR1"])
def test_what_is_encrypted_is_said(path: Path, head: bytes) -> None:
    path.write_bytes(head + bytes(40) + b"PARE")
    with pytest.raises(UnreadableError, match="is encrypted"):
        read(path)


def test_tables_that_are_no_recordings_are_told_from_damage(path: Path) -> None:
    write(path, {"name": ["a", "b"], "age": [1.0, 2.0]})
    with pytest.raises(NoRecordingError, match="--columns"):
        read(path)
    write(path, {"time": times(0), **axes(values(0))})
    with pytest.raises(UnreadableError, match="holds no rows"):
        read(path)


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a calibrated recording of ours, which lies beside its report."""
    folder = tmp_path_factory.mktemp("ours")
    raw = make(folder, still_counts(directions(60)), RATE_HZ, LSB_PER_G).path
    assert exit_code("calibrate", raw, "-d", folder / "out", "-q") == 0
    return folder / "out"


@pytest.fixture
def calibrated(ours: Path, tmp_path: Path) -> Path:
    """Return the recording under another name."""
    shutil.copytree(ours, tmp_path / "first")
    return (tmp_path / "first" / "made.calibrated.parquet").rename(tmp_path / "renamed.parquet")


def test_a_calibrated_recording_is_not_calibrated_again(
    tmp_path: Path, calibrated: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    done = run(capsys, "calibrate", calibrated, "-d", out, "-q")
    assert done.code == 0
    assert done.out.split("\t")[1:3] == ["already_good", "0"]
    report = json.loads((out / "renamed.calibration.json").read_text())
    assert report["calibration"]["gain"] == [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    first = json.loads((tmp_path / "first" / "made.calibration.json").read_text())
    error = first["holdout"]["after_mg"]["mean"]
    assert report["reason"] == "calibrated_before"
    assert f"from made.parquet (calibrated, {error:.1f} mg held out)" in report["values"]["origin"]
    assert sorted(one.name for one in out.iterdir()) == ["renamed.calibration.json", "renamed.quality.json"]
    assert "up to date" in run(capsys, "calibrate", calibrated, "-d", out).err
    assert run(capsys, "verify", out / "renamed.calibration.json", calibrated).code == 0


def test_coefficients_are_not_applied_to_a_calibrated_recording(
    tmp_path: Path, calibrated: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = tmp_path / "first" / "made.calibration.json"
    done = run(capsys, "apply", calibrated, "--coefficients", report, "-d", tmp_path / "out")
    assert done.code == 2
    assert "calibrated already, from made.parquet" in done.err
    assert "the raw recording" in done.err


def test_inspect_of_a_calibrated_recording(calibrated: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = run(capsys, "inspect", calibrated)
    assert done.code == 0
    assert "already_good: The recording is calibrated already, from made.parquet" in done.out
    read_back = pq.read_table(calibrated)
    with open_recording(calibrated, ReadOptions()) as reader:
        (chunk,) = reader.chunks(1 << 20)
        assert reader.recording.calibrated is not None
    stored = np.stack([read_back[name].to_numpy() for name in "xyz"], axis=1)
    assert np.abs(chunk.counts / FLOAT_LSB_PER_G - stored).max() <= 0.5 / FLOAT_LSB_PER_G
    assert chunk.validity is not None
    assert (chunk.validity == read_back["validity"].to_numpy()).all()


def test_damaged_words_of_ours_make_it_no_raw_recording(calibrated: Path) -> None:
    found = pq.read_table(calibrated)
    for text in (b"{", b"[]", b'{"recording": 7, "result": {"outcome": 1, "held_out_mg": "x"}}'):
        pq.write_table(found.replace_schema_metadata({b"accelcal": text}), calibrated)
        with open_recording(calibrated, ReadOptions()) as reader:
            said = reader.recording.calibrated
            assert said is not None
            assert said.sentence() == "calibrated already, from a recording of unknown name"


def test_raw_values_of_a_refused_recording_are_raw(calibrated: Path) -> None:
    found = pq.read_table(calibrated)
    marks = pa.array(found["validity"].to_numpy() + np.uint8(4))
    found = found.set_column(found.schema.get_field_index("validity"), "validity", marks)
    about = json.dumps({"outcome": "refused", "calibration": None, "recording": {}})
    pq.write_table(found.replace_schema_metadata({b"accelcal": about}), calibrated)
    with open_recording(calibrated, ReadOptions()) as reader:
        (chunk,) = reader.chunks(1 << 20)
        assert reader.recording.calibrated is None
    assert chunk.validity is not None
    assert (chunk.validity == marks.to_numpy() - 4).all()


def test_other_tables_of_ours_are_no_recordings(path: Path) -> None:
    write(path, {"time": times(), **axes(values())}, {"accelcal": "{}"})
    with pytest.raises(NoRecordingError, match=r"a table that accelcal wrote.*`accelcal fit`"):
        read(path)
    write(path, axes(values(20)))
    with pytest.raises(UnreadableError, match=r"sampling rate.*`accelcal fit`"):
        read(path)


def test_a_study_takes_tables_that_hold_acceleration_and_lets_others_lie(
    tmp_path: Path, calibrated: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = tmp_path / "study"
    study.mkdir()
    calibrated.rename(study / "renamed.parquet")
    write(study / "results.parquet", {"age": [1.0, 2.0]})
    (study / "damaged.parquet").write_bytes((study / "renamed.parquet").read_bytes()[:5000])
    done = run(capsys, "study", study, "-d", tmp_path / "out", "-q", "-j", "1")
    with (tmp_path / "out" / "study.csv").open(encoding="utf-8", newline="") as file:
        outcomes = {row["path"]: row["outcome"] for row in csv.DictReader(file)}
    assert outcomes == {"renamed.parquet": "already_good", "damaged.parquet": "failed"}
    assert done.code == 1


@pytest.mark.parametrize("column", [0, 1], ids=["time", "x"])
def test_a_footer_at_which_pyarrow_aborts_costs_a_row_group(path: Path, column: int) -> None:
    """pyarrow ends the process when asked where a column begins whose sizes speak of levels that it lacks."""
    pq.write_table(table(values(600), even_times(600, 50.0)), path, row_group_size=200)
    begin = pq.read_metadata(path).row_group(1).column(0).dictionary_page_offset
    data = path.read_bytes()
    length = int.from_bytes(data[-8:-4], "little")
    footer = pages.read(data[-8 - length : -8])
    meta = pages.value_of(pages.value_of(pages.value_of(footer, 4)[1], 1)[column], 3)
    levels = (2, pages.LIST, (pages.I64, [0] * 4))
    meta[:] = [*(field for field in meta if field[0] < 16), (16, pages.STRUCT, [levels])]
    made = pages.written(footer)
    path.write_bytes(data[: -8 - length] + made + len(made).to_bytes(4, "little") + data[-4:])
    ran = run_process("calibrate", path, "-d", path.parent, "--report-only", "--json", "-q")
    assert ran.code == 4, ran.err
    (problem,) = json.loads(ran.out)["file_health"]["problems"]
    assert (problem["code"], problem["sample"], problem["count"]) == ("bad_page", 200, 200)
    assert problem["byte_offset"] == begin
