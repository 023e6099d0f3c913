"""What is known of a simulated recording, and how far a calibration is from it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.points import Calibration
from accelcal_cli.pipeline.plan import stem

TRUTH_SUFFIX = ".truth.json"


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """True parameters: a = K (v + o + s (T - Tref)).

    Attributes:
        gain: K, (3, 3).
        offset_g: o, (3,) at the reference temperature.
        reference_c: Tref.
    """

    gain: NDArray[np.float64]
    offset_g: NDArray[np.float64]
    reference_c: float


def truth_beside(recording: Path) -> Truth | None:
    """The content of STEM.truth.json beside a recording, None where there is no such file.

    Either as `accelcal simulate` writes it, or with the keys `K` and `b` (and `temp_ref_c`) of
    a = K (v - b - s (T - Tref)).

    Raises:
        UnreadableError: the file holds something else.
    """
    path = recording.with_name(stem(recording) + TRUTH_SUFFIX)
    if not path.is_file():
        return None
    try:
        return _truth(json.loads(path.read_text("utf-8")))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UnreadableError(
            f"does not hold the truth of a simulated recording ({error})",
            path=path,
            hint="move it away, or write it anew with accelcal simulate",
        ) from error


def _truth(known: dict[str, Any]) -> Truth:
    if "sensor" in known:
        sensor = known["sensor"]
        return _checked(sensor["gain"], sensor["offset_g"], sensor["reference_c"])
    return _checked(known["K"], [-value for value in known["b"]], known.get("temp_ref_c", 0.0))


def _checked(gain: Any, offset_g: Any, reference_c: Any) -> Truth:
    found = Truth(np.array(gain, np.float64), np.array(offset_g, np.float64), float(reference_c))
    if found.gain.shape != (3, 3) or found.offset_g.shape != (3,):
        raise ValueError("K is not 3 x 3, or o not three numbers")
    return found


@dataclass(frozen=True, slots=True)
class TrueErrors:
    """The largest error of an entry of K, and of an offset [mg] at the truth's reference temperature."""

    gain: float
    offset_mg: float


def true_errors(found: Calibration, truth: Truth) -> TrueErrors:
    """How far a calibration is from the truth."""
    offset_g = found.offset_g() + found.slope_g_per_c() * (truth.reference_c - found.reference_c())
    return TrueErrors(
        float(np.abs(found.gain() - truth.gain).max()),
        float(np.abs(offset_g - truth.offset_g).max() * 1000),
    )
