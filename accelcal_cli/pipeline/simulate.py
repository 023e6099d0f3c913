"""Writes a simulated recording and the truth about it, and reads that truth again."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.door import is_file, is_there
from accelcal_cli.core.errors import OutputError, UnreadableError, UsageError
from accelcal_cli.core.identity import identity
from accelcal_cli.core.recording import Chunk
from accelcal_cli.formats import all_encoders, named_encoder
from accelcal_cli.output.files import parsed, replacing, write_text
from accelcal_cli.pipeline.jobs import Progress, refuse_nameless, stem
from accelcal_cli.simulate import (
    SimulatedSensor,
    SimulationPlan,
    Truth,
    describe,
    draw_gain_and_offset,
    draw_gyroscope,
    stream,
)

TRUTH_SUFFIX = ".truth.json"
SLOPE, NO_SLOPE = "temp_slope_g_per_c", (0.0, 0.0, 0.0)


def plan_of(values: dict[str, Any]) -> SimulationPlan:
    """Return the plan of the options of `simulate`; raises UsageError if they do not go together."""
    if values["range_g"] * values["lsb_per_g"] > 32_768:
        raise UsageError("--range-g times --lsb-per-g does not fit in 16 bits", hint="reduce one of them")
    truth = values["seed"] if values["truth"] is None else values["truth"]
    gain, offset = draw_gain_and_offset(truth, values["errors"], values["misalignment"])
    sensor = SimulatedSensor(
        gain=gain,
        offset_g=offset,
        slope_g_per_c=np.array(values["temp_slope"]) / 1000,
        noise_g=values["noise_mg"] / 1000,
        lsb_per_g=values["lsb_per_g"],
        range_g=values["range_g"],
    )
    slope = np.array(values["gyro_temp_slope"])
    if slope.any() and not values["gyro"]:
        raise UsageError("--gyro-temp-slope is of a gyroscope", hint="add --gyro")
    gyroscope = draw_gyroscope(truth, values["errors"], slope) if values["gyro"] else None
    warm = not values["no_temperature"]
    return SimulationPlan(
        values["days"], values["rate_hz"], values["seed"], sensor, warm, gyroscope=gyroscope
    )


def simulate(
    out: Path, format_name: str, plan: SimulationPlan, *, force: bool, progress: Progress
) -> tuple[Path, dict[str, Any]]:
    """Write OUT with the format's suffix, its companion if it needs one, and OUT.truth.json.

    Returns:
        the recording's path and the truth.

    Raises:
        UsageError: the format has no writer, or none for such a rate, scale or length; OUT has no name.
        OutputError: a file exists already and `force` is not given, or cannot be written.
    """
    encoder = named_encoder(format_name)
    if plan.gyroscope is not None and not encoder.gyroscope:
        others = ", ".join(one.name for one in all_encoders() if one.gyroscope)
        raise UsageError(f"{format_name} is not written with a gyroscope", hint=f"use one of {others}")
    sampling = encoder.sampling(describe(plan, out, format_name))
    plan = replace(plan, rate_hz=sampling.rate_hz, unit_samples=sampling.unit_samples)
    if plan.samples < 1:
        raise UsageError("nothing to simulate", hint="raise --days")
    refuse_nameless(out)
    base = out.parent / (out.name.removesuffix(encoder.suffix) or out.name)
    path = base.with_name(base.name + encoder.suffix)
    truth_path = base.with_name(base.name + TRUTH_SUFFIX)
    companion = None if encoder.companion is None else base.with_name(base.name + encoder.companion.suffix)
    for target in (path, truth_path, companion):
        if target is not None and is_there(target) and not force:
            raise OutputError("exists already", path=target, hint="use --force to replace it")
    truth = Truth()
    recording = describe(plan, path, format_name)
    with replacing(path) as temporary:
        encoder.write(temporary, recording, _counted(stream(plan, truth), progress))
    if encoder.companion is not None and companion is not None:
        write_text(companion, encoder.companion.text(recording))
    truth_json = _truth_json(plan, truth, format_name)
    write_text(truth_path, json.dumps(truth_json, indent=2) + "\n")
    return path, truth_json


def _counted(chunks: Iterator[Chunk], progress: Progress) -> Iterator[Chunk]:
    for chunk in chunks:
        yield chunk
        progress(chunk.first_sample + len(chunk))


def _truth_json(plan: SimulationPlan, truth: Truth, format_name: str) -> dict[str, Any]:
    return {
        **identity("truth"),
        "format": format_name,
        "days": plan.days,
        "rate_hz": plan.rate_hz,
        "seed": plan.seed,
        "samples": plan.samples,
        "equation": "a = K (v + o + s (T - Tref))",
        "sensor": plan.sensor.as_json(),
        **({} if plan.gyroscope is None else {"gyroscope": plan.gyroscope.as_json()}),
        "still": truth.as_json(),
    }


@dataclass(frozen=True, slots=True, eq=False)
class TrueParameters:
    """True parameters: a = K (v + o + s (T - Tref)).

    Attributes:
        gain: K, (3, 3).
        offset_g: o, (3,) at the reference temperature.
        reference_c: Tref.
        slope_g_per_c: s, (3,).
    """

    gain: NDArray[np.float64]
    offset_g: NDArray[np.float64]
    reference_c: float
    slope_g_per_c: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))


def true_parameters(recording: Path) -> TrueParameters | None:
    """Return the content of STEM.truth.json next to a recording; None if there is no such file.

    The file is as `accelcal simulate` writes it, or has the keys `K` and `b` (and `temp_ref_c`) of
    a = K (v - b - s (T - Tref)).

    Raises:
        UnreadableError: the file holds something else.
    """
    path = recording.with_name(stem(recording) + TRUTH_SUFFIX)
    if not is_file(path):
        return None
    try:
        known = parsed(path.read_text("utf-8"))
        if "sensor" in known:
            sensor = known["sensor"]
            slope = sensor.get("slope_g_per_c", NO_SLOPE)
            return _checked(sensor["gain"], sensor["offset_g"], sensor["reference_c"], slope)
        offset, slope = ([-value for value in values] for values in (known["b"], known.get(SLOPE, NO_SLOPE)))
        return _checked(known["K"], offset, known.get("temp_ref_c", 0.0), slope)
    except (OSError, ValueError, KeyError, TypeError) as error:
        text = f"does not hold the truth of a simulated recording ({error})"
        hint = "move it away, or write it again with accelcal simulate"
        raise UnreadableError(text, path=path, hint=hint) from error


def _checked(gain: Any, offset_g: Any, reference_c: Any, slope_g_per_c: Any) -> TrueParameters:
    k, offset, slope = (np.array(value, np.float64) for value in (gain, offset_g, slope_g_per_c))
    truth = TrueParameters(k, offset, float(reference_c), slope)
    if truth.gain.shape != (3, 3) or not truth.offset_g.shape == truth.slope_g_per_c.shape == (3,):
        raise ValueError("K is not 3 x 3, or o or s not three numbers")
    return truth
