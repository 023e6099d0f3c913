"""F's gradient descent in double precision (Farago, Maczak, Gingl 2024, section II.C)."""

from __future__ import annotations

import numpy as np

from accelcal_cli.optimize._float import gradient_descent

OPTIMIZER = gradient_descent("double", np.float64, smallest_step=2.0**-30)
DEFAULT, PAPER, fit = OPTIMIZER.settings["default"], OPTIMIZER.settings["paper"], OPTIMIZER.fit
