"""Written recordings as others read them (skipped without those: `pip install '.[oracles]'`)."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.formats import named_encoder
from tests.formats.writing import counts, recording, times, written

Found = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Acceleration [g] (n, 3), times [us] (n,), temperatures [C] as they come."""

NONE = np.empty(0)
LINK = {"lsb_per_g": 256.0, "range_g": 8.0}
OLDER = {"lsb_per_g": 341.0, "range_g": 6.0}


def by_actfast(path: Path) -> Found:
    series = pytest.importorskip("actfast").read(str(path))["timeseries"]
    main = series.get("high_frequency") or series["acceleration"]
    heat = series.get("low_frequency", {}).get("temperature", NONE)
    return main["acceleration"], main["datetime"] // 1000, heat


def by_skdh(path: Path) -> Found:
    io = pytest.importorskip("skdh.io")
    reader = {".cwa": io.ReadCwa, ".bin": io.ReadBin}[path.suffix]()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = reader.predict(file=str(path))
    return found["accel"], found["time"] * 1e6, found["temperature"]


def by_pygt3x(path: Path) -> Found:
    module = pytest.importorskip("pygt3x.reader")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with module.FileReader(str(path)) as reader:
            table = reader.to_pandas()
    return table[["X", "Y", "Z"]].to_numpy(), table.index.to_numpy() * 1e6, NONE


@pytest.mark.parametrize(
    ("name", "scale", "reader"),
    [
        ("cwa", LINK, by_actfast),
        pytest.param("cwa", LINK, by_skdh, marks=pytest.mark.nightly),
        ("geneactiv", LINK, by_actfast),
        pytest.param("geneactiv", LINK, by_skdh, marks=pytest.mark.nightly),
        ("gt3x", OLDER, by_actfast),
        ("gt3x", OLDER, by_pygt3x),
        ("gt3x", LINK, by_pygt3x),
    ],
)
@pytest.mark.parametrize("rate_hz", [pytest.param(50.0, marks=pytest.mark.nightly), 100.0])
def test_samples_and_times(
    tmp_path: Path, name: str, scale: dict[str, float], reader: Callable[[Path], Found], rate_hz: float
) -> None:
    what, values = recording(rate_hz=rate_hz, **scale), counts(12_000)
    accel, when, _ = reader(written(tmp_path, named_encoder(name), what, values))
    assert np.array_equal(np.rint(accel * scale["lsb_per_g"]), values)
    assert np.abs(accel - values / scale["lsb_per_g"]).max() <= (0.0005001 if name == "gt3x" else 1e-6)
    assert np.abs(when - times(12_000, what)).max() <= 1


@pytest.mark.parametrize("reader", [by_actfast, pytest.param(by_skdh, marks=pytest.mark.nightly)])
def test_temperatures_of_geneactiv(tmp_path: Path, reader: Callable[[Path], Found]) -> None:
    heat = np.repeat(np.array([24_900, 31_000], np.int32), 300)
    path = written(
        tmp_path, named_encoder("geneactiv"), recording(has_temperature=True), counts(600), heat=heat
    )
    found = reader(path)[2]
    assert np.unique(found).tolist() == pytest.approx([24.9, 31.0])
