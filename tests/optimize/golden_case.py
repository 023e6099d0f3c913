"""A small fixed case: 18 hand-picked points, two in each of F's nine subsets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import TemperatureScale
from accelcal_cli.core.points import MODELS, WEIGHT_ONE, PointSet
from accelcal_cli.optimize import fixed32

GOLDEN = Path(__file__).parent / "golden_fixed32.json"

COUNTS = (
    (-248, 10, 31), (-239, -60, 18), (12, 180, 185), (-20, -186, 178), (262, 22, -14), (255, -41, 52),
    (75, -241, 30), (-90, -228, -44), (171, 9, 190), (-185, -12, -160), (30, 257, 61), (-66, 250, -22),
    (103, -71, -221), (-44, 88, -229), (190, 176, 8), (-178, 174, -15), (58, 62, 245), (-101, 39, 232),
)  # fmt: skip
"""Raw counts of a sensor with 256 counts per g."""


def case(*, warm: bool) -> PointSet:
    """The points, with made-up temperatures where wanted."""
    number = len(COUNTS)
    tau = (np.arange(number, dtype=np.int64) * 7 % number - 9) * (ONE // 8) if warm else None
    scale = TemperatureScale(30_000, 4.0) if warm else None
    weights = np.full(number, WEIGHT_ONE, np.int64)
    return PointSet(np.array(COUNTS, np.int64) * (ONE // 256), weights, np.ones(number, np.int64), tau, scale)


def results() -> dict[str, Any]:
    """Integers of each profile and model; the paper's run with every tenth iteration."""
    found: dict[str, Any] = {}
    for profile, model in (
        ("paper", "9"),
        ("paper", "6"),
        ("default", "3"),
        ("default", "6"),
        ("default", "9"),
        ("default", "9T"),
    ):
        numbers = replace(fixed32.OPTIMIZER.settings[profile], keep_history=True)
        fit = fixed32.fit(case(warm=model.endswith("T")), MODELS[model], numbers)
        found[f"{profile} {model}"] = {
            "parameters": list(fit.parameters),
            "iterations": fit.iterations,
            "stop": fit.stop,
            "every_tenth": [list(row) for row in fit.history[::10]],
        }
    return found
