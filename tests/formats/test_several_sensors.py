"""Tables of several sensors or people: refused with the column and its values; --sensor chooses."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import EACH, ReadOptions
from accelcal_cli.formats import open_recording
from accelcal_cli.formats.tables import roles, tracks
from accelcal_cli.formats.tables.text import source as text
from tests.formats import one_table
from tests.formats.one_table import CONTAINERS, Columns

RNG = np.random.default_rng(46)
START_US = 1_709_548_900_000_000
PERIOD_US = 40_000
ROWS = 1500


def stream(
    value: Any, rows: int = ROWS, after_us: int = 0, name: str = "sensor", tilt: float = 0.0
) -> Columns:
    """One sensor: times [us], x, y, z in g, and its value in a column of this name."""
    angles = np.repeat(RNG.uniform(0, 2 * np.pi, -(-rows // 200)), 200)[:rows]
    xyz = np.stack([np.cos(angles), np.sin(angles), np.full(rows, tilt)], axis=1)
    xyz += RNG.normal(0, 0.003, xyz.shape)
    times = START_US + after_us + PERIOD_US * np.arange(rows)
    return {"time": times, **dict(zip("xyz", xyz.T, strict=True)), name: np.full(rows, value)}


def stacked(*streams: Columns) -> Columns:
    """Streams one after the other."""
    return {name: np.concatenate([one[name] for one in streams]) for name in streams[0]}


def by_time(table: Columns) -> Columns:
    """The rows in the order of their times."""
    order = np.argsort(table["time"], kind="stable")
    return {name: values[order] for name, values in table.items()}


def with_column(table: Columns, name: str, values: Any) -> Columns:
    return {**table, name: np.asarray(values)}


def without(table: Columns, name: str) -> Columns:
    return {key: values for key, values in table.items() if key != name}


TEXTS = ("csv", "csv.gz", "semicolons", "parquet", "feather", "npz", "h5")
NUMBERS = (*TEXTS, "mat")


def written(folder: Path, kind: str, columns: Columns, name: str = "table") -> Path:
    """A table in a container."""
    return CONTAINERS[kind].file(folder, one_table.table(name, columns), name)


def read(path: Path, chunk_samples: int = 256, **options: Any) -> tuple[Any, np.ndarray, np.ndarray]:
    """The recording, its counts in g, and its times."""
    with open_recording(path, ReadOptions(unit="g", **options)) as reader:
        chunks = [chunk for chunk in reader.chunks(chunk_samples) if len(chunk)]
        counts = np.concatenate([chunk.counts for chunk in chunks]) / reader.recording.lsb_per_g
        times = np.concatenate([chunk.clock.times(0, len(chunk)) for chunk in chunks])
        return reader.recording, counts, times


def refusal(path: Path, **options: Any) -> str:
    with pytest.raises(UnreadableError) as error:
        read(path, **options)
    return str(error.value)


LEFT_RIGHT = stacked(stream("left"), stream("right", tilt=0.1))
ONE_TWO = stacked(stream(1), stream(2, tilt=0.1))
SEVERAL = {
    "in turn": by_time(LEFT_RIGHT),
    "one after the other, times again": LEFT_RIGHT,
    "one after the other, an hour later": stacked(
        stream("lw", name="location"), stream("rw", after_us=3_600_000_000, name="location")
    ),
    "people, one after the other without a pause": stacked(
        stream("s1", name="Subject ID"), stream("s2", after_us=ROWS * PERIOD_US, name="Subject ID")
    ),
    "in turn, clocks of their own": by_time(stacked(stream("a", name="q"), stream("b", 1500, 9_000, "q"))),
    "any name, in turn": by_time(stacked(stream("a", name="q"), stream("b", name="q"))),
    "any name, times again": stacked(stream("a", name="q"), stream("b", name="q")),
    "three, packets of ten": None,
    "without times": without(LEFT_RIGHT, "time"),
    "without times, in turn": without(
        by_time(stacked(stream("a", name="id"), stream("b", name="id"))), "time"
    ),
}
packets = stacked(*(stream(value, name="node") for value in ("n1", "n2", "n3")))
order = np.lexsort((packets["time"], packets["node"], (packets["time"] - START_US) // (10 * PERIOD_US)))
SEVERAL["three, packets of ten"] = {name: values[order] for name, values in packets.items()}


@pytest.mark.parametrize("kind", SEVERAL)
@pytest.mark.parametrize("name", TEXTS)
def test_verdicts_13_several_sensors_in_one_table_are_refused(tmp_path: Path, name: str, kind: str) -> None:
    table = SEVERAL[kind]
    path = written(tmp_path, name, table)
    rate = {} if "time" in table else {"rate_hz": 25.0}
    column = next(key for key in table if key not in ("time", *"xyz"))
    first, second = dict.fromkeys(table[column].tolist()) if kind[:5] != "three" else ("n1", "n2")
    text = refusal(path, **rate)
    assert f"column '{column}' has {first}, {second}" in text
    assert f"--sensor {first} or --sensor {second}" in text
    chosen = table[column] == first
    recording, counts, times = read(path, **rate, sensor=first)
    assert recording.rate_hz == 25.0
    assert np.allclose(counts, np.stack([table[axis][chosen] for axis in "xyz"], axis=1), atol=2e-5)
    if "time" in table:
        assert np.abs(times - table["time"][chosen]).max() < 1000
    assert any(f"{column} {first}" in note for note in recording.notes)


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("table", [by_time(ONE_TWO), ONE_TWO], ids=["in turn", "stacked"])
def test_numbers_tell_sensors_apart_as_well(tmp_path: Path, name: str, table: Columns) -> None:
    path = written(tmp_path, name, table)
    assert "'sensor' has 1, 2" in refusal(path)
    assert len(read(path, sensor="2")[1]) == ROWS


ONE = without(stream("one", 3000), "sensor")
NOT_SEVERAL = {
    "constant": ("sensor", np.full(3000, "left")),
    "constant number": ("id", np.full(3000, 7)),
    "activity": ("activity", np.repeat(["walking", "sitting", "walking", "lying"], 750)),
    "place without a pause": ("location", np.repeat(["home", "work", "home"], 1000)),
    "any text along time": ("q", np.repeat(["a", "b", "c"], 1000)),
    "marker": ("marker", (np.arange(3000) % 611 == 3).astype(int)),
    "button as text": ("button", np.where(np.arange(3000) % 500 < 5, "1", "0")),
    "day": ("day", np.repeat([1, 2, 3], 1000)),
    "block": ("block", np.repeat(np.arange(30), 100)),
    "temperature as text": ("Temp sensor", np.where(RNG.random(3000) < 0.5, "22 C", "23 C")),
    "light": ("lux", RNG.integers(0, 3, 3000)),
    "wear": ("worn", np.repeat(["yes", "no"], 1500)),
    "flicker of any name": ("q", RNG.integers(0, 2, 3000)),
    "noise of any name": ("q", RNG.integers(0, 20, 3000)),
    "packet": ("packet_id", np.arange(3000) // 10),
    "row": ("id", np.arange(3000)),
    "damaged cell": ("sensor", np.where(np.arange(3000) == 700, "lefx", "left")),
}


@pytest.mark.parametrize("kind", NOT_SEVERAL)
@pytest.mark.parametrize("name", ["csv", "parquet"])
def test_verdicts_13_what_is_one_recording_stays_one(tmp_path: Path, name: str, kind: str) -> None:
    column, values = NOT_SEVERAL[kind]
    plain, _, times = read(written(tmp_path, name, ONE, "plain"))
    found, counts, own = read(written(tmp_path, name, with_column(ONE, column, values)))
    assert (len(counts), found.rate_hz, found.start_us) == (3000, plain.rate_hz, plain.start_us)
    assert np.array_equal(own, times)


@pytest.mark.parametrize("name", ["csv", "parquet"])
@pytest.mark.parametrize("column", ["activity", "q", "light_level"])
def test_shared_or_repeated_stamps_do_not_make_sensors_of_labels(
    tmp_path: Path, name: str, column: str
) -> None:
    """Whole seconds, pairs of rows with one stamp, and an hour that comes again."""
    flicker = RNG.integers(0, 12, 3000)
    label = np.repeat(["walking", "sitting", "lying"], 1000)
    seconds = {**ONE, "time": ONE["time"] // 1_000_000 * 1_000_000}
    pairs = {**ONE, "time": START_US + np.arange(3000) // 2 * 2 * PERIOD_US}
    again = {**ONE, "time": ONE["time"] - 30_000_000 * (np.arange(3000) >= 1700)}
    for number, times in enumerate((seconds, pairs, again)):
        for values in (flicker, label):
            path = written(tmp_path, name, with_column(times, column, values), str(number))
            assert len(read(path)[1]) == 3000


def test_sections_of_one_device_may_begin_again(tmp_path: Path) -> None:
    """Trials that count from their own start are labels; the same times for two values of `q` are not."""
    times = np.tile(np.arange(1000), 3) * PERIOD_US / 1e6
    table = {**ONE, "time": times}
    for name, refused in (("trial", False), ("day", False), ("q", True), ("subject", True)):
        path = written(tmp_path, "csv", with_column(table, name, np.repeat(["a", "b", "c"], 1000)))
        if refused:
            assert f"column '{name}' has a, b, c" in refusal(path)
        else:
            assert len(read(path)[1]) == 3000


@pytest.mark.parametrize("name", ["csv", "csv.gz", "parquet", "npz"])
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("kind", ["stacked", "in turn", "later"])
def test_sensors_behind_the_head_are_found_in_the_pass(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, threads: int, kind: str
) -> None:
    monkeypatch.setattr(text, "BLOCK_BYTES", 1 << 16)
    monkeypatch.setattr(text, "HEAD_BYTES", 1 << 15)
    monkeypatch.setattr(tracks, "BLOCK_ROWS", 500)
    left, right = stream("left", 6000), stream("right", 3000, 0 if kind == "stacked" else 3000 * PERIOD_US)
    if kind == "later":
        right = stream("right", 3000, 9_000_000_000)
    table = stacked(left, right) if kind != "in turn" else by_time(stacked(left, right))
    path = written(tmp_path, name, table)
    with open_recording(path, ReadOptions(unit="g")) as reader:
        reader.threads = threads
        with pytest.raises(UnreadableError, match="'sensor' has left, right and perhaps more"):
            list(reader.chunks(500))
    assert len(read(path, 500, sensor="right")[1]) == 3000


def test_people_with_sensors_are_chosen_by_both(tmp_path: Path) -> None:
    parts = [
        with_column(stream(side, 600, 0, "side"), "subject", np.full(600, who))
        for who in ("s1", "s2")
        for side in ("left", "right")
    ]
    for name in ("csv", "parquet"):
        path = written(tmp_path, name, stacked(*parts))
        assert "--sensor s1 or --sensor s2" in refusal(path)
        assert "--sensor s2,left or --sensor s2,right" in refusal(path, sensor="s2")
        assert len(read(path, sensor="s2,right")[1]) == 600


def test_all_rows_can_be_read_as_those_of_one_sensor(tmp_path: Path) -> None:
    for name in ("csv", "parquet"):
        assert len(read(written(tmp_path, name, LEFT_RIGHT), sensor="all")[1]) == 2 * ROWS


def test_a_sensor_that_is_not_there_is_refused_with_those_that_are(tmp_path: Path) -> None:
    for name in ("csv", "parquet"):
        with pytest.raises(UsageError, match=r"no row is of the sensor 'up'; .*sensor has left, right"):
            read(written(tmp_path, name, LEFT_RIGHT), sensor="up")


def test_gyroscope_and_temperature_are_those_of_the_sensor(tmp_path: Path) -> None:
    table = by_time(LEFT_RIGHT)
    right = table["sensor"] == "right"
    for axis in "xyz":
        table[f"gyro_{axis}_dps"] = np.where(right, 30.0, -10.0)
    table["temperature_c"] = np.where(right, 25.0, 20.0)
    for name in ("csv", "parquet"):
        path = written(tmp_path, name, table)
        with open_recording(path, ReadOptions(unit="g", sensor="right")) as reader:
            for chunk in reader.chunks(300):
                assert set(chunk.temperature_mc.tolist()) <= {25_000}
                assert set(np.unique(chunk.gyro_counts * reader.recording.gyro_dps_per_lsb[0])) <= {30.0}


def test_latin_letters_quotes_and_blanks_are_values_too(tmp_path: Path) -> None:
    table = by_time(stacked(stream("Müller, A", name="person"), stream("b", name="person")))
    path = written(tmp_path, "semicolons", table)
    path.write_bytes(path.read_text("utf-8").replace("Müller, A", '"Müller, A"').encode("latin-1"))
    assert "--sensor 'Müller, A'" in refusal(path)
    assert len(read(path, sensor="Müller, A")[1]) == ROWS


def listed(path: Path, within: str | None = None, **options: Any) -> tuple[str, ...]:
    """What `each` lists, of all rows or within those of a sensor: nothing if they are of one."""
    try:
        read(path, sensor=EACH if within is None else f"{within},{EACH}", **options)
    except UnreadableError as error:
        return error.sensors
    return ()


@pytest.mark.parametrize("kind", SEVERAL)
@pytest.mark.parametrize("name", TEXTS)
def test_t1_each_lists_the_sensors_of_a_table(tmp_path: Path, name: str, kind: str) -> None:
    table = SEVERAL[kind]
    path = written(tmp_path, name, table)
    rate = {} if "time" in table else {"rate_hz": 25.0}
    column = next(key for key in table if key not in ("time", *"xyz"))
    values = sorted(set(table[column].tolist()))
    assert sorted(listed(path, **rate)) == [f"{column}={value}" for value in values]
    for value in values:
        named = read(path, **rate, sensor=f"{column}={value}")
        assert np.array_equal(named[1], read(path, **rate, sensor=value)[1])


@pytest.mark.parametrize("name", NUMBERS)
def test_t1_each_finds_a_sensor_that_comes_late_whatever_other_columns_hold(
    tmp_path: Path, name: str
) -> None:
    """Behind the blocks that are looked at first; a count of rows and a label have its value as well."""
    rows = 30_000
    table = stacked(*(stream(value, rows, name="subject") for value in (1, 2)))
    table = with_column(table, "packet", np.arange(2 * rows))
    table = with_column(table, "trial", np.arange(2 * rows) // 500 % 4)
    path = written(tmp_path, name, table)
    assert listed(path) == ("subject=1", "subject=2")
    _, counts, _ = read(path, sensor="subject=2")
    expected = np.stack([table[axis][rows:] for axis in "xyz"], axis=1)
    assert counts.shape == expected.shape and np.allclose(counts, expected, atol=2e-5)


@pytest.mark.parametrize("name", TEXTS)
def test_t1_each_of_several_people_with_several_sensors(tmp_path: Path, name: str) -> None:
    both = by_time(LEFT_RIGHT)
    table = stacked(*({**both, "person": np.full(2 * ROWS, person)} for person in ("P1", "P2")))
    only = stacked(table, {**stream("left"), "person": np.full(ROWS, "P3")})
    path = written(tmp_path, name, only)
    (column,) = {one.partition("=")[0] for one in listed(path)}
    found = {one: listed(path, within=one) for one in listed(path)}
    if column == "person":
        both = ("sensor=left", "sensor=right")
        people = {f"person={one}": tuple(f"person={one},{side}" for side in both) for one in ("P1", "P2")}
        assert found == {**people, "person=P3": ()}
    else:
        assert set(found) == {"sensor=left", "sensor=right"}
        assert found["sensor=right"] == ("sensor=right,person=P1", "sensor=right,person=P2")
        assert found["sensor=left"][2:] == ("sensor=left,person=P3",)
    for one in (one for sensor, more in found.items() for one in more or (sensor,)):
        assert len(read(path, sensor=one)[1]) == ROWS


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize(
    "value", ["all", "each", "a, b", "x=1", "sensor=a", "ü m/s", "50%", "#2 (left)", "'q'"]
)
def test_t1_a_value_of_any_characters_is_chosen_by_its_column(tmp_path: Path, name: str, value: str) -> None:
    if "," in value and name in ("csv", "csv.gz"):
        pytest.skip("there a comma ends a cell")
    path = written(tmp_path, name, by_time(stacked(stream(value), stream("other"))))
    assert set(listed(path)) == {f"sensor={value}", "sensor=other"}
    assert len(read(path, sensor=f"sensor={value}")[1]) == ROWS


@pytest.mark.parametrize("name", TEXTS)
def test_t1_each_leaves_a_table_of_one_sensor_alone(tmp_path: Path, name: str) -> None:
    labels = with_column(without(stream("A"), "sensor"), "activity", np.repeat(["walk", "sit", "lie"], 500))
    for number, table in enumerate((stream("A"), without(stream("A"), "sensor"), labels)):
        path = written(tmp_path, name, table, str(number))
        assert listed(path) == ()
        assert len(read(path, sensor=EACH)[1]) == ROWS


def test_t1_rows_without_a_value_are_of_nobody(tmp_path: Path) -> None:
    table = by_time(LEFT_RIGHT)
    table["sensor"] = np.where(np.arange(2 * ROWS) % 100 < 2, "", table["sensor"])
    path = written(tmp_path, "csv", table)
    assert listed(path) == ("sensor=left", "sensor=right")


def test_t1_a_sensor_of_a_device_is_a_device_of_its_own(tmp_path: Path) -> None:
    """Sensors that share the serial of their file are not pooled, and do not borrow from each other."""
    path = written(tmp_path, "h5", by_time(LEFT_RIGHT))
    with h5py.File(path, "a") as file:
        file.attrs["serial"] = "X7"
    assert read(path, sensor="left")[0].device.serial == "X7 (sensor left)"
    assert read(path, sensor="all")[0].device.serial == "X7"


def test_t1_a_table_of_several_sensors_in_an_archive_is_a_recording(tmp_path: Path) -> None:
    """Its sensors are listed; it is not set aside where another table is beside it."""
    names = {
        "table.csv": one_table.text(one_table.table("several", by_time(LEFT_RIGHT))),
        "one.csv": one_table.text(one_table.table("one", without(stream("A"), "sensor"))),
    }
    for number in (1, 2):
        path = tmp_path / f"{number}.zip"
        with zipfile.ZipFile(path, "w") as archive:
            for name in [*names][:number]:
                archive.writestr(name, names[name])
        with pytest.raises(UnreadableError) as error:
            open_recording(path, ReadOptions(unit="g", sensor=EACH), joined=False)
        if number == 1:
            assert error.value.sensors == ("sensor=left", "sensor=right")
        else:
            assert "holds 2 recordings" in error.value.message


@pytest.mark.parametrize("line", ["oops,1", "2024-03-04 00:00:04,0,0,1,L,7", '2024-03-04 00:00:04,0,0,"1,L'])
def test_t17_a_line_that_is_not_a_row_hides_no_sensor(tmp_path: Path, line: str) -> None:
    """The written times of the other lines are texts as well, and these lines were taken for bad ones."""
    body = [f"2024-03-04 00:00:{k // 25:02}.{k % 25 * 40:03},0.1,0.{k % 7},0.9" for k in range(200)]
    lines = ["time,x,y,z,sensor", *(f"{row},{one}" for row in body for one in "LR")]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([*lines[:101], line, *lines[101:]]) + "\n")
    with pytest.raises(UnreadableError, match="--sensor L or --sensor R"):
        read(path)
    for one in "LR":
        assert len(read(path, sensor=one)[1]) == 200
    assert sorted(listed(path)) == ["sensor=L", "sensor=R"]


def test_of_very_many_columns_the_most_telling_are_watched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(roles, "MOST_DIVIDING", 1)
    table = by_time(stacked(stream(1), stream(2)))
    table = with_column(table, "a", np.arange(len(table["x"])))
    with pytest.raises(UnreadableError, match="column 'sensor'"):
        read(written(tmp_path, "npz", table))


def test_a_column_of_half_floats_divides_nothing(tmp_path: Path) -> None:
    """Found by fuzzing: they end below the largest number that is compared."""
    table = with_column(stream("L"), "label", np.zeros(ROWS, np.float16))
    pq.write_table(pa.table(without(table, "sensor")), tmp_path / "a.parquet")
    with open_recording(tmp_path / "a.parquet", ReadOptions(unit="g")) as reader:
        assert sum(map(len, reader.chunks(1000))) == ROWS
