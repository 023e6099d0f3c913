"""An archive of several people's recordings is none of a laboratory's: only --parts joins recordings."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import open_recording
from tests.cli.run import run
from tests.formats.make_cwa import sectors, written

COMMANDS = ["calibrate", "inspect", "evaluate methods", "evaluate stillness",
            "evaluate segments", "evaluate smoothing", "evaluate duration"]  # fmt: skip


def archive(folder: Path, *names: str) -> Path:
    """A zip around recordings of these names."""
    counts = np.tile(np.array([0, 0, 256], "<i2"), (800, 1))
    with zipfile.ZipFile(folder / "two.zip", "w") as packed:
        for number, name in enumerate(names):
            pages = sectors(counts, time_us=1_709_510_400_000_000 + number * 3_600_000_000)
            packed.write(written(folder / "one.cwa", pages), name)
    return folder / "two.zip"


@pytest.mark.parametrize("words", COMMANDS)
def test_only_parts_joins_the_recordings_of_an_archive(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: str
) -> None:
    path = archive(tmp_path, "anna.cwa", "ben.cwa")
    ran = run(capsys, *words.split(), path)
    assert ran.code != 0
    assert "holds 2 recordings (anna.cwa and ben.cwa)" in ran.err
    assert "calibrate each; with --parts they are parts of one" in ran.err


def test_one_recording_of_an_archive_is_read(tmp_path: Path) -> None:
    with open_recording(archive(tmp_path, "anna.cwa"), ReadOptions()) as reader:
        assert sum(map(len, reader.chunks(500))) == 800
    with pytest.raises(UnreadableError, match="holds 2 recordings"):
        open_recording(archive(tmp_path, "anna.cwa", "ben.cwa"), ReadOptions())
    with open_recording(archive(tmp_path, "anna.cwa", "ben.cwa"), ReadOptions(), joined=True) as reader:
        assert sum(map(len, reader.chunks(500))) == 1600
