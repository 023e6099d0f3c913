"""Real ActiGraph recordings, sample by sample against other readers and the vendor's own export."""

from __future__ import annotations

import gzip
import logging
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.recording import Validity
from tests.formats.gt3x.reading import Whole, opened, whole

NEWER = [
    "gt3x_ism_disabled",
    "gt3x_ism_enabled",
    "gt3x_link_100hz_36min",
    "gt3x_link_30hz_14h",
    "gt3x_link_30hz_3h",
    "gt3x_waist_30hz_30min",
]
DOCKED_S = 1_568_747_740
"""Second after which gt3x_link_100hz_36min was connected to a computer and recorded nothing."""


@dataclass(frozen=True)
class Fact:
    """What a plain count of the records says: rows, rows asleep, breaks."""

    samples: int
    filled: int
    breaks: int


FACTS = {
    "gt3x_ism_disabled": Fact(300 * 30, 0, 0),
    "gt3x_ism_enabled": Fact(300 * 30, 227 * 30, 0),
    "gt3x_link_100hz_36min": Fact(2152 * 100, 1822 * 100, 1),
    "gt3x_link_30hz_14h": Fact(48_927 * 30, 21_918 * 30, 0),
    "gt3x_link_30hz_3h": Fact(11_283 * 30, 8139 * 30, 0),
    "gt3x_waist_30hz_30min": Fact(1768 * 30, 1180 * 30, 0),
    "gt3x_old_neo_30hz_10min": Fact(18_004, 0, 0),
}


def read(real_data: Path, name: str) -> Whole:
    return whole(real_data / "vendor" / f"{name}.gt3x", 50_000)


def half_away(values: np.ndarray) -> np.ndarray:
    """Three decimals as the vendor rounds them."""
    return np.copysign(np.floor(np.abs(values) * 1000 + 0.5) / 1000, values)


@pytest.mark.parametrize("name", FACTS)
def test_rows_sleep_and_gaps(real_data: Path, name: str) -> None:
    found = read(real_data, name)
    asleep = int((found.validity == Validity.FILLED).sum())
    assert Fact(len(found.counts), asleep, len(found.breaks)) == FACTS[name]
    assert {code for code, *_ in found.found} == ({"clock_gap"} if found.breaks else set())
    assert (np.diff(found.times) > 0).all()


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.nightly] * name.endswith("14h")) for name in NEWER]
)
def test_every_sample_time_and_sleep_is_that_of_pygt3x(real_data: Path, name: str) -> None:
    reader = pytest.importorskip("pygt3x.reader")
    found = read(real_data, name)
    with reader.FileReader(str(real_data / "vendor" / f"{name}.gt3x")) as other:
        theirs = other.acceleration
    assert (found.counts == theirs[:, 1:4]).all()
    assert np.abs(found.times - 1e6 * theirs[:, 0]).max() <= 1
    assert ((found.validity == Validity.FILLED) == (theirs[:, 4] == 1)).all()


def test_every_sample_of_the_older_kind_is_that_of_pygt3x(real_data: Path) -> None:
    reader = pytest.importorskip("pygt3x.reader")
    path = real_data / "vendor" / "gt3x_old_neo_30hz_10min.gt3x"
    with reader.FileReader(str(path)) as other:
        theirs = other.acceleration[:, 1:4]
    assert (np.round(whole(path).counts / opened(path).recording.lsb_per_g, 3) == theirs).all()


def test_every_measured_sample_is_that_of_actfast(real_data: Path) -> None:
    actfast = pytest.importorskip("actfast")
    found = read(real_data, "gt3x_waist_30hz_30min")
    theirs = actfast.read(str(real_data / "vendor" / "gt3x_waist_30hz_30min.gt3x"))["timeseries"][
        "acceleration"
    ]
    awake = found.validity == Validity.MEASURED
    assert (found.counts[awake] == 256 * theirs["acceleration"]).all()
    assert np.abs(found.times[awake] - theirs["datetime"] / 1000).max() <= 1


def test_every_sample_is_that_of_the_vendors_export(real_data: Path) -> None:
    """The export has zeros where nothing was recorded, and one more second of repetition before."""
    found = read(real_data, "gt3x_link_100hz_36min")
    with gzip.open(real_data / "vendor" / "gt3x_link_100hz_36min.actilife.csv.gz", "rt") as file:
        theirs = np.loadtxt(file, delimiter=",", skiprows=11)
    start = int(found.times[0]) // 1_000_000
    row = (found.times - start * 1_000_000) // 10_000
    assert (half_away(found.counts / 256) == theirs[row]).all()
    left = np.delete(np.arange(len(theirs)), row)
    seconds = start + left // 100
    assert np.unique(seconds).tolist()[:7] == list(range(DOCKED_S, DOCKED_S + 7))
    assert (theirs[left][seconds == DOCKED_S] == theirs[(DOCKED_S - start) * 100 - 1]).all()
    assert not theirs[left][seconds > DOCKED_S].any()


def test_headers(real_data: Path) -> None:
    night = opened(real_data / "vendor" / "gt3x_link_30hz_14h.gt3x").recording
    assert (night.device.model, night.device.serial, night.device.firmware) == (
        "Link",
        "TAS1F06180456",
        "1.7.1",
    )
    assert (night.timezone, night.rate_hz, night.lsb_per_g, night.range_g) == ("UTC", 30, 256, 8)
    old = opened(real_data / "vendor" / "gt3x_old_neo_30hz_10min.gt3x").recording
    assert (old.device.model, old.timezone, old.lsb_per_g, old.range_g) == ("GT3XPlus", "-06:00", 341, 6)
    assert old.start_us == 1_640_001_300_000_000


@pytest.mark.parametrize("name", FACTS)
def test_the_chunk_size_changes_nothing(real_data: Path, name: str) -> None:
    found = read(real_data, name)
    assert found.same_as(whole(real_data / "vendor" / f"{name}.gt3x", 4999))


@pytest.fixture(scope="module")
def generated(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    tool = real_data.parent / "tools" / "make_recording.py"
    if not tool.exists():
        pytest.skip("the independent generator is absent")
    out = tmp_path_factory.mktemp("generated") / "short"
    words = ("--days", "0.04", "--out", str(out), "--gt3x", "--seed", "7")
    subprocess.run([sys.executable, str(tool), *words], check=True, capture_output=True)
    return out


@pytest.mark.parametrize("kind", ["", pytest.param("_act2", marks=pytest.mark.nightly)])
def test_every_sample_of_an_independent_generator(generated: Path, kind: str) -> None:
    truth = np.load(f"{generated}.i16.npy")
    path = Path(f"{generated}{kind}.gt3x")
    found = whole(path, 30_000)
    assert (found.counts == truth).all()
    assert (found.breaks, found.found, found.validity.any()) == ([], [], False)
    assert (np.diff(found.times) == 10_000).all()
    actfast = pytest.importorskip("actfast")
    reader = pytest.importorskip("pygt3x.reader")
    logging.getLogger("pygt3x").setLevel(logging.ERROR)
    with reader.FileReader(str(path)) as other:
        assert (other.acceleration[:, 1:4] == truth).all()
    theirs = actfast.read(str(path))["timeseries"]["acceleration"]["acceleration"]
    assert len(theirs) == (0 if kind else len(truth))
    assert kind or (256 * theirs == truth).all()
