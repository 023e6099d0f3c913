"""A few damaged copies of every format's small file; `make fuzz` reads many more."""

from __future__ import annotations

from pathlib import Path

import pytest

from accelcal_cli.core.formats import Format
from accelcal_cli.formats import all_formats
from tests.formats import fuzz


@pytest.mark.parametrize("item", all_formats(), ids=lambda item: item.name)
def test_damaged_files_give_rows_or_errors_of_ours(
    item: Format, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fuzz, "FAILURES", tmp_path / "failures")
    monkeypatch.setattr(fuzz, "SECONDS", 20.0)
    assert fuzz.fuzz(item, fuzz.MUTANTS, 1, tmp_path) == []
