"""`study.csv` while a study runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.pipeline.jobs import Request
from accelcal_cli.studies import run as running
from accelcal_cli.studies.discovery import Where
from accelcal_cli.studies.study import Study
from tests.cli.studies import NAMES, csv_rows, study_folder


class Looks:
    """Observes a study, and how many rows its table has whenever a recording is done."""

    def __init__(self, out: Path) -> None:
        self.out, self.seen = out, [0]

    def begin(self, items: Any) -> None: ...

    def advance(self, bytes_done: float) -> None: ...

    def note(self, text: str) -> None: ...

    def found(self, line: str, *, new: bool) -> None: ...

    def stopped(self, done: int) -> None: ...

    def finished(self, item: Any, result: Any) -> None:
        if (self.out / "study.csv").exists():
            self.seen.append(len(csv_rows(self.out)))


@pytest.mark.parametrize("earlier", [False, True])
def test_it_holds_what_is_done_and_of_the_rest_what_was_found_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, earlier: bool
) -> None:
    monkeypatch.setattr(running, "TABLE_S", 0.0)
    monkeypatch.setattr(running, "TABLE_TIMES", 0.0)
    folder, out = study_folder(tmp_path / "in", NAMES), tmp_path / "out"
    if earlier:
        running.run(Study(Where((folder,), out), Request(), jobs=1), Looks(out))
    looks = Looks(out)
    running.run(Study(Where((folder,), out), Request(integers=True), jobs=1), looks)
    assert looks.seen == ([0, 3, 3, 3] if earlier else [0, 1, 2])
    assert len(csv_rows(out)) == 3
