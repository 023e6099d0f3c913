"""The degrees in which other tools read a recording's thermometer, which are not always ours.

A .cwa file holds a raw word, of which three lines are in use: ours, by the hardware (formats/cwa/sector.py),
that of GGIR, raw * 75 / 256 - 50 for all (GGIRread 1.0.9, R/readAxivity.R), and that of biobank's accProcess
and of omconvert, (raw * 150 - 20500) / 1000 for all (AxivityReader.java, omconvert.c). Between any two of
them lies a line, so that a slope can be exported exactly.

Where a tool reads the degrees that the file states, they are ours. A tool reads no temperature from files of
other formats, or that of another thermometer: GGIR takes the air's of a Matrix, accelcal the skin's.
"""

from __future__ import annotations

from dataclasses import dataclass

from accelcal_cli.core.recording import ThermometerWord
from accelcal_cli.output.sections import RecordingSection

AXIVITY = "cwa"
WORDS = {
    "ggir": ThermometerWord(75 / 256, -50.0),
    "biobank": ThermometerWord(0.15, -20.5),
    "omconvert": ThermometerWord(0.15, -20.5),
}
"""Line by which each tool reads the temperature of a .cwa file."""

STATED = {"ggir": ("geneactiv", "csv", "unisens"), "biobank": ("geneactiv",), "omconvert": ()}
"""Formats of which each tool takes over the degrees that the file states; GGIR of a CSV file if asked to."""

NAMES = {"ggir": "GGIR", "biobank": "accProcess", "omconvert": "omconvert"}
WARMEST_AT_START_C = 50.0
"""GGIR uses no temperature of a recording if the mean of the first ten is higher (R/g.getmeta.R)."""


@dataclass(frozen=True, slots=True)
class Degrees:
    """A tool's degrees: per_degree * ours + zero."""

    per_degree: float = 1.0
    zero: float = 0.0

    def of(self, celsius: float) -> float:
        """Return what the tool reads at one of our temperatures."""
        return self.per_degree * celsius + self.zero


def degrees_of(tool: str, recording: RecordingSection) -> Degrees | None:
    """Return the degrees in which a tool reads a recording; None if it reads none, or unknown ones."""
    if recording.format in STATED[tool]:
        return Degrees()
    if recording.format != AXIVITY or recording.thermometer is None:
        return None
    ours, theirs = recording.thermometer, WORDS[tool]
    ratio = theirs.celsius_per_count / ours.celsius_per_count
    return Degrees(ratio, theirs.celsius_at_zero - ratio * ours.celsius_at_zero)


def why_none(tool: str, recording: RecordingSection) -> str:
    """Return why a recording's temperature cannot be exported to a tool."""
    if recording.format == AXIVITY:
        return "the report does not say how it was read: calibrate the recording again with --force"
    return f"{NAMES[tool]} reads no temperature from {recording.format} files, or that of another thermometer"
