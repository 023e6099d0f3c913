"""`accelcal verify`: the Parquet file beside a report, its metadata and every value of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.cli.run import run, verify
from tests.device_recordings import donor, edit, set_coefficients, write_device
from tests.recordings import good_csv

Capture = pytest.CaptureFixture[str]


def rewrite(path: Path, change: Any) -> None:
    """Change a calibrated file's rows, keeping its schema."""
    table = pq.read_table(path)
    frame = table.to_pandas()
    changed = change(frame)
    pq.write_table(pa.Table.from_pandas(changed, schema=table.schema, preserve_index=False), path)


def set_last_bit(frame: pd.DataFrame) -> pd.DataFrame:
    values = frame["y"].to_numpy().copy()
    values.view(np.int32)[7123] ^= 1
    return frame.assign(y=values)


@pytest.mark.parametrize(
    ("change", "column", "row"),
    [
        (set_last_bit, "y", 7123),
        pytest.param(lambda frame: frame.iloc[:-1], "time", 29_999, marks=pytest.mark.nightly),
        (lambda frame: pd.concat([frame, frame.iloc[-1:]]), "time", 30_000),
        pytest.param(
            lambda frame: frame.assign(validity=np.uint8(2)), "validity", 0, marks=pytest.mark.nightly
        ),
    ],
)
def test_every_value_is_compared(tmp_path: Path, capsys: Capture, change: Any, column: str, row: int) -> None:
    report, path = donor(tmp_path), tmp_path / "donor.raw"
    parquet = tmp_path / "donor.calibrated.parquet"
    assert verify(capsys, report, path, "--values")[1]["parquet"]["rows"] == 30_000
    rewrite(parquet, change)
    assert verify(capsys, report, path)[0].code == 0
    ran, found = verify(capsys, report, path, "--values")
    assert (ran.code, found["result"], found["differs"]) == (1, "differs", [])
    assert (found["parquet"]["values"], found["parquet"]["metadata"]) == ("differs", "identical")
    assert (found["parquet"]["column"], found["parquet"]["first_row"]) == (column, row)
    assert run(capsys, "verify", report, path, "--values").lines[0].endswith("\tparquet.values")


def retell(path: Path, change: Any) -> None:
    """Change a calibrated file's schema, keeping its rows."""
    table = pq.read_table(path)
    pq.write_table(change(table), path)


def with_unit(table: pa.Table, name: str, unit: str) -> pa.Table:
    place = table.schema.get_field_index(name)
    return table.cast(table.schema.set(place, table.schema.field(place).with_metadata({"unit": unit})))


def with_metadata(table: pa.Table, **entries: str) -> pa.Table:
    kept = {key: value for key, value in table.schema.metadata.items() if key.decode() not in entries}
    return table.replace_schema_metadata({**kept, **{key: value for key, value in entries.items() if value}})


def with_key_of_ours(table: pa.Table) -> pa.Table:
    told = json.loads(table.schema.metadata[b"accelcal"]) | {"extra": 1}
    return with_metadata(table, accelcal=json.dumps(told))


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda table: with_metadata(table, time_zone="UTC"), "time_zone"),
        (lambda table: with_metadata(table, time_zone=""), "time_zone"),
        (lambda table: with_unit(table, "x", "m/s2"), "columns.x[1]"),
        (
            lambda table: table.set_column(0, "time", table["time"].cast(pa.timestamp("us", "UTC"))),
            "columns.time[0]",
        ),
        (lambda table: table.drop_columns(["validity"]), "columns.validity"),
        (lambda table: table.append_column("more", table["x"]), "columns.more"),
        (with_key_of_ours, "extra"),
    ],
)
def test_everything_that_the_file_says_of_itself_is_compared(
    tmp_path: Path, capsys: Capture, change: Any, key: str
) -> None:
    report, path = donor(tmp_path), tmp_path / "donor.raw"
    retell(tmp_path / "donor.calibrated.parquet", change)
    ran, found = verify(capsys, report, path)
    assert (ran.code, found["result"], found["differs"]) == (1, "differs", [])
    assert key in found["parquet"]["differs"]


def test_the_sign_of_a_zero_counts(tmp_path: Path, capsys: Capture) -> None:
    coefficients = donor(tmp_path)
    edit(coefficients, lambda held: set_coefficients(held, np.eye(3), np.zeros(3)))
    nought = write_device(tmp_path / "nought.raw", np.zeros((100, 3)))
    assert run(capsys, "apply", "--coefficients", coefficients, nought).code == 0
    report = tmp_path / "nought.calibration.json"
    assert verify(capsys, report, nought, "--values")[0].code == 0
    rewrite(tmp_path / "nought.calibrated.parquet", lambda frame: frame.assign(z=np.float32(-0.0)))
    assert verify(capsys, report, nought, "--values")[1]["parquet"]["column"] == "z"


def test_a_parquet_of_another_calibration_and_none_at_all(tmp_path: Path, capsys: Capture) -> None:
    report, path = donor(tmp_path), tmp_path / "donor.raw"
    parquet = tmp_path / "donor.calibrated.parquet"
    run(capsys, "calibrate", path, "--model", "6", "-d", tmp_path / "six")
    parquet.write_bytes((tmp_path / "six" / parquet.name).read_bytes())
    ran, found = verify(capsys, report, path, "--values")
    assert (ran.code, found["differs"], found["parquet"]["metadata"]) == (1, [], "differs")
    assert "calibration.model" in found["parquet"]["differs"]
    assert found["parquet"]["values"] == "differs"
    parquet.write_bytes(b"PAR1 no longer")
    assert verify(capsys, report, path)[0].code == 1
    assert verify(capsys, report, path, "--values")[0].code == 3
    parquet.unlink()
    assert verify(capsys, report, path)[0].code == 0
    ran, _ = verify(capsys, report, path, "--values")
    assert (ran.code, "omit --values" in ran.err) == (2, True)


def test_a_named_output_is_found_beside_its_report(tmp_path: Path, capsys: Capture) -> None:
    path = good_csv(tmp_path)
    run(capsys, "calibrate", "--model", 6, path, "-o", tmp_path / "out" / "mine.parquet")
    _, found = verify(capsys, tmp_path / "out" / "mine.calibration.json", path)
    assert found["parquet"]["path"] == str(tmp_path / "out" / "mine.parquet")
