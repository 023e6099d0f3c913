"""The same raw values as other people's readers find (`pip install '.[oracles]'`; skipped without them).

Times are not compared: those readers begin anew at every stamp, which is only a whole or half second.
"""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.formats.geneactiv.oracle import factory
from tests.formats.geneactiv.test_geneactiv import REAL, joined, opened, random_counts
from tests.formats.make_geneactiv import header, pages, written

Oracle = Callable[[Path], tuple[np.ndarray, np.ndarray]]


def by_actfast(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Acceleration [g] of each sample and temperature of each page, by actfast."""
    series = pytest.importorskip("actfast").read(str(path))["timeseries"]
    return series["high_frequency"]["acceleration"].astype(float), series["low_frequency"]["temperature"]


def by_skdh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The same by scikit-digital-health."""
    reader = pytest.importorskip("skdh.io").ReadBin()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = reader.predict(file=str(path))
    return found["accel"], found["temperature"][::300]


def check(path: Path, oracle: Oracle) -> int:
    """Compare all samples as the integers that the device stored; gives their number."""
    theirs_g, warm = oracle(path)
    reader = opened(path)
    chunks = list(reader.chunks(100_000))
    ours_g = joined(chunks, "counts") / reader.recording.lsb_per_g
    gain, offset = factory(path)
    ours, theirs = (np.rint((values * gain + offset) / 100) for values in (ours_g, theirs_g))
    assert ours.shape == theirs.shape
    assert (ours == theirs).all()
    np.testing.assert_allclose(ours_g, theirs_g, rtol=1e-7, atol=1e-7)
    heat = joined(chunks, "temperature_mc")[::300] / 1000
    np.testing.assert_allclose(heat, warm[: len(heat)], atol=1e-5)
    return len(ours)


@pytest.mark.parametrize("name", REAL)
def test_real_files_by_actfast(real_data: Path, name: str) -> None:
    assert check(real_data / "vendor" / name, by_actfast) == REAL[name][0]


@pytest.mark.nightly
@pytest.mark.parametrize("name", sorted(set(REAL) - {"geneactiv_85hz_1min.bin"}))
def test_real_files_by_skdh(real_data: Path, name: str) -> None:
    """Without the file that ends within a page, at which skdh gives up."""
    assert check(real_data / "vendor" / name, by_skdh) == REAL[name][0]


@pytest.mark.parametrize("oracle", [by_actfast, pytest.param(by_skdh, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("ending", [b"\n", b"\r\n"])
def test_files_made_by_hand(tmp_path: Path, oracle: Oracle, ending: bytes) -> None:
    head = header(gain=(25522, 25457, 24829), offset=(272, -1129, 101), pages=20)
    path = written(tmp_path / "a.bin", pages(random_counts(6000)), head, ending)
    assert check(path, oracle) == 6000


@pytest.mark.parametrize("oracle", [by_actfast, pytest.param(by_skdh, marks=pytest.mark.nightly)])
def test_files_of_the_independent_generator(real_data: Path, tmp_path: Path, oracle: Oracle) -> None:
    tool = real_data.parent / "tools" / "make_recording.py"
    if not tool.exists():
        pytest.skip("the independent generator is absent")
    command = [sys.executable, str(tool), "--days", "0.05", "--bin", "--out", str(tmp_path / "made")]
    subprocess.run(command, check=True, capture_output=True)
    assert check(tmp_path / "made.bin", oracle) == 432_000
    counts = joined(list(opened(tmp_path / "made.bin").chunks(100_000)), "counts")
    assert (counts == np.load(tmp_path / "made.i16.npy")).all()
