"""F's gradient descent in double precision (Farago, Maczak, Gingl 2024, section II.C)."""

from __future__ import annotations

import numpy as np

from accelcal_cli.core.points import Fit, Model, Optimizer, PointSet
from accelcal_cli.optimize._float import PAPER, Settings, descend

DEFAULT = Settings(max_iterations=20_000, smallest_step=2.0**-30)
"""A step below half the last bit of the result rounds to nothing."""


def fit(points: PointSet, model: Model, settings: Settings = DEFAULT) -> Fit:
    """Fit the free parameters of a model.

    Raises:
        DivergedError: the descent overflows or does not converge.
    """
    return descend(points, model, settings, np.float64)


OPTIMIZER = Optimizer(
    name="float64",
    title="gradient descent in double precision (Farago, Maczak, Gingl 2024)",
    fit=fit,
    settings={"default": DEFAULT, "paper": PAPER},
)
