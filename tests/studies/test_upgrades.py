"""After an upgrade, or with another option: why `studies/rounds.py` makes results again, and their change."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.version import __version__
from accelcal_cli.studies.rounds import distance_mg
from tests.cli.run import Ran, run
from tests.cli.studies import change_ledger, study_folder


def study(folder: Path, *words: object) -> Ran:
    return run("study", folder, "-d", folder.parent / "out", "-j", 1, "--report-only", *words)


def as_if_made_by(out: Path, version: str) -> None:
    """Let the ledger and the summary say that another version made them, with coefficients a bit off."""

    def change(entry: dict[str, Any]) -> None:
        if entry["row"]:
            entry["asked"] = "0" * 16
            entry["row"] |= {"accelcal_version": version, "offset_x_g": entry["row"]["offset_x_g"] + 0.004}

    change_ledger(out, change)
    about = json.loads((out / "study.json").read_text())
    (out / "study.json").write_text(json.dumps(about | {"accelcal_version": version}))


def test_u7_an_upgrade_says_what_is_made_again_and_how_it_changed(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in", ("a.raw", "b.raw")), tmp_path / "out"
    assert all(line.endswith("\ttodo") for line in study(folder, "--dry-run").lines)
    assert study(folder).code == 0
    as_if_made_by(out, "0.0.9")
    assert all(line.endswith("\ttodo (made by 0.0.9)") for line in study(folder, "--dry-run").lines)
    objects = [json.loads(line) for line in study(folder, "--dry-run", "--json").lines]
    assert [one["why"] for one in objects if one["state"] == "todo"] == ["made by 0.0.9"] * 2
    ran = study(folder)
    assert "2 results to be made again (made by 0.0.9)\n" in ran.err
    found = re.search(
        rf"2 results made again by {re.escape(__version__)}, 0 with another outcome; (.*)", ran.err
    )
    assert found is not None and re.match(r"coefficients changed by [34]\.\d+ mg", found[1]), ran.err
    assert "made again" not in study(folder).err


def test_with_other_options_too_both_are_said(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in", ("a.raw", "b.raw")), tmp_path / "out"
    assert study(folder).code == 0
    as_if_made_by(out, "0.0.9")
    ran = study(folder, "--no-temperature")
    assert "2 results to be made again (made by 0.0.9, --no-temperature)\n" in ran.err


def test_results_of_a_development_version_are_named_and_made_again(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in", ("a.raw", "b.raw")), tmp_path / "out"
    assert study(folder).code == 0
    table = (out / "study.csv").read_bytes()
    without_identity(out, "0.3.0")
    ran = study(folder)
    text = "was made by a development version (0.3.0) of accelcal; its recordings are calibrated again"
    assert ran.code == 0 and f"study.json: {text}" in ran.err and "2 calibrated" in ran.err, ran.err
    assert (out / "study.csv").read_bytes() == table


def without_identity(out: Path, version: str) -> None:
    """Let the files of a study say what those of development versions did."""
    for path in (*out.glob("*.json"), out / "study.ledger"):
        text = path.read_text().replace(f'"{__version__}"', f'"{version}"')
        path.write_text(re.sub(r'"kind": "(study|report|quality|ledger)",', "", text))


def test_u7_an_option_is_named_that_makes_results_again(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in", ("a.raw", "b.raw"))
    assert study(folder).code == 0
    shown = study(folder, "--no-temperature", "--dry-run")
    assert all(line.endswith("\ttodo (--no-temperature)") for line in shown.lines), shown.out
    (folder / "a.raw").write_bytes((folder / "b.raw").read_bytes())
    assert study(folder, "--dry-run").lines[0].endswith("\ttodo (changed)")


def test_the_distance_of_two_calibrations_is_that_over_the_sphere() -> None:
    random = np.random.RandomState(1)
    gains = [np.eye(3) + 0.01 * random.randn(3, 3) for _ in "ab"]
    offsets = [0.01 * random.randn(3) for _ in "ab"]
    table = [
        {f"k_{'xyz'[i]}{'xyz'[j]}": gain[i, j] for i in range(3) for j in range(3)}
        | {f"offset_{axis}_g": offset[i] for i, axis in enumerate("xyz")}
        for gain, offset in zip(gains, offsets, strict=True)
    ]
    directions = random.randn(200_000, 3)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    raw = directions @ np.linalg.inv(gains[0]).T - offsets[0]
    apart = (raw + offsets[1]) @ gains[1].T - directions
    assert distance_mg(*table) == pytest.approx(1000 * np.sqrt((apart**2).sum(axis=1).mean()), rel=0.01)
    assert distance_mg(table[0], {}) is None
