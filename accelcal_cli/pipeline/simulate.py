"""Writing a simulated recording and the truth about it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import OutputError, UsageError
from accelcal_cli.core.formats import Sampling
from accelcal_cli.core.recording import Chunk
from accelcal_cli.core.version import __version__
from accelcal_cli.formats import all_encoders, named_encoder
from accelcal_cli.output.files import replacing, write_text
from accelcal_cli.pipeline.jobs import Progress, refuse_nameless
from accelcal_cli.simulate import Plan, Truth, describe, stream


def simulate(
    out: Path, format_name: str, plan: Plan, *, force: bool, progress: Progress
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
    plan = _as_sampled(plan, encoder.sampling(describe(plan, out, format_name)))
    refuse_nameless(out)
    base = out.parent / (out.name.removesuffix(encoder.suffix) or out.name)
    path = base.with_name(base.name + encoder.suffix)
    truth_path = base.with_name(base.name + ".truth.json")
    companion = None if encoder.companion is None else base.with_name(base.name + encoder.companion.suffix)
    for target in (path, truth_path, companion):
        if target is not None and target.exists() and not force:
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


def _as_sampled(plan: Plan, sampling: Sampling) -> Plan:
    plan = replace(plan, rate_hz=sampling.rate_hz, unit_samples=sampling.unit_samples)
    if plan.samples < 1:
        raise UsageError("nothing to simulate", hint="raise --days")
    return plan


def _counted(chunks: Iterator[Chunk], progress: Progress) -> Iterator[Chunk]:
    for chunk in chunks:
        yield chunk
        progress(chunk.first_sample + len(chunk))


def _truth_json(plan: Plan, truth: Truth, format_name: str) -> dict[str, Any]:
    return {
        "accelcal_version": __version__,
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
