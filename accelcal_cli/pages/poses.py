"""What a recording's page says of known orientations: the poses, and rolls with one axis level."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from accelcal_cli.output import advice
from accelcal_cli.pages.rendering import Rows, Table
from accelcal_cli.pages.svg import number

Report = Mapping[str, Any]

MOST_ROWS = 200
"""The report has the others."""


@dataclass(frozen=True, slots=True)
class KnownOrientations:
    """The part of the page; caution: that nothing was held out, None where something was."""

    caution: str | None
    poses: Table
    rolls: Table | None


def poses_of(report: Report) -> KnownOrientations | None:
    """The part of the page; None for a report without known orientations."""
    known = report.get("known_orientations")
    if not known or "poses" not in report:
        return None
    return KnownOrientations(advice.unchecked_poses(report), _poses(report["poses"]), _rolls(known))


def _poses(poses: list[dict[str, Any]]) -> Table:
    rows: Rows = [
        [
            one["face"],
            _where(one),
            ", ".join(number(value) for value in one["reference_g"]),
            *(number(one[name]) for name in ("raw_mg", "residual_mg", "held_out_mg", "repeat_mg")),
        ]
        for one in poses[:MOST_ROWS]
    ]
    more = f"; {len(poses) - MOST_ROWS} more are in the report" if len(poses) > MOST_ROWS else ""
    head = ["Pose", "Where", "True acceleration [g]", "Raw error [mg]", "Residual of the fit [mg]",
            "Held-out error [mg]", "From the mean of its orientation [mg]"]  # fmt: skip
    return Table(f"Poses, and the errors of their vectors{more}", head, rows, (0, 1, 2))


def _rolls(known: Mapping[str, Any]) -> Table | None:
    rows: Rows = [
        [one["axis"], _where(one), *(_level(one["level_mg"][when]) for when in ("before", "after"))]
        for one in known.get("rolls") or ()
    ]
    head = ["Axis", "Where", "Shows [mg] (SD)", "Calibrated [mg] (SD)"]
    return Table("Rolls with one axis level, which should show nothing", head, rows, (0, 1)) if rows else None


def _where(one: Mapping[str, Any]) -> str:
    times = f"{one['start_s']:.0f} to {one['end_s']:.0f} s"
    return f"{one['file']}, {times}" if "file" in one else times


def _level(level: Mapping[str, Any] | None) -> str:
    return "–" if level is None else f"{number(level['mean'])} ({number(level['sd'])})"
