"""`accelcal report` where the disk does not give what a page is made of."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import pytest

from tests.cli.run import assert_one_line, exit_code, run
from tests.recordings import directions, still_counts, write_raw


@pytest.mark.parametrize("end", ["calibration.json", "quality.json"])
def test_no_page_is_made_of_a_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end: str) -> None:
    write_raw(tmp_path / "a.raw", still_counts(directions(20)))
    exit_code("calibrate", tmp_path / "a.raw", "--report-only", "-q")
    plain = Path.open

    def fails(path: Path, *words: Any, **more: Any) -> Any:
        if path.name == f"a.{end}":
            raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))
        return plain(path, *words, **more)

    monkeypatch.setattr(Path, "open", fails)
    ran = run("report", tmp_path / "a.calibration.json")
    assert_one_line(ran, f"a.{end}: cannot be read (Input/output error)", code=3)
    assert not (tmp_path / "a.html").exists()
