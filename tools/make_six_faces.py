"""Remake sample_data/six_faces.csv.gz: a simulated session on six faces, and the truth about it.

z = K a + O + noise (Bragge et al., eq. 1) at 50 Hz, rounded to 1024 counts per g: every face for 8 s, put
down with a tilt of about 0.1 degree, with the hand in between.
"""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).resolve().parent.parent / "sample_data"
RATE_HZ = 50
LSB_PER_G = 1024
START = "2024-03-04T08:00:00"
K = np.array([[1.014, -0.012, 0.007], [0.018, 0.982, -0.015], [-0.009, 0.011, 1.006]])
OFFSET_G = np.array([0.032, -0.051, 0.044])
FACES = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
FACE_S, HAND_S = 8, 3
TILT_RAD = 0.002
NOISE_G = 0.003


def main() -> None:
    """Write the recording and its truth."""
    rng = np.random.default_rng(21)
    parts = [_hand(rng)]
    for face in FACES:
        placed = np.array(face) + TILT_RAD * rng.standard_normal(3) * (1 - np.abs(face))
        parts += [np.tile(placed / np.linalg.norm(placed), (FACE_S * RATE_HZ, 1)), _hand(rng)]
    a = np.concatenate(parts)
    z = a @ K.T + OFFSET_G + NOISE_G * rng.standard_normal(a.shape)
    _write(np.rint(z * LSB_PER_G) / LSB_PER_G)
    truth = {"equation": "z = K a + O", "K": K.tolist(), "O": OFFSET_G.tolist(), "noise_g": NOISE_G}
    (FOLDER / "six_faces.truth.json").write_text(json.dumps(truth, indent=2) + "\n")


def _hand(rng: np.random.Generator) -> np.ndarray:
    """Three seconds of being taken up and turned."""
    time = np.arange(HAND_S * RATE_HZ)[:, None] / RATE_HZ
    turns = rng.uniform(0.5, 2.0, 3)
    return np.sin(2 * np.pi * (turns * time + rng.uniform(0, 1, 3))) + 0.1 * rng.standard_normal(
        (len(time), 3)
    )


def _write(z: np.ndarray) -> None:
    steps = (np.arange(len(z)) * 1_000_000 // RATE_HZ).astype("timedelta64[us]")
    times = np.datetime_as_string(np.datetime64(START, "us") + steps, unit="ms")
    rows = [f"{time},{x:.6f},{y:.6f},{z:.6f}" for time, (x, y, z) in zip(times, z.tolist(), strict=True)]
    text = "time,x,y,z\n" + "\n".join(rows) + "\n"
    with (
        (FOLDER / "six_faces.csv.gz").open("wb") as file,
        gzip.GzipFile("", "wb", 9, file, mtime=0) as packed,
    ):
        packed.write(text.encode())


if __name__ == "__main__":
    main()
