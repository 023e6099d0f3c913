"""F's gradient descent in single precision (Farago, Maczak, Gingl 2024, section II.C)."""

from __future__ import annotations

import numpy as np

from accelcal_cli.optimize._float import gradient_descent

OPTIMIZER = gradient_descent("single", np.float32, smallest_step=2.0**-23)
DEFAULT, PAPER, fit = OPTIMIZER.settings["default"], OPTIMIZER.settings["paper"], OPTIMIZER.fit
