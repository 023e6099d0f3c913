"""Small recordings for tests of the whole chain, made without the package's encoders."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

RATE_HZ = 25.0
LSB_PER_G = 256.0
GAIN = np.array([[1.02, 0.0, 0.0], [0.012, 0.985, 0.0], [-0.008, 0.006, 1.01]])
OFFSET_G = np.array([0.03, -0.02, 0.045])
SECONDS = 30
START = "2024-03-04T00:00:00"


def directions(number: int) -> np.ndarray:
    """Evenly spread unit vectors (a golden spiral), shuffled."""
    index = np.arange(number) + 0.5
    z = 1 - 2 * index / number
    turn = np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - z * z)
    spread = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)
    return spread[np.random.RandomState(5).permutation(number)]


def still_counts(poses: np.ndarray, seed: int = 1, noise_g: float = 0.003) -> np.ndarray:
    """Counts (n, 3) int16 of a sensor with known errors that rests SECONDS in each pose."""
    raw = poses @ np.linalg.inv(GAIN).T - OFFSET_G
    held = np.repeat(raw, round(SECONDS * RATE_HZ), axis=0)
    held = held + noise_g * np.random.RandomState(seed).randn(*held.shape)
    return np.clip(np.rint(held * LSB_PER_G), -2048, 2047).astype(np.int16)


def write_csv(path: Path, counts: np.ndarray, rate_hz: float = RATE_HZ) -> Path:
    """time,x,y,z in g; times from 2024-03-04 on."""
    path.write_bytes(_csv(counts.tobytes(), counts.dtype, rate_hz))
    return path


@lru_cache(8)
def _csv(raw: bytes, kind: np.dtype, rate_hz: float) -> bytes:
    counts = np.frombuffer(raw, kind).reshape(-1, 3)
    names, places = np.unique(counts, return_inverse=True)
    decimals = np.array([str(value) for value in (names / LSB_PER_G).tolist()], object)
    columns = decimals[places.reshape(counts.shape)].T.tolist()
    rows = map(",".join, zip(_times(len(counts), rate_hz), *columns, strict=True))
    return ("time,x,y,z\n" + "\n".join(rows) + "\n").encode()


@lru_cache(8)
def _times(number: int, rate_hz: float) -> list[str]:
    steps = np.round(np.arange(number) * 1e6 / rate_hz).astype("timedelta64[us]")
    return np.datetime_as_string(np.datetime64(START, "us") + steps).tolist()


def good_csv(folder: Path, name: str = "good.csv") -> Path:
    """A recording that can be calibrated: 60 poses."""
    return write_csv(folder / name, still_counts(directions(60)))


def good_raw(folder: Path, name: str = "good.raw") -> Path:
    """The same as a headerless dump, which is read sooner."""
    return write_raw(folder / name, still_counts(directions(60)))


def paper_recording(folder: Path, name: str = "paper.raw") -> Path:
    """Enough postures for both sets of profile paper, and more than a MiB long."""
    return write_raw(folder / name, still_counts(np.concatenate([directions(200), directions(120)])))


def write_raw(path: Path, counts: np.ndarray) -> Path:
    """A headerless dump with its layout file beside it."""
    path.write_bytes(counts.astype("<i2").tobytes())
    path.with_name(path.stem + ".layout.toml").write_text(
        f"[dump]\nrate_hz = {RATE_HZ}\nlsb_per_g = {LSB_PER_G}\nrange_g = 8.0\nstart_time = '{START}'\n"
        "[fields]\n"
        + "".join(
            f"{axis} = {{ offset = {2 * index}, type = 'int16' }}\n" for index, axis in enumerate("xyz")
        )
    )
    return path


def straightened(calibration: dict, raw_g: np.ndarray) -> np.ndarray:
    """v + q v^2 by a report's calibration."""
    bend = calibration["bend"]
    return raw_g if bend is None else raw_g + np.array(bend["quadratic"]) * raw_g**2


def worst_errors(report: dict) -> tuple[float, float]:
    """Largest error of a gain term, and of an offset in g, of a report's calibration."""
    gain = np.abs(np.array(report["calibration"]["gain"]) - GAIN).max()
    offset = np.abs(np.array(report["calibration"]["offset_g"]) - OFFSET_G).max()
    return float(gain), float(offset)
