"""Empatica E4: `ACC.csv`, whose first two lines are its start and its rate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from tests.formats.make_csv import read, written

HEADER = "1496443804.500000, 1496443804.500000, 1496443804.500000\n32.000000, 32.000000, 32.000000\n"
VALUES = [[-5, 69, 13 + row] for row in range(12)]
ROWS = "".join(f"{x},{y},{z}\n" for x, y, z in VALUES)
START_US = 1_496_443_804_500_000

SAMPLE = (HEADER + ROWS).encode()


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_two_lines_tell_start_and_rate(tmp_path: Path, end: str) -> None:
    found = read(written(tmp_path, (HEADER + ROWS).replace("\n", end), "ACC.csv"))
    assert found.counts.tolist() == VALUES
    assert found.times.tolist() == [START_US + row * 31_250 for row in range(12)]
    about = found.recording
    assert (about.rate_hz, about.lsb_per_g, about.range_g) == (32.0, 64.0, 2.0)
    assert (about.start_us, about.timezone, about.device.model) == (START_US, "UTC", "Empatica E4")
    assert found.problems == []


def test_epoch_seconds_are_utc_and_contradict_another_zone(tmp_path: Path) -> None:
    path = written(tmp_path, HEADER + ROWS)
    assert read(path).recording.timezone == "UTC"
    with pytest.raises(UsageError, match="states its time zone, UTC, which is not Europe/Berlin"):
        read(path, timezone="Europe/Berlin")


def test_what_the_user_says_counts_more_than_the_layout(tmp_path: Path) -> None:
    path = written(tmp_path, HEADER + ROWS)
    assert read(path, unit="counts", lsb_per_g=60.0).recording.lsb_per_g == 60.0
    with pytest.raises(UsageError, match="made at 32 Hz, not 64"):
        read(path, rate_hz=64.0)


@pytest.mark.parametrize("rows", ["-5,69,13\n-4.5,68,16\n-9,62,15\n", "-5,69,13\n1,2,3\n" * 9 + "0.5,64,1\n"])
def test_fractions_of_counts_are_refused(tmp_path: Path, rows: str) -> None:
    with pytest.raises(UnreadableError, match="is not a whole number of counts"):
        read(written(tmp_path, HEADER + rows))


def test_another_scale_is_doubted(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match=r"16 g, so that its unit is in doubt; give --unit"):
        read(written(tmp_path, HEADER + "0,0,1024\n" * 9))


@pytest.mark.parametrize(
    "header",
    [
        HEADER.splitlines()[0] + "\n",
        HEADER.replace("32.000000, 32.000000, 32", "32.000000, 32.000000, 31"),
        HEADER.replace("32.000000", "0.000000"),
        HEADER.replace("32.000000", "nan"),
        HEADER.replace("1496443804", "496443804"),
        HEADER.replace("1496443804.500000, ", "", 1),
    ],
)
def test_a_head_that_is_not_quite_so_is_no_e4s(tmp_path: Path, header: str) -> None:
    with pytest.raises(UnreadableError, match=r"--unit|--columns|--rate"):
        read(written(tmp_path, header + ROWS))


def test_real_recording(real_data: Path) -> None:
    path = real_data / "vendor" / "empatica_e4_32hz_2h.csv"
    found = read(path, 20_000)
    truth = pd.read_csv(path, skiprows=2, header=None).to_numpy()
    assert np.array_equal(found.counts, truth)
    assert found.times[0] == found.recording.start_us == 1_496_443_804_000_000
    assert found.times[-1] == 1_496_443_804_000_000 + (len(truth) - 1) * 31_250
    assert found.problems == []
