"""activPAL: days as spreadsheets count them, and counts whose zero lies in the middle."""

from __future__ import annotations

from pathlib import Path

import pytest

from accelcal_cli.core.errors import UnreadableError
from tests.formats.make_csv import START_US, read, written

HEADER = "sep=;\nTime;Index;X;Y;Z\n"
START_DAYS = 45_355.0
"""2024-03-04 in a spreadsheet: `=DATE(2024;3;4)`."""

VALUES = [[127, 64, 190 - row] for row in range(12)]
TEN_BITS = [[513, 386 + row, 640] for row in range(12)]


def rows(values: list[list[int]], skip: int = 1) -> str:
    lines = [
        f"{START_DAYS + row * skip / 20 / 86_400:.12f};{row * skip};{x};{y};{z}\n"
        for row, (x, y, z) in enumerate(values)
    ]
    return "".join(lines)


SAMPLE = (HEADER + rows(VALUES)).encode()


@pytest.mark.parametrize("header", [HEADER, HEADER[6:], '"Time";"Sample index";"X";"Y";"Z"\n'])
def test_eight_bits_have_63_counts_in_a_g_around_127(tmp_path: Path, header: str) -> None:
    found = read(written(tmp_path, header + rows(VALUES)))
    assert found.counts.tolist() == [[x - 127, y - 127, z - 127] for x, y, z in VALUES]
    assert found.counts[0].tolist() == [0, -63, 63]
    assert abs(found.times - [START_US + row * 50_000 for row in range(12)]).max() <= 10
    about = found.recording
    assert (about.lsb_per_g, about.range_g, about.rate_hz) == (63.0, 2.0, 20.0)
    assert about.device.model == "activPAL3"
    assert about.notes[0] == "an export of activPAL"


def test_ten_bits_are_told_by_the_values(tmp_path: Path) -> None:
    found = read(written(tmp_path, HEADER + rows(TEN_BITS)))
    assert found.counts.tolist() == [[0, row - 127, 127] for row in range(12)]
    about = found.recording
    assert (about.lsb_per_g, about.range_g, about.device.model) == (127.375, 4.0, "activPAL4")


def test_the_scale_that_the_user_states_keeps_the_zero(tmp_path: Path) -> None:
    found = read(written(tmp_path, HEADER + rows(VALUES)), unit="counts", lsb_per_g=64.0)
    assert found.counts[0].tolist() == [0, -63, 63]
    assert found.recording.lsb_per_g == 64.0


def test_other_counts_are_doubted(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match="its unit is in doubt"):
        read(written(tmp_path, HEADER + rows([[127, 127, 131]] * 12)))
