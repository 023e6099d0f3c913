"""Tables of still-window means, as other tools write them."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.collect.cells import CellCollector
from accelcal_cli.collect.table import PointTable, points_of_table, read_table
from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.points import WEIGHT_ONE
from accelcal_cli.core.settings import DEFAULT
from tests.collect.made import plain, windows

ONE_G = 1 << 24


def written(folder: Path, text: str, name: str = "points.csv") -> Path:
    path = folder / name
    path.write_text(text, "utf-8")
    return path


@pytest.mark.parametrize(
    "text",
    [
        "x,y,z\n1,0.5,-0.25\n0,0,1\n",
        "X;Y;Z\n1;0.5;-0.25\n0;0;1\n",
        "x\ty\tz\n1\t0.5\t-0.25\n0\t0\t1\n",
        '"","sdx","meanx","meany","meanz"\n"1",9,1,0.5,-0.25\n"2",9,0,0,1\n',
        "z,y,x\r\n-0.25,0.5,1\r\n1,0,0\r\n",
        "x, y, z\n1, 0.5, -0.25\n 0, 0, 1e0\n",
        "x;y;z\n1;0,5;-0,25\n0;0;1\n",
        "\ufeffx [g]\ty [g]\tz [g]\r\n1,0\t,5\t-2,5e-1\r\n0\t0\t1\r\n",
        "x|y|z\n1|0.5|-0.25\n0|0|1\n",
        "x  y z\n1 0.5   -0.25\n0 0 1\n",
    ],
    ids=[
        *("plain", "semicolons", "tabs", "as R writes it", "any order", "spaces", "decimal commas"),
        *("byte order mark, units, decimal commas", "bars", "blanks"),
    ],
)
def test_positions_are_read_as_whole_counts(tmp_path: Path, text: str) -> None:
    table = read_table(written(tmp_path, text))
    assert table.counts.tolist() == [[ONE_G, ONE_G // 2, -ONE_G // 4], [0, 0, ONE_G]]
    assert table.temperature_mc is None and table.weight is None and table.posture is None


def test_temperature_weight_and_posture_come_along(tmp_path: Path) -> None:
    text = "x,y,z,temperature_c,weight,posture\n1,0,0,30.0016,2.5,left\n0,1,0,-1.5,1,back\n0,0,1,3,1,left\n"
    table = read_table(written(tmp_path, text))
    assert table.temperature_mc is not None and table.temperature_mc.tolist() == [30_002, -1500, 3000]
    assert table.weight is not None and table.weight.tolist() == [2.5, 1, 1]
    assert table.posture is not None and table.posture.tolist() == [1, 0, 1]


def test_a_packed_table_is_read(tmp_path: Path) -> None:
    path = tmp_path / "points.csv.gz"
    path.write_bytes(gzip.compress(b"x,y,z\n1,0,0\n"))
    assert len(read_table(path)) == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "empty"),
        ("x,y\n1,0\n", "line 1: has no column z"),
        ("a,b,c\n1,0,0\n", "line 1: has no column x, y, z"),
        ("x,y,z\n1,0,0\n1,nan,0\n", "line 3: y is 'nan', not a number"),
        ("x,y,z\n1,0,0\n1,,0\n", "line 3: y is '', not a number"),
        ("x,y,z\n1,0,inf\n", "line 2: z is 'inf', not a number"),
        ("x,y,z\n1,0,0\n\n0,1,0\n", "line 3: x is '', not a number"),
        ("x,y,z\n1,0,9999\n", "line 2: z is '9999', not a number within +-100"),
        ("x,y,z,temp\n1,0,0,hot\n", "line 2: temp is 'hot', not a number within +-1000"),
        ("x,y,z,weight\n1,0,0,1\n1,0,0,0\n", "line 3: has no weight above zero"),
        ("x,y,z,posture\n1,0,0,\n", "line 2: has no posture"),
        ("x,y,z\n1,0,0\n1,0,0,7,8\n", "not a table of points"),
        ("x,y,z\n1,'0\n", "line 2: y is"),
    ],
)
def test_what_is_no_table_of_points_is_said_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(UnreadableError) as caught:
        read_table(written(tmp_path, text))
    assert said in str(caught.value)
    assert "points.csv" in str(caught.value)


def test_rows_longer_than_the_header_are_not_cut(tmp_path: Path) -> None:
    """As R's write.table makes them, with names of rows that have no column name."""
    with pytest.raises(UnreadableError, match="more fields than the header line"):
        read_table(written(tmp_path, "x,y,z\n1,0,0,1\n2,0,1,0\n"))


