"""The study of public recordings in docs/study.md, with the files that stand there."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

from tests.cli.run import run
from tests.cli.studies import rows

DOCUMENT = Path(__file__).parent.parent.parent / "docs/study.md"


def test_public_recordings_are_one_study(
    real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = re.findall(r"```toml\n(.*?)```", DOCUMENT.read_text("utf-8"), re.DOTALL)
    for name, mark in (("study.toml", "nilspod_*.bin"), ("nilspod.toml", "[dump]")):
        (text,) = (block for block in blocks if mark in block)
        (tmp_path / name).write_text(text)
    config = ("--config", tmp_path / "study.toml")
    folders = (real_data / "vendor", real_data / "imu", "-d", tmp_path / "out")
    ran = run(capsys, "study", *folders, *config, "--report-only")
    found = rows(tmp_path / "out")
    assert Counter(row["outcome"] for row in found) == {"calibrated": 11, "refused": 18}
    assert "no file fits" not in ran.err
    named = "29 public recordings", "11 are calibrated, and 18 are refused"
    assert all(words in DOCUMENT.read_text("utf-8") for words in named)
