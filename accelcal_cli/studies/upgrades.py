"""Why earlier results are made again, as after an upgrade, and by how much coefficients changed by that."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from statistics import median
from typing import Any

import numpy as np

from accelcal_cli.core.errors import OutputError, UnreadableError, counted
from accelcal_cli.core.identity import STUDY, refuse_other
from accelcal_cli.core.settings import Settings, setting_of
from accelcal_cli.core.version import __version__
from accelcal_cli.output.numbers import mg
from accelcal_cli.output.report_reading import load_our_json
from accelcal_cli.studies.records import Entry, Item
from accelcal_cli.studies.study import Study

AXES = "xyz"
OTHER_OPTIONS = "other options"


def said_last(study: Study, notes: list[str]) -> dict[str, Any]:
    """Return what `study.json` says of the last run; empty if that is not known.

    Args:
        notes: receives a line if it is of a version whose results this one does not read.
    """
    path = study.out / f"{study.shard.basename}.json"
    try:
        if (held := load_our_json(path)) is not None:
            refuse_other(held, STUDY, path)
            return held
    except OutputError:
        pass
    except UnreadableError as error:
        error.hint = "its recordings are calibrated again"
        notes.append(str(error))
    return {}


def options_changed(study: Study, last: Mapping[str, Any]) -> list[str]:
    """Return the options whose values differ between the last run and this one, as far as both know them.

    Args:
        last: what `said_last` found.
    """
    before = last.get("settings")
    if not isinstance(before, dict) or not before:
        return [OTHER_OPTIONS]
    now = json.loads(json.dumps(study.settings(), default=str))
    names = [name for name in now.keys() & before.keys() if name != "prior" and now[name] != before[name]]
    return sorted(map(_option, names))


def _option(name: str) -> str:
    if name in Settings.__dataclass_fields__ and (option := setting_of(Settings, name).option) is not None:
        return option.name
    return f"--{name.replace('_', '-')}" if name != "input" else "how recordings are read"


def why_again(last: Entry | None, item: Item, asked: str, options: list[str]) -> str:
    """Return why a recording is calibrated again: `made by 1.0.0`; empty for a new one.

    Args:
        last: its latest own result.
        asked: hash of the settings and the version now.
        options: what `options_changed` found.
    """
    if last is None or last.row is None:
        return ""
    if last.stamps != item.stamps:
        return "changed"
    version = last.row.get("accelcal_version")
    if version != __version__:
        return ", ".join([f"made by {version}", *(one for one in options if one != OTHER_OPTIONS)])
    if last.asked != asked:
        return " ".join(options) or OTHER_OPTIONS
    return "failed before" if last.failed or last.again else "an output is missing"


def said_before(why: Mapping[str, str]) -> list[str]:
    """Return a line for each reason why several results are made again: another version, or other options."""
    reasons = Counter(one for one in why.values() if one.startswith(("made by", "--", OTHER_OPTIONS)))
    return [
        f"{counted(number, 'result')} to be made again ({one})" for one, number in sorted(reasons.items())
    ]


def said_after(before: Mapping[str, Mapping[str, Any]], after: Mapping[str, Mapping[str, Any]]) -> str | None:
    """Return a line on how results changed that were made again; None if there are none.

    Args:
        before, after: rows of the table by name.
    """
    both = [(name, before[name], after[name]) for name in before if name in after]
    if not both:
        return None
    sizes = {name: size for name, old, new in both if (size := distance_mg(old, new)) is not None}
    other = sum(old.get("outcome") != new.get("outcome") for _, old, new in both)
    text = f"{counted(len(both), 'result')} made again by {__version__}, {other} with another outcome"
    if not sizes:
        return text
    most = max(sizes, key=lambda name: sizes[name])
    middle = median(sizes.values())
    return f"{text}; coefficients changed by {mg(middle)} mg (median), {mg(sizes[most])} mg at most ({most})"


def distance_mg(old: Mapping[str, Any], new: Mapping[str, Any]) -> float | None:
    """Return how far two calibrations of a sensor differ, over all orientations at rest (RMS)."""
    pairs = [_equation(row) for row in (old, new)]
    if pairs[0] is None or pairs[1] is None:
        return None
    (gain, offset), (other, shifted) = pairs[0], pairs[1]
    try:
        turned = other @ np.linalg.inv(gain) - np.eye(3)
    except np.linalg.LinAlgError:
        return None
    moved = other @ (shifted - offset)
    return 1000 * float(np.sqrt((turned**2).sum() / 3 + moved @ moved))


def _equation(row: Mapping[str, Any]) -> tuple[Any, Any] | None:
    """Return gain and offset [g] of a row; None without a calibration."""
    gain = [[row.get(f"k_{one}{other}") for other in AXES] for one in AXES]
    offset = [row.get(f"offset_{axis}_g") for axis in AXES]
    if None in (*offset, *(value for line in gain for value in line)):
        return None
    return np.array(gain, float), np.array(offset, float)
