"""Simulated sessions of a sensor z = K a + O + noise, made without the package."""

from __future__ import annotations

from pathlib import Path

import numpy as np

RATE_HZ = 50.0
LSB_PER_G = 1024.0
K = np.array([[1.02, -0.013, 0.008], [0.021, 0.985, -0.017], [-0.009, 0.014, 1.005]])
O = np.array([0.035, -0.06, 0.045])  # noqa: E741
UP = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}
START = "2024-03-04T08:00:00"


def turned(vector: tuple[float, ...], degrees: float, axis: int = 2) -> np.ndarray:
    """A vector tilted about one of the axes x, y, z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    first, second = [other for other in range(3) if other != axis]
    out = np.array(vector, float)
    out[first], out[second] = (c * vector[first] - s * vector[second], s * vector[first] + c * vector[second])
    return out


def sensed(a: np.ndarray, seed: int, noise_g: float = 0.002) -> np.ndarray:
    """What the sensor shows of accelerations (n, 3), in g."""
    return a @ K.T + O + noise_g * np.random.default_rng(seed).standard_normal(a.shape)


def moved(seconds: float, seed: int) -> np.ndarray:
    """The device in the hand: anything but still."""
    rng = np.random.default_rng(seed)
    return rng.normal(0, 0.5, (round(seconds * RATE_HZ), 3)) + np.array([0, 0, 0.5])


def session(
    poses: list[object], seconds: float = 10.0, hand_s: float = 3.0, seed: int = 1, noise_g: float = 0.002
) -> np.ndarray:
    """Raw values (n, 3) in g: the hand, then each pose (a face's name or a vector) and the hand again."""
    parts = [moved(hand_s, seed)]
    for index, pose in enumerate(poses):
        held = np.tile(
            np.array(UP[pose] if isinstance(pose, str) else pose, float), (round(seconds * RATE_HZ), 1)
        )
        parts += [held, moved(hand_s, 100 * seed + index)]
    return sensed(np.concatenate(parts), seed, noise_g)


def write_csv(path: Path, raw_g: np.ndarray, factor: float = 1.0) -> Path:
    """time,x,y,z from START on, in g (times a factor)."""
    steps = np.round(np.arange(len(raw_g)) * 1e6 / RATE_HZ).astype("timedelta64[us]")
    times = np.datetime64(START, "us") + steps
    rows = (
        f"{t},{x:.9f},{y:.9f},{z:.9f}" for t, (x, y, z) in zip(times, (raw_g * factor).tolist(), strict=True)
    )
    path.write_text("time,x,y,z\n" + "\n".join(rows) + "\n")
    return path


def six_faces(folder: Path, name: str = "session.csv", seed: int = 1, **more: float) -> Path:
    """A good session."""
    return write_csv(folder / name, session(list(UP), seed=seed, **more))


def start_s(index: int, seconds: float = 10.0, hand_s: float = 3.0) -> float:
    """When the pose of this index begins in a session."""
    return hand_s + index * (seconds + hand_s)


def write_list(path: Path, lines: list[str], header: str = "start,end,ax,ay,az") -> Path:
    """A list of poses."""
    path.write_text("\n".join([header, *lines]) + "\n")
    return path
