"""The paragraph for a methods section: what it says of each kind of report, and the works that it cites."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.output.methods import bibtex, methods_paragraph, references
from accelcal_cli.output.sections import report_view
from tests.cli.run import exit_code
from tests.device_recordings import week

FACES = Path(__file__).parents[2] / "sample_data" / "six_faces.csv.gz"


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("warm")
    week(folder / "warm.raw", warm=True)
    assert exit_code("calibrate", folder / "warm.raw", "--report-only", "-q") == 0
    return json.loads((folder / "warm.calibration.json").read_text())


def test_every_symbol_and_width_is_given(warm: dict[str, Any]) -> None:
    view = report_view(warm)
    text = methods_paragraph(view)
    symbols = (
        "v is the raw acceleration, a the calibrated one, K a 3 × 3 matrix, o the offsets",
        "Tref, and s",
    )
    for part in (*symbols, "0.018 for scale, 0.013 for misalignment, 35 mg for offsets, 1 mg/°C for slopes"):
        assert part in text
    assert (
        "Faragó" in references(view) and "van Hees" in references(view) and "Bragge" not in references(view)
    )
    assert [line.split("{")[0] for line in bibtex(view).splitlines() if line.startswith("@")] == [
        "@software", "@article", "@article",
    ]  # fmt: skip


def test_a_session_cites_the_method_of_known_orientations(tmp_path: Path) -> None:
    assert exit_code("six-pose", FACES, "-d", tmp_path, "-q") == 0
    view = report_view(json.loads((tmp_path / "six_faces.calibration.json").read_text()))
    assert references(view).startswith("Bragge et al.") and references(view).endswith("simultaneously")
    assert "@misc{bragge," in bibtex(view) and "vanhees" not in bibtex(view)
    assert "slopes" not in methods_paragraph(view)


def test_coefficients_of_another_recording_were_not_fitted(warm: dict[str, Any]) -> None:
    text = methods_paragraph(report_view(warm | {"outcome": "borrowed"}))
    assert "by the coefficients of another recording" in text
    assert "fitted" not in text and "still windows" not in text


def test_raw_values_that_are_good_are_said_to_be_used(warm: dict[str, Any]) -> None:
    good = warm | {"outcome": "already_good", "calibration": warm["calibration"] | {"model": "0"}}
    text = methods_paragraph(report_view(good))
    assert "used as they are" in text and "no correction" not in text
