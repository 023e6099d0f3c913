"""`accelcal evaluate homogeneity`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import exit_codes, options
from accelcal_cli.cli.options import Positive
from accelcal_cli.cli.output import aligned, figure, number, progress_bars, refuse_both
from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.evaluate.homogeneity import AXES, Compared, Homogeneity, Likeness, homogeneity
from accelcal_cli.output.files import csv_text
from accelcal_cli.pipeline import given
from accelcal_cli.pipeline.jobs import Request

NORM = AXES.index("norm")
HEAD = ("lag s", "drift ppm", "residual ms", "correlation")
FIGURES = tuple(f"{axis}_{when}_mg" for axis in AXES for when in ("before", "after"))


@click.command("homogeneity")
@click.argument("recordings", nargs=-1, required=True, type=options.FILE)
@click.option("--largest-lag", "largest_lag_s", type=Positive(), default=60.0, show_default=True,
              metavar="SECONDS", help="How far the devices' clocks may be apart.")  # fmt: skip
@click.option("--accept", "accept_mg", type=Positive(), metavar="MG",
              help="Exit with code 1 if one is refused, or its calibrated |a| deviates by more.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object.")
@click.option("--csv", "as_csv", is_flag=True, help="Print a CSV table.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@options.reading_options
@options.parts_option
@options.method_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Show how alike RECORDINGs are of devices that were moved together, raw and calibrated.

    Their clocks are brought together by cross-correlation. Then each is compared with the mean of all, in
    means of a second: root mean square of the deviations of x, y, z and |a|, before and after calibration.
    Devices have to be fixed to each other, with their axes in the same directions; |a| alone does not ask
    for that.
    """
    refuse_both(as_json=values["as_json"], as_csv=values["as_csv"])
    if len(recordings) < 2:
        raise UsageError("one recording has nothing to be compared with", hint="give two or more")
    request = Request(
        options=given.read_options(values),
        settings=given.settings(values),
        chunk_samples=values["chunk_samples"],
        parts=values["parts"],
    )
    with progress_bars("homogeneity", quiet=values["quiet"]) as bars:
        found = homogeneity(recordings, request, values["largest_lag_s"], bars)
    exit_codes.show(_shown(found, values))
    return exit_codes.OK if accepted(found, values["accept_mg"]) else exit_codes.SOME_FAILED


def accepted(found: Homogeneity, limit_mg: float | None) -> bool:
    """Whether all devices are as alike as is asked for."""
    return limit_mg is None or all(_within(one, limit_mg) for one in found.recordings)


def _within(one: Compared, limit_mg: float) -> bool:
    return one.likeness is not None and one.likeness.rms_mg()[1][NORM] <= limit_mg


def _shown(found: Homogeneity, values: dict[str, Any]) -> str:
    limit_mg = values["accept_mg"]
    if values["as_json"]:
        shown = asdict(found) | {"recordings": [_as_json(one, limit_mg) for one in found.recordings]}
        shown["together"] = _likeness_json(found.together)
        return json.dumps(shown)
    if values["as_csv"]:
        head = (
            "recording",
            "serial",
            "outcome",
            "lag_s",
            "drift_ppm",
            "residual_ms",
            "correlation",
            *FIGURES,
        )
        return csv_text(head, [_csv_row(one) for one in found.recordings]).rstrip("\n")
    return printable(_text(found, limit_mg), kept="\n")


def _as_json(one: Compared, limit_mg: float | None) -> dict[str, Any]:
    return {
        "recording": printable(one.path),
        "serial": one.serial,
        "outcome": one.outcome,
        "message": one.message,
        "clock": None if one.clock is None else asdict(one.clock),
        "likeness": None if one.likeness is None else _likeness_json(one.likeness),
        "accepted": None if limit_mg is None else _within(one, limit_mg),
    }


def _likeness_json(likeness: Likeness) -> dict[str, Any]:
    """Mean squares [g2] and their roots [mg], by axis."""
    squares = zip(("before", "after"), (likeness.before, likeness.after), likeness.rms_mg(), strict=True)
    return {
        when: {"mean_square_g2": dict(zip(AXES, g2, strict=True)), "rms_mg": dict(zip(AXES, mg, strict=True))}
        for when, g2, mg in squares
    }


def _csv_row(one: Compared) -> list[object]:
    clock, likeness = one.clock, one.likeness
    row: list[object] = [printable(one.path), one.serial, one.outcome]
    if clock is None or likeness is None:
        return row + [None] * (4 + len(FIGURES))
    values = [value for pair in zip(*likeness.rms_mg(), strict=True) for value in pair]
    return [*row, clock.lag_s, clock.drift_ppm, clock.residual_ms, clock.correlation, *values]


def _text(found: Homogeneity, limit_mg: float | None) -> str:
    """A row for each device, and one for all; figures in mg, before > after."""
    head = ["", *HEAD, *AXES[:NORM], "|a|", *(["accepted"] if limit_mg is not None else [])]
    rows = []
    for one in found.recordings:
        name = one.path.name if one.serial is None else f"{one.path.name} ({one.serial})"
        rows.append([name, *_clock(one), *_pairs(one.likeness), *_verdict(one, limit_mg)])
    last = ["all", *["-"] * len(HEAD), *_pairs(found.together)]
    rows.append([*last, *([""] if limit_mg is not None else [])])
    before, after = (rms[NORM] for rms in found.together.rms_mg())
    times = f"{before / after:.1f} times smaller" if after else "nothing"
    return "\n".join(
        [
            f"{len(found.recordings)} recordings, {found.seconds} s in common. Root mean square deviation "
            "from their mean, before > after calibration [mg]:",
            aligned(head, rows),
            f"|a| after calibration: {times}",
            *(f"{one.path}: refused: {one.message}" for one in found.recordings if one.likeness is None),
        ]
    )


def _clock(one: Compared) -> list[str]:
    clock = one.clock
    if clock is None:
        return ["-"] * len(HEAD)
    shown = ((clock.lag_s, "+.3f"), (clock.drift_ppm, "+.1f"), (clock.residual_ms, ".1f"))
    return [*(number(value, form) for value, form in shown), number(clock.correlation, ".3f")]


def _pairs(likeness: Likeness | None) -> list[str]:
    if likeness is None:
        return ["-"] * len(AXES)
    return [f"{figure(before)} > {figure(after)}" for before, after in zip(*likeness.rms_mg(), strict=True)]


def _verdict(one: Compared, limit_mg: float | None) -> list[str]:
    return [] if limit_mg is None else ["yes" if _within(one, limit_mg) else "no"]
