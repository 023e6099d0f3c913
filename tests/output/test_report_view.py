"""The typed view of a report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from accelcal_cli.core.declared import as_json
from accelcal_cli.core.results import Outcome
from accelcal_cli.output.sections import report_view
from tests.device_recordings import donor

Object = dict[str, Any]


def test_a_report_is_read_with_its_numbers(tmp_path: Path) -> None:
    report = json.loads(donor(tmp_path, warm=True).read_text())
    view = report_view(report)
    assert view.outcome is Outcome.CALIBRATED and view.holdout is not None and view.calibration is not None
    assert view.holdout.after_mg.mean == report["holdout"]["after_mg"]["mean"]
    assert view.calibration.parameters == report["calibration"]["parameters"]
    assert [trial.model for trial in view.models_tried] == [one["model"] for one in report["models_tried"]]
    assert as_json(view.recording) == report["recording"]
    assert view.setting("max_error_mg", 1.0) == report["settings"]["max_error_mg"]
    assert view.setting("profile", 1.0) == view.setting("no such", 1.0) == 1.0
