"""Sentences about the files of a study: why one is left out, no longer belongs to it, or was decided on.

Part of `SENTENCES` in `words.py`, where they are made from reasons.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

FormOfValues = str | Callable[[Mapping[str, Any]], str]
"""A sentence with names of values in braces, or a function of the values.

The values are those of a reason in `study.json`, which may have been changed by others.
"""


DECIDED = {"yes": "to use it", "with care": "to use it with care", "no": "not to use it"}


def _decided(values: Mapping[str, Any]) -> str:
    """Say what a person decided about a recording, and the person's note."""
    who_and_when = ", ".join(filter(None, (values["who"], values["when"])))
    note = f": {values['note'].rstrip('.')}" if values["note"] else ""
    by = f" ({who_and_when})" if who_and_when else ""
    return f"A person decided {DECIDED[values['decided']]}{by}{note}."


def _no_decision(values: Mapping[str, Any]) -> str:
    """Say what is wrong with a row of decisions."""
    if values["column"] == "recording":
        return f"Row {values['row']} names no recording."
    return f"In row {values['row']}, use is '{values['cell']}', which is not yes, with care or no."


FILES: dict[str, FormOfValues] = {
    # why a file of a study is left out
    "unfinished_copy": "It is a download or a copy that is not finished ({suffix}).",
    "excluded": "It is excluded by {by}.",
    "belongs_to_another": "It belongs to the recording {name}.",
    "not_a_file": "It is a pipe or a device, not a file.",
    "not_looked_into": "It could not be looked into ({fault}).",
    "archive_without_recordings": "No file in the archive is named like a recording.",
    "epochs": "It holds {whose} epochs, not raw acceleration.",
    "database": "It is an SQLite database, from which the recording can be exported as text (CSV).",
    "still_windows": "It holds means of still windows, which accelcal fit takes.",
    "no_acceleration": "Nothing in it is acceleration.",
    "other_quantities": lambda values: (
        f"It is a table of other quantities: {', '.join(map(str, values['columns']))}."
    ),
    "no_numbers": "It is text without rows of three or more numbers.",
    "no_format": "Its content matches no format.",
    # results whose recording is gone
    "recording_gone": "Its recording {source} is gone.",
    "recording_renamed": "Its recording {source} is now called {now}.",
    "sensor_gone": "The sensor {sensor} is no longer in its file {source}.",
    # what a person decided
    "decided_by_a_person": _decided,
    "decision_outdated": "The result of {recording} has changed since row {row} decided {decided}. "
    "The more cautious of both counts: {use}.",
    "decision_unreadable": _no_decision,
    "decision_without_recording": "Row {row} names {recording}, which is not a recording of the study.",
    "decisions_contradict": "Rows {rows:list} contradict each other on {recording}. The most cautious of "
    "them counts: {use}.",
    "decisions_more": "{number:n more finding} about rows.",
}
"""Sentences by code; words in braces are values of the reason."""
