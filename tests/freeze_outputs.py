"""Freezes the outputs of this version: `python -m tests.freeze_outputs`, by hand and never by a test.

`test_frozen_outputs.py` reads each folder of OUTPUTS, with every later version. That of a version that is not
released yet (`1.0.0.dev`) is made again when the form of the outputs was changed on purpose.
"""

from __future__ import annotations

import contextlib
import platform
import shutil
import sys
from pathlib import Path

from accelcal_cli.core.version import STATED
from tests.cli.run import exit_code
from tests.device_recordings import week

OUTPUTS = Path(__file__).parent / "data" / "outputs"
CURRENT = OUTPUTS / STATED.removesuffix("0") if STATED.endswith(".dev0") else OUTPUTS / STATED
"""Folder of this version."""

DECISIONS = "recording,use,note,who,when\nb.raw,no,worn by somebody else,Ada,2026-11-02\n"


def main() -> None:
    """Make the folder of this version: recordings in `in`, the study of them in `out`, and a registry."""
    if CURRENT.exists() and not CURRENT.name.endswith(".dev"):
        sys.exit(f"{CURRENT} is of a release, and stays as it is")
    shutil.rmtree(CURRENT, ignore_errors=True)
    (CURRENT / "in").mkdir(parents=True)
    (CURRENT / "out").mkdir()
    for seed, (name, poses) in enumerate({"a.raw": 8, "b.raw": 7, "short.raw": 1}.items()):
        week(CURRENT / "in" / name, seed, poses=poses, warm=True)
    (CURRENT / "out" / "decisions.csv").write_text(DECISIONS)
    here = {str(CURRENT): "/recordings", f'"host": "{platform.node()}"': '"host": "computer"'}
    with contextlib.chdir(CURRENT):
        exit_code("study", "in", "-d", "out", "-j", "1", "-q")
        (CURRENT / "out" / "study.ledger").unlink()  # it is about the times of files
        for report in (CURRENT / "out").glob("*.json"):
            text = report.read_text("utf-8")
            for found, said in here.items():
                text = text.replace(found, said)
            report.write_text(text, "utf-8")
        exit_code("devices", "out", "--registry", "registry.json", "-q")


if __name__ == "__main__":
    main()
