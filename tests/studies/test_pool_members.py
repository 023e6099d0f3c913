"""What a pool does to each of its recordings, and which of them it leaves out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.cli.run import nightly
from tests.cli.studies import rows
from tests.device_recordings import rest, write_device
from tests.recordings import RATE_HZ, directions
from tests.studies.borrowing import own_errors_mg, report
from tests.studies.pooling import pool_of, study


def perfect() -> np.ndarray:
    """A sensor without errors that rests in five poses, three of them different."""
    poses = np.repeat(np.eye(3)[[0, 1, 2, 0, 1]], 750, axis=0)
    return poses + 0.003 * np.random.RandomState(1).randn(*poses.shape)


def test_the_errors_on_its_own_windows_are_those_of_an_independent_calculation(tmp_path: Path) -> None:
    """One of three recordings has half the rate, which a pool does not mind."""
    (tmp_path / "in").mkdir()
    rates_hz = (RATE_HZ, RATE_HZ, RATE_HZ / 2)
    values, _ = rest(directions(24), seed=5)
    for number in range(3):
        at = slice(number * 8 * 750, (number + 1) * 8 * 750)
        write_device(tmp_path / f"in/{number}.raw", values[at])
    layout = tmp_path / "in/2.layout.toml"
    layout.write_text(layout.read_text().replace(f"rate_hz = {rates_hz[0]}", f"rate_hz = {rates_hz[2]}"))
    assert study(tmp_path).code == 0
    for number, row in enumerate(rows(tmp_path / "out")):
        assert float(row["rate_hz"]) == rates_hz[number]
        found = report(tmp_path / "out", str(number))
        before, after, postures = own_errors_mg(
            tmp_path / f"in/{number}.raw", found["calibration"], rates_hz[number]
        )
        own = found["pool"]["own_windows"]
        assert own["before_mg"]["mean"] == pytest.approx(before, abs=1e-4)
        assert own["after_mg"]["mean"] == pytest.approx(after, abs=1e-4)
        assert own["postures"] == postures
        assert float(row["windows_after_mg"]) == own["after_mg"]["mean"]
        assert (row["own_outcome"], row["pool_recordings"]) == ("refused", "3")


@pytest.mark.parametrize("prior", [nightly("none"), "population"])
def test_a_recording_that_contradicts_the_others_is_left_out(tmp_path: Path, prior: str) -> None:
    """A perfect sensor with the serial of another: each would put 30 mg of error on the other."""
    (tmp_path / "in").mkdir()
    values, _ = rest(directions(120), seed=5)
    for number in range(3):
        write_device(tmp_path / f"in/{number}.raw", values[number * 40 * 750 : (number + 1) * 40 * 750])
    write_device(tmp_path / "in/swapped.raw", perfect())
    assert study(tmp_path, "--prior", prior).code == 1
    made = pool_of(tmp_path / "out")
    (odd,) = made["pool"]["left_out"]
    assert odd["path"] == "in/swapped.raw"
    assert [one["path"] for one in made["pool"]["recordings"]] == [f"in/{n}.raw" for n in range(3)]
    row = rows(tmp_path / "out")[3]
    assert (row["path"], row["outcome"], row["pool"]) == ("swapped.raw", "refused", "")
    own = report(tmp_path / "out", "swapped")["message"]
    assert odd["reason"] == "worse_than_usual" and row["cautions"].split()[-1] == "not_pooled"
    assert row["message"].startswith(f"{own} Not pooled: it was left out of the pool: ")
    assert study(tmp_path, "--prior", prior, "--exclude", "swapped*", out="without").code == 0
    assert pool_of(tmp_path / "without")["calibration"] == made["calibration"]


@pytest.mark.nightly
def test_two_that_contradict_each_other_are_no_pool(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    write_device(tmp_path / "in/a.raw", rest(directions(120))[0])
    write_device(tmp_path / "in/b.raw", perfect())
    assert "not pooled: The recordings of the pool contradict each other" in study(tmp_path).err
    assert [row["outcome"] for row in rows(tmp_path / "out")] == ["calibrated", "refused"]


def test_a_members_report_is_not_taken_for_a_pools(tmp_path: Path) -> None:
    """It has a section `pool`, too, and here the name of one; pools that are gone are removed."""
    (tmp_path / "in").mkdir()
    values, _ = rest(directions(24), seed=5)
    for number, name in enumerate(("study.pool.one", "two", "three")):
        write_device(tmp_path / f"in/{name}.raw", values[number * 8 * 750 : (number + 1) * 8 * 750])
    (tmp_path / "out").mkdir()
    gone = tmp_path / "out/study.pool.B2-00000000.calibration.json"
    assert study(tmp_path).code == 0
    gone.write_bytes(next((tmp_path / "out").glob("study.pool.A1-*")).read_bytes())
    assert "3 unchanged" in study(tmp_path).err
    assert not gone.exists()
    assert report(tmp_path / "out", "study.pool.one")["pool"]["serial"] == "A1"
