"""Public .cwa recordings, sample for sample as actfast and scikit-digital-health read them.

Neither reads the file with six corrupt blocks; test_cwa_damage.py holds that one to its intact twin.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import open_recording

Found = tuple[np.ndarray, np.ndarray | None]
"""Acceleration [g] and rotation [deg/s], (n, 3) each."""

NAMES = (
    "ax3_100hz_3min.cwa",
    "ax3_200hz_5min.cwa",
    "ax3_sacrum_100hz_3h.cwa",
    "ax6_100hz_2min.cwa",
    "ax6_100hz_6min.CWA",
)


def by_actfast(path: Path) -> Found:
    series = pytest.importorskip("actfast").read(str(path))["timeseries"]["high_frequency"]
    return series["acceleration"], series.get("gyroscope")


def by_skdh(path: Path) -> Found:
    reader = pytest.importorskip("skdh.io").ReadCwa()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = reader.predict(file=str(path))
    return found["accel"], found.get("gyro")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("reader", [by_actfast, pytest.param(by_skdh, marks=pytest.mark.nightly)])
def test_counts_are_the_same_integers(real_data: Path, name: str, reader: Callable[[Path], Found]) -> None:
    path = real_data / "vendor" / name
    with open_recording(path, ReadOptions()) as ours:
        chunks, about = list(ours.chunks(100_000)), ours.recording
    accel, gyro = reader(path)
    assert np.array_equal(
        np.concatenate([chunk.counts for chunk in chunks]), np.rint(accel * about.lsb_per_g)
    )
    assert (about.gyro_dps_per_lsb is not None) == name.startswith("ax6")
    if about.gyro_dps_per_lsb is not None:
        counts = np.concatenate([chunk.gyro_counts for chunk in chunks])
        assert gyro is not None and np.array_equal(counts, np.rint(gyro / about.gyro_dps_per_lsb[0]))
