"""The study of public recordings in docs/study.md, with the files that stand there."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

from tests.cli.run import run
from tests.cli.studies import rows

DOCUMENT = Path(__file__).parent.parent.parent / "docs/study.md"


@pytest.fixture
def words(real_data: Path, tmp_path: Path) -> tuple[object, ...]:
    """The command, with its files in a folder."""
    blocks = re.findall(r"```toml\n(.*?)```", DOCUMENT.read_text("utf-8"), re.DOTALL)
    for name, mark in (("study.toml", "nilspod_*.bin"), ("nilspod.toml", "[dump]")):
        (text,) = (block for block in blocks if mark in block)
        (tmp_path / name).write_text(text)
    folders = (real_data / "vendor", real_data / "imu", "-d", tmp_path / "out")
    return ("study", *folders, "--config", tmp_path / "study.toml", "--report-only")


def test_its_files_concern_all_recordings(words: tuple[object, ...]) -> None:
    ran = run(*words, "--dry-run")
    assert (ran.code, len(ran.lines)) == (0, 29)
    assert "no file fits" not in ran.err


@pytest.mark.nightly
def test_public_recordings_are_one_study(words: tuple[object, ...], tmp_path: Path) -> None:
    ran = run(*words)
    found = rows(tmp_path / "out")
    assert Counter(row["outcome"] for row in found) == {"calibrated": 13, "provisional": 4, "refused": 12}
    assert "no file fits" not in ran.err
    named = "29 public recordings", "13 are calibrated, 4 provisional and 12 refused"
    assert all(words in DOCUMENT.read_text("utf-8") for words in named)
