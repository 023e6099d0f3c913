"""Calibrated files that somebody changed: refused where a column is not what accelcal writes, not misread."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.exports.data import ExportOptions, export_data
from tests.device_recordings import donor
from tests.exports.test_data import MOTION, changed

FORMS = {"csv": "a.csv", "npz": "a.npz", "mhealth": "m.csv", "parquet": "a.parquet", "bids": MOTION}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    donor(tmp_path, warm=True)
    return tmp_path / "donor.calibrated.parquet"


def other_times(path: Path) -> dict[str, object]:
    """Times in ways that are no times of ours; as nanoseconds they would be a thousand times as far apart."""
    times = pq.read_table(path)["time"]
    seconds = np.arange(len(times)) / 25
    holes = pa.array([None, *times[1:].to_pylist()], times.type)
    return {
        "nanoseconds": times.cast(pa.timestamp("ns")),
        "texts": times.cast(pa.string()),
        "seconds": seconds,
        "endless": np.full(len(times), np.inf),
        "without a value": holes,
    }


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", ["nanoseconds", "texts", "seconds", "endless", "without a value"])
def test_times_that_are_not_ours_are_refused(path: Path, form: str, kind: str) -> None:
    changed(path, time=other_times(path)[kind])
    with pytest.raises(UnreadableError, match="in its column time"):
        export_data(form, path, ExportOptions(path.with_name(FORMS[form])))
    assert not path.with_name(FORMS[form]).exists()


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("column", ["x", "temperature", "validity"])
def test_texts_and_lists_in_place_of_numbers_are_refused(path: Path, form: str, column: str) -> None:
    rows = pq.read_metadata(path).num_rows
    for values in (pa.array(["1\x1b"] * rows), pa.array([[1.0]] * rows)):
        changed(path, **{column: values})
        with pytest.raises(UnreadableError, match=f"in its column {column}"):
            export_data(form, path, ExportOptions(path.with_name(FORMS[form])))
