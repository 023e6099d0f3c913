"""What a sensor with known errors measures at rest, as points and as a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np

GAIN = np.array([[1.03, 0, 0], [0.012, 0.98, 0], [-0.008, 0.009, 1.015]])
OFFSET = np.array([0.03, -0.025, 0.045])


def directions(number: int) -> np.ndarray:
    """Points (n, 3) that a sensor with GAIN and OFFSET measures at rest."""
    random = np.random.RandomState(1)
    truth = random.standard_normal((number, 3))
    truth /= np.linalg.norm(truth, axis=1)[:, None]
    raw: np.ndarray = np.linalg.solve(GAIN, truth.T).T - OFFSET
    return raw + 0.001 * random.standard_normal(raw.shape)


def recording(path: Path) -> Path:
    rows = np.repeat(directions(40), 12 * 20, axis=0)
    rows += 0.003 * np.random.RandomState(2).standard_normal(rows.shape)
    lines = [f"{k / 20:.2f},{x:.5f},{y:.5f},{z:.5f}" for k, (x, y, z) in enumerate(rows.tolist())]
    path.write_text("\n".join(["t,x [g],y [g],z [g]", *lines]) + "\n")
    return path
