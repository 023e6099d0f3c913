"""Studies in which the recordings of a device are calibrated as one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tests.cli.run import Ran
from tests.cli.studies import study_in


def study(here: Path, *words: object, out: str = "out", pool: bool = True, jobs: int = 2) -> Ran:
    """Without a prior, so that few postures are not enough; tests may give `--prior` again."""
    more = ["--prior", "none", *(["--pool", "device"] if pool else [])]
    return study_in(here, *more, *words, out=out, jobs=jobs)


def pool_of(out: Path) -> dict[str, Any]:
    (path,) = out.glob("study.pool.A1-*.calibration.json")
    return json.loads(path.read_text())
