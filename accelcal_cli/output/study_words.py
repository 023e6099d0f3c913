"""Words for people about a study: what is found of its devices, and of its recordings among others.

Sentences stand here and in `words.py`, which has those about one recording; nothing is judged here.
"""

from __future__ import annotations

import re

from accelcal_cli.core.errors import printable
from accelcal_cli.core.reasons import Reason
from accelcal_cli.output.numbers import mg, with_error
from accelcal_cli.output.words import Values, begun_small, sentence

DEVICES = {
    "two_sensors": "{label} differs by {size} between {paths[0]} and {paths[1]}: two sensors under one "
    "serial?",
    "device_step": "{label} changes by {size} from {dates[0]} to {dates[1]}",
    "device_drift": "{label} drifts by {size} a month{doubt}",
    "device_level": "{label} is {size} (limit {limit:g} {unit})",
    "device_held_out": "held-out error {held_out_mg:.1f} mg (similar devices: {usual_mg:.1f} mg)",
    "device_refused": "{number} of {recordings} recordings refused or borrowed{elsewhere}",
    "device_damaged": "damage in {number} of {recordings} recordings, up to {lost_percent:.2g} % lost"
    "{elsewhere}",
    "device_not_known": "not known yet{best}; a recording of a day, at rest in many orientations, would tell",
}
"""Findings about a device, by code."""

SIZES = ("change", "per_month", "value")
"""Names of the value that a finding is about and that has an `error` and a `unit`."""


def of_device(reason: Reason) -> str:
    """Return what was found of a device; of a code that is not known, the code itself."""
    form = DEVICES.get(reason.code)
    return (
        reason.code if form is None else printable(form.format(**{**reason.values, **_parts(reason.values)}))
    )


def _parts(values: Values) -> Values:
    """Return parts of sentences that depend on several values."""
    parts = {"label": str(values.get("parameter")).replace("_", " ")}
    for name in SIZES:
        if name in values:
            parts["size"] = f"{with_error(values[name], values['error'])} {values['unit']}"
    uncertain = "per_month" in values and not values["certain"]
    parts["doubt"] = f" (not certain from {values['recordings']} recordings)" if uncertain else ""
    usual, high = values.get("elsewhere_percent"), values.get("least_high_mg")
    parts["elsewhere"] = "" if usual is None else f" (other devices: {usual:.0f} %)"
    parts["best"] = "" if high is None else f": the best recording may be {mg(high)} mg off"
    return {**parts, "dates": [(start or "")[:10] for start in values.get("starts", ())]}


KEPT = {
    "not_pooled": "Not pooled",
    "borrowed_nothing": "Borrowed nothing",
    "prior_not_learnt": "Kept with the prior of the population",
}
"""Why a recording keeps its own result although a later round was to replace it, by code."""


def kept(message: str, code: str, why: str) -> str:
    """Add to a message why its result stays."""
    return f"{message} {KEPT[code]}: {begun_small(why)}"


def copied(first: str) -> str:
    """Say that a recording has the bytes of another, whose path is given."""
    return f"a copy of {first}, which counts once"


def in_words(code: str) -> str:
    """Return a code as words."""
    return code.replace("_", " ")


def uncertain(error_mg: float | None, high_mg: float | None) -> str:
    """Say how large an uncertain calibration error may be."""
    if error_mg is None or high_mg is None:
        return "its error over all orientations is not certain"
    return f"{error_mg:.1f} mg over all orientations, but perhaps {high_mg:.1f} mg (95 %)"


def lost(percent: float) -> str:
    """Say how much of a file is lost."""
    return f"{percent:.2g} % of the file is lost"


def changed(kind: str, at: str | None, size_mg: float | None) -> str:
    """Say how a sensor changed while it recorded."""
    return sentence(Reason("sensor_changed", {"kind": kind, "at": at, "size_mg": size_mg or 0.0}))


def not_described(kinds: str) -> str:
    """Say which kinds of misfit were found."""
    return f"found: {kinds}"


SITES = ("wrist", "hip", "waist", "back", "sacrum", "thigh", "ankle", "chest", "arm", "leg", "foot")
"""Wear sites that are known if the name of a recording, or of its folder, has the word."""


def kind_of(path: str, model: str | None) -> str:
    """Return a device's model and the wear site, as far as the name of the file or of its folder has it."""
    words = re.split(r"[^a-z]+", "/".join(path.lower().replace("\\", "/").split("/")[-2:]))
    site = next((site for site in SITES if site in words), None)
    return ", ".join(filter(None, (printable(model or ""), site))) or "any device"
