"""Reading a study's table: what is there, what is not, and what is none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.devices.table import day, read
from accelcal_cli.studies.columns import NAMES
from tests.devices.made import KINDS, NOW_S, fitted, refused, write


def test_recordings_come_by_device_and_start(tmp_path: Path) -> None:
    rows = [
        fitted("B", 40), fitted("A", None), fitted("A", 20), refused("A", 10), fitted(None, 5),
        fitted("B", 3, format="csv"), fitted("A", 20, path="A/0"),
        {"path": "x.cwa", "outcome": "failed", "exit_code": 3},
    ]  # fmt: skip
    held = read(write(tmp_path, rows), NOW_S)
    assert [(device.serial, device.format) for device in held.devices] == [
        ("A", "cwa"), ("B", "csv"), ("B", "cwa"),
    ]  # fmt: skip
    assert held.first.tolist() == [0, 4, 5, 6]
    expected = [rows[3], rows[6], rows[2], rows[1], rows[5], rows[0]]
    assert held.text["path"] == [row["path"] for row in expected]
    assert (held.nameless, held.failed) == (2, 1)
    begin = np.datetime64("2024-03-04T12") - np.datetime64("1970-01-01T00")
    assert held.days[0] == begin / np.timedelta64(1, "D") + 10
    assert np.isnan(held.days[3])


def test_only_what_the_model_fitted_is_a_value(tmp_path: Path) -> None:
    rows = [fitted(model, 0, model=model) for model in ("3", "6", "6T", "9", "9T")]
    rows.append(fitted("z", 0, {"se_offset_x_g": 0.0, "k_xx": float("inf")}))
    held = read(write(tmp_path, rows), NOW_S)
    fits = [[int(value) for value in row] for row in np.isfinite(held.values)]
    assert fits == [
        [0, 0, 0, 0, 0, 0, 1, 1, 1, 0, 0, 0],
        [1, 1, 1, 0, 0, 0, 1, 1, 1, 0, 0, 0],
        [1, 1, 1, 0, 0, 0, 1, 1, 1, 1, 1, 1],
        [1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0],
        [1] * 12,
        [0, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0],
    ]
    assert np.isfinite(held.errors[5]).tolist() == [0, 1, 1, 1, 1, 1, 0, 1, 1, 0, 0, 0]


@pytest.mark.parametrize(
    ("start", "found"),
    [
        ("2024-03-04T00:00:00.000000", 19786.0),
        ("2024-03-04T01:00:00.000000+01:00", 19786.0),
        ("2024-03-04", 19786.0),
        ("1999-12-31T23:59:59", None),
        ("1970-01-01T00:00:00", None),
        ("2024-04-01T00:00:00", None),
        ("yesterday", None),
        ("", None),
        (None, None),
    ],
)
def test_a_date_that_cannot_be_is_none(start: str | None, found: float | None) -> None:
    told = day(start, 19800.0)
    assert np.isnan(told) if found is None else told == found


def test_a_start_two_days_ahead_is_another_zone_and_later_a_wrong_clock(tmp_path: Path) -> None:
    now = NOW_S / 86_400 - (np.datetime64("2024-03-04T12") - np.datetime64(0, "s")) / np.timedelta64(1, "D")
    held = read(write(tmp_path, [fitted("A", now + 1.99), fitted("A", now + 2.01)]), NOW_S)
    assert np.isfinite(held.days).tolist() == [True, False]


def test_no_table(tmp_path: Path) -> None:
    with pytest.raises(
        UsageError, match=r"is not the output folder of a study: no .*parquet; give the folder"
    ):
        read(tmp_path, NOW_S)
    (tmp_path / "study.2-of-8.parquet").write_bytes(b"x")
    with pytest.raises(UsageError, match="run the study with --collect"):
        read(tmp_path, NOW_S)


def test_a_table_that_is_none(tmp_path: Path) -> None:
    path = tmp_path / "study.parquet"
    for content in (b"", b"PAR1", bytes(4096), b"path,outcome\n"):
        path.write_bytes(content)
        with pytest.raises(UnreadableError, match="cannot be read"):
            read(tmp_path, NOW_S)
    pq.write_table(pa.table({"path": ["a"]}), path)
    with pytest.raises(UnreadableError, match="is not the table of a study of accelcal; name"):
        read(tmp_path, NOW_S)
    whole = pq.read_table(write(tmp_path, [fitted("A", 0)]) / "study.parquet")
    pq.write_table(whole.drop_columns([name for name in NAMES if name.startswith("se_")]), path)
    with pytest.raises(UnreadableError, match="it has no column se_k_xx"):
        read(tmp_path, NOW_S)
    pq.write_table(whole.replace_schema_metadata(None), path)
    with pytest.raises(UnreadableError, match="was made by a development version of accelcal; run"):
        read(tmp_path, NOW_S)
    for name in ("k_xx", "path"):
        wrong = pa.array([5 if KINDS[name] == "text" else "five"])
        pq.write_table(whole.set_column(whole.column_names.index(name), name, wrong), path)
        with pytest.raises(UnreadableError, match="cannot be read"):
            read(tmp_path, NOW_S)


def test_a_cut_table(tmp_path: Path) -> None:
    data = (write(tmp_path, [fitted("A", number) for number in range(4)]) / "study.parquet").read_bytes()
    for length in range(0, len(data), 997):
        (tmp_path / "study.parquet").write_bytes(data[:length])
        with pytest.raises(UnreadableError):
            read(tmp_path, NOW_S)


def test_an_empty_table_and_one_row(tmp_path: Path) -> None:
    assert len(read(write(tmp_path, []), NOW_S)) == 0
    assert len(read(write(tmp_path, [fitted("A", 0)]), NOW_S)) == 1


@pytest.mark.parametrize("name", ["format", "k_xx", "device_serial"])
@pytest.mark.parametrize("how", ["twice", "lists", "words"])
def test_columns_that_no_study_writes(tmp_path: Path, name: str, how: str) -> None:
    path = write(tmp_path, [fitted("A", 0), fitted("A", 30)]) / "study.parquet"
    table = pq.read_table(path)
    other = pa.array([[1.0], [2.0]]) if how == "lists" else pa.array(["1", "2"])
    if how == "twice":
        table = table.append_column(name, table[name])
    elif how == "lists" or KINDS[name] != "text":
        table = table.set_column(table.column_names.index(name), name, other)
    pq.write_table(table, path)
    if how == "words" and KINDS[name] == "text":
        assert len(read(tmp_path, NOW_S)) == 2
        return
    with pytest.raises(
        UnreadableError, match=f"more than one column {name}" if how == "twice" else "a column of"
    ):
        read(tmp_path, NOW_S)