@pytest.mark.parametrize(
    "data", [b"\x00" * 300, bytes(range(256)) * 4, b"\x1f\x8b\x08\x00broken", b"x,y,z\n\xff,1,2\n"]
)
def test_binary_rubbish_is_an_error_of_ours(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "points.csv"
    path.write_bytes(data)
    with pytest.raises(UnreadableError):
        read_table(path)


def test_a_missing_file_is_an_error_of_ours(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match=r"none\.csv"):
        read_table(tmp_path / "none.csv")


def test_a_table_cut_anywhere_gives_its_whole_rows_or_an_error(tmp_path: Path) -> None:
    text = "x,y,z,temperature_c\n0.99,0.01,-0.02,25.5\n-0.01,1.01,0.03,26.25\n"
    whole = read_table(written(tmp_path, text))
    for end in range(len(text)):
        try:
            table = read_table(written(tmp_path, text[:end], "cut.csv"))
        except UnreadableError:
            continue
        rows = text[:end].count("\n") - 1
        assert table.counts[:rows].tolist() == whole.counts[: max(rows, 0)].tolist()


G = 1 << 24


def table(g: list[tuple[float, float, float]], **more: np.ndarray) -> PointTable:
    return PointTable(np.rint(np.array(g) * G).astype(np.int64).reshape(-1, 3), **more)


def test_plain_rows_are_collected_like_windows() -> None:
    random = np.random.default_rng(4)
    g = random.standard_normal((400, 3))
    g /= np.linalg.norm(g, axis=1)[:, None]
    warm = random.integers(20_000, 30_000, 400)
    held = PointTable(np.rint(g * G).astype(np.int64), warm)
    collector = CellCollector(float(G), DEFAULT, temperature=True)
    collector.add(windows(1, held.counts.tolist(), temperature_sums=warm.tolist()))
    given = points_of_table(held, DEFAULT)
    assert plain(given.points) == plain(collector.points())
    assert given.label is None and given.implausible == 0 and len(given.rows) == 400


def test_rows_far_from_one_g_are_left_out_and_counted() -> None:
    given = points_of_table(table([(0, 0, 1), (0, 0, 9), (0, 0, 0), (0, 0, 0.4)]), DEFAULT)
    assert (len(given.points), len(given.rows), given.implausible) == (1, 1, 3)


def test_postures_of_the_table_are_kept_apart() -> None:
    posture = np.array([0, 1, 1, 1])
    given = points_of_table(
        table([(0, 0.01, 1.01), (0, 0.01, 1.01), (0, 0.01, 1.01), (0, 0.06, 1.01)], posture=posture), DEFAULT
    )
    # posture 1 holds two cells of one 2 x 2 x 2 group, which count as one point between them
    assert given.label is not None and given.label.tolist() == [0, 1, 1]
    assert given.points.windows.tolist() == [1, 2, 1]
    assert given.points.weights.tolist() == [WEIGHT_ONE, round(WEIGHT_ONE * 2 / 3), round(WEIGHT_ONE / 3)]


def test_weights_of_the_table_stand() -> None:
    weight = np.array([2.0, 1.0, 1.0])
    given = points_of_table(table([(0.25, 0.01, 1), (0.28125, 0.01, 1), (0, 1, 0)], weight=weight), DEFAULT)
    order = np.argsort(given.points.xyz[:, 0])
    assert given.points.xyz[order, 0].tolist() == [0, round((2 * 0.25 + 0.28125) / 3 * ONE)]
    # weights 1 and 3 of a mean of 2
    assert (given.points.weights[order] / WEIGHT_ONE).tolist() == [0.5, 1.5]
    assert given.label is None


def test_local_gravity_is_one() -> None:
    place = replace(DEFAULT, latitude=0.0)
    g = float(place.gravity.local_g())
    given = points_of_table(table([(0, 0, g)]), place)
    assert abs(int(given.points.xyz[0, 2]) - ONE) <= ONE / G


def test_temperature_can_be_left_aside() -> None:
    held = table([(0, 0, 1), (0, 0, 1)], temperature_mc=np.array([20_000, 30_000]))
    assert points_of_table(held, replace(DEFAULT, temperature=False)).points.tau is None
    given = points_of_table(held, DEFAULT)
    assert given.points.temperature is not None and given.rows.tau is not None
    span = given.points.temperature.span_c
    assert (given.rows.tau / ONE * span).tolist() == [-5.0, 5.0]


def test_an_empty_table_gives_no_points() -> None:
    empty = PointTable(np.empty((0, 3), np.int64), weight=np.empty(0))
    assert len(points_of_table(empty, DEFAULT).points) == 0
