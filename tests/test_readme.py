"""The README: short, every command and block of Python runs, and its figures are those that come."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.cli.main import COMMANDS
from tests.cli.run import run

ROOT = Path(__file__).resolve().parent.parent
Capture = pytest.CaptureFixture[str]
README = (ROOT / "README.md").read_text("utf-8")


def test_it_is_short_and_names_every_command() -> None:
    assert len(README.splitlines()) <= 160
    assert [name for name in COMMANDS if f"`accelcal {name}`" not in README] == []


def test_links_lead_to_files_and_headings() -> None:
    for target in re.findall(r"\]\((?!https?:)([^)]+)\)", README):
        path, _, anchor = target.partition("#")
        page = ROOT / path if path else ROOT / "README.md"
        assert page.exists(), target
        if anchor:
            heads = re.findall(r"^#+ (.*)$", page.read_text("utf-8"), re.MULTILINE)
            slugs = [re.sub(r"[^\w\- ]", "", head.strip().lower()).replace(" ", "-") for head in heads]
            assert anchor in slugs, target


def test_every_command_and_block_of_python_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    shutil.copytree(ROOT / "sample_data", tmp_path / "sample_data")
    for made in (tmp_path / "sample_data").glob("*.cal*"):
        made.unlink()
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"^```(console|python)\n(.*?)^```", README, re.MULTILINE | re.DOTALL)
    assert len(blocks) >= 6
    names: dict[str, Any] = {}
    for kind, block in blocks:
        if kind == "python":
            exec(compile(block, "README.md", "exec"), names)
            continue
        for line in block.splitlines():
            assert line.startswith("$ accelcal "), line
            assert run(capsys, *line.removeprefix("$ accelcal ").split()).code == 0, line
    named = set(re.findall(r"^\| `(recording\.[a-z.]+)` \|", README, re.MULTILINE))
    assert named <= {path.name for path in (tmp_path / "sample_data").iterdir()} and len(named) == 4
    report = json.loads((tmp_path / "sample_data/recording.calibration.json").read_text("utf-8"))
    error, (low, high) = report["calibration_error_mg"], report["calibration_error_mg"]["ci95"]
    assert f"it is {error['mean']:.2g} m*g* (95 % interval {low:.2g} to {high:.2g} m*g*)" in README
    assert f"was {error['before']:.2g} m*g* before" in README
    assert f"{report['holdout']['after_mg']['mean']:.2g} m*g* here" in README
