"""The page of a study: outcomes of its recordings, and which of them and of its devices to look at first.

Everything that it shows is in the study's table and in the review of its devices. All texts are treated as
hostile: names are made printable here, the template escapes what it is given, and the data for the script are
JSON that cannot end their element (`embedded`).
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from math import isfinite
from statistics import median
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from accelcal_cli.core.errors import counted, printable
from accelcal_cli.core.results import Outcome
from accelcal_cli.devices.review import Verdict
from accelcal_cli.devices.trends import Drift
from accelcal_cli.output import sentences
from accelcal_cli.output.advice import LIMIT_MG
from accelcal_cli.output.decisions import CAUTIOUS, COLUMNS, MOST_LISTED, excludes
from accelcal_cli.output.numbers import mg_of_two_digits
from accelcal_cli.output.report_reading import section
from accelcal_cli.output.sentences import OUTCOMES, outcome_words
from accelcal_cli.pages import study_figures as figures
from accelcal_cli.pages.rendering import rendered
from accelcal_cli.pages.study_figures import Wear, by_wear, strips

# Decisions of people on the page of a study: the rows of their file, and the faults of some of them.
#
# Both come from `study.json`, which others may have changed: what does not fit is left out.

USE = COLUMNS.index("use")
"""Place of the decision in a row."""


def rows(summary: dict[str, Any]) -> list[list[str]]:
    """Return the rows of the file for the script of the page: texts in the order of COLUMNS."""
    held = section(summary, "decisions").get("rows")
    return [list(map(printable, row)) for row in held if _fits(row)] if isinstance(held, list) else []


def _fits(row: Any) -> bool:
    """Return True for a row as a study writes it."""
    texts = isinstance(row, list) and len(row) == len(COLUMNS) and all(isinstance(one, str) for one in row)
    return texts and row[USE] in CAUTIOUS


def findings(summary: dict[str, Any]) -> list[str]:
    """Return a line for each finding that a person must act on, and one for those that are not listed."""
    held = section(summary, "findings")
    lines = [printable(str(one.get("message"))) for one in _objects(held.get("listed"))[:MOST_LISTED]]
    number = held.get("number")
    more = number - len(lines) if isinstance(number, int) else 0
    return [*lines, f"and {more} more"] if more > 0 else lines


def _objects(listed: Any) -> list[dict[str, Any]]:
    return [one for one in listed if isinstance(one, dict)] if isinstance(listed, list) else []


def _not_listed(summary: dict[str, Any]) -> int:
    """Return the number of decisions that the page does not have, so that it must not save the others."""
    number = section(summary, "decisions").get("rows_not_listed")
    return number if isinstance(number, int) else 0


# The page of a study.

WANTED = (
    "path", "use", "why", "wear_hours", "outcome", "reason", "message", "model", "copy_of", "borrowed_from",
    "before_mg", "after_mg", "calibration_error_mg", "calibration_error_high_mg",
    "calibration_error_before_mg", "probability_better", "change", "change_at", "change_mg", "misfits",
    "device_model", "device_serial", "start_time", "duration_s", "lost_percent", "report",
    "decided_by", "result",
)  # fmt: skip
"""Columns of the study's table that the page shows."""

REASONS = 8
"""Number of reasons of an outcome that have a line of their own."""
FIRST = 3
"""Number of recordings of each kind of problem to look at first."""
LISTED = 1000
"""Number of recordings in the list of problems: some thirty printed pages."""
DAMAGED_FROM_PERCENT = 0.1
"""Share of a recording's bytes from which damage is a problem, as for `accelcal devices`."""
SIZES = {
    "changed": "change_mg",
    "uncertain": "calibration_error_high_mg",
    "damaged": "lost_percent",
    "misfit": "calibration_error_mg",
}
"""Columns that say how bad a problem is, by its kind."""
COPY = "copy"
"""Name in the table of what a recording is that has the bytes of another; it counts nowhere else."""
VERDICTS = tuple(map(sentences.in_words, Verdict))
"""Verdicts on devices in words, the weightiest first."""
SERVICE, TROUBLED = VERDICTS[:2], VERDICTS[:3]
"""Verdicts that ask for something to be done, and also those that ask for a look."""
HOUR_S = 3600


@dataclass(frozen=True, slots=True)
class DeviceLine:
    """A device of the study, as `accelcal devices` judges it.

    Attributes:
        verdict: one of VERDICTS.
        reasons: reasons of the verdict, the weightiest first.
        first, last: dates of its first and last recording.
        offset, percent: the fastest drift of an offset [mg a month] and of scale or misalignment [% a month],
            each with its standard error and whether it is certain; None if there are too few recordings.
    """

    name: str
    verdict: str
    reasons: tuple[str, ...]
    recordings: int
    used: int
    refused: int
    first: str | None
    last: str | None
    held_out_mg: float | None
    offset: Drift | None
    percent: Drift | None


@dataclass(frozen=True, slots=True)
class StudyContent:
    """All that the page of a study is made of.

    Attributes:
        rows: rows of the study's table, as dictionaries with at least the keys WANTED.
        pages: path of each recording's page, relative to this one; None where there is none.
        summary: content of `study.json`; empty if there is none.
        devices: all devices, those to service first.
        nameless: number of recordings without a serial number.
        drift_limit_mg: drift of an offset in a month that is a reason for service.
        csv: name of the table next to the page.
        origin: folder, command and time of the newest result, by name.
        hours: number of a row, and the states of its recording's hours (`strips.states_of`), in their order.
    """

    rows: Sequence[dict[str, Any]]
    pages: Sequence[str | None]
    summary: dict[str, Any]
    devices: Sequence[DeviceLine]
    nameless: int
    drift_limit_mg: float
    csv: str = "study.csv"
    origin: Sequence[tuple[str, str]] = ()
    hours: Sequence[tuple[int, tuple[list[str], float]]] = ()


@dataclass(frozen=True, slots=True)
class ProblemKind:
    """A kind of problem, and what to do about it.

    Attributes:
        short: its name in the table of all recordings.
    """

    key: str
    short: str
    title: str
    advice: str


KINDS = (
    ProblemKind("failed", "failed", "Could not be processed",
                "The message says what is wrong with the file. "
                "If it is damaged, copy it again from the device."),
    ProblemKind("changed", "sensor changed", "The sensor changed while it recorded",
                "The recording's page shows since when, and whether the calibration follows. "
                "Have the device checked if it happens again."),
    ProblemKind("refused", "refused", "Refused: no calibration could be trusted",
                "The message says what is missing. Record longer, or use the coefficients of another "
                "recording of the device (accelcal study --borrow)."),
    ProblemKind("uncertain", "uncertain", "Calibrated, but uncertain",
                "The true error may be beyond the limit in orientations that were not recorded. "
                "A longer recording with more turns of the wrist helps."),
    ProblemKind("damaged", "file damaged", "Parts of the file are lost",
                "Copy the file again from the device; if the damage stays, have the device checked."),
    ProblemKind("misfit", "not described", "Sensor behaviour outside the model",
                "The error is larger than it could be. The recording's page names what was found."),
)  # fmt: skip
"""Kinds of problems, the weightiest first: a recording is listed under the first that it has."""


def page(study: StudyContent) -> str:
    """Return the whole page as HTML; the same content gives the same text."""
    devices = _devices(study)
    limit_mg = _limit_mg(study.summary)
    entries = [_Entry(row, href, limit_mg) for row, href in zip(study.rows, study.pages, strict=True)]
    once = [entry for entry in entries if not entry.copy_of]
    scatter = figures.Scatter.of([None if entry.copy_of else entry.errors for entry in entries])
    groups = _groups(once)
    return rendered(
        "study.html",
        style="study.css",
        script="study.js",
        headline=_headline(once, len(entries) - len(once)),
        notes=_notes(study.summary),
        outcomes=_outcomes(once),
        first=[(kind, len(members), members[:FIRST]) for kind, members in groups],
        groups=_listed(groups),
        scatter=scatter,
        dots=scatter.dots([entry.outcome for entry in entries]),
        limit=scatter.limit(limit_mg),
        limit_mg=f"{limit_mg:g}",
        months=figures.by_month(
            [entry.row["start_time"] for entry in once], [entry.outcome for entry in once], list(OUTCOMES)
        ),
        wear=by_wear([entry.wear for entry in once]),
        marked=_marked(scatter, entries, groups),
        **devices,
        csv=study.csv,
        strips=strips([(entries[at].path, entries[at].href, hours) for at, hours in study.hours]),
        origin=[(name, printable(value)) for name, value in study.origin],
        left_out=_left_out(study.summary),
        decided=[entry for entry in entries if entry.row["decided_by"]][:LISTED],
        to_act_on=findings(study.summary),
        recordings=len(once),
        data=embedded(
            {
                "recordings": _recordings_table(entries, scatter),
                "devices": _devices_table(devices["devices"]),
                "decisions": rows(study.summary),
                "decisions_not_listed": _not_listed(study.summary),
            }
        ),
    )


def _devices(study: StudyContent) -> dict[str, Any]:
    """Return what the page says of the devices."""
    lines = [
        replace(line, name=printable(line.name), reasons=tuple(map(printable, line.reasons)))
        for line in study.devices
    ]
    service = [line for line in lines if line.verdict in SERVICE]
    return {
        "devices": lines,
        "service": service[:FIRST],
        "to_service": len(service),
        "troubled": [line for line in lines if line.verdict in TROUBLED],
        "verdicts": Counter(line.verdict for line in lines),
        "drifts": figures.drifts([(line.name, line.offset) for line in lines], study.drift_limit_mg),
        "drift_limit": f"{study.drift_limit_mg:g}",
        "nameless": counted(study.nameless, "recording") if study.nameless else None,
    }


class _Entry:
    """A recording: its row with printable texts, its page, and its weightiest problem.

    Attributes:
        copy_of: path of the recording with the same bytes that counts; None or empty if this one counts.
        href: address of its page, None if there is none; `./` keeps a name from being treated as a scheme.
    """

    def __init__(self, row: dict[str, Any], address: str | None, limit_mg: float) -> None:
        self.row = {name: _shown(row.get(name)) for name in WANTED}
        self.address = address
        quoted = None if address is None else quote(address.encode("utf-8", "surrogateescape"))
        self.href = None if quoted is None else f"./{quoted}"
        self.path: str = self.row["path"] or "?"
        self.outcome: str = self.row["outcome"] or "failed"
        self.copy_of: str | None = self.row["copy_of"]
        self.message: str = self.row["message"] or ""
        self.changed = self.row["change"] not in (None, "none")
        decided = self.row["probability_better"] is not None
        has = {
            "failed": self.row["outcome"] == "failed",
            "changed": self.changed,
            "refused": self.row["outcome"] == "refused",
            "uncertain": self.outcome == Outcome.PROVISIONAL
            or (not decided and (self.row["calibration_error_high_mg"] or 0.0) > limit_mg),
            "damaged": (self.row["lost_percent"] or 0.0) >= DAMAGED_FROM_PERCENT,
            "misfit": self.row["misfits"] not in (None, "none"),
        }
        self.problem = next((kind for kind in KINDS if has[kind.key]), None)

    def order(self) -> tuple[float, str]:
        """Return the place among recordings with the same problem, the worst first."""
        size = self.row.get(SIZES.get(self.problem.key, "")) if self.problem else None
        return -(size or 0.0), self.path

    @property
    def device(self) -> str:
        """Serial number, or what else is known of the device."""
        return self.row["device_serial"] or self.row["device_model"] or "-"

    @property
    def excluded(self) -> bool:
        """True if a person decided not to use it."""
        return excludes(self.row)

    @property
    def problem_name(self) -> str:
        """Name of the problem in the table, or that it is a copy; empty without one."""
        if self.copy_of:
            return COPY
        return self.problem.short if self.problem else ""

    @property
    def change_mg(self) -> float | None:
        """Size of the sensor's change; None if it did not change."""
        size: float | None = self.row["change_mg"] if self.changed else None
        return size

    @property
    def hours(self) -> float | None:
        """Length of the recording [h]."""
        seconds = self.row["duration_s"]
        return None if seconds is None else seconds / HOUR_S

    @property
    def wear(self) -> Wear:
        """Hours of wear, or else of the recording, and the error over all orientations."""
        worn, error = self.row["wear_hours"], self.row["calibration_error_mg"]
        kind = sentences.kind_of(self.path, self.row["device_model"])
        usable = outcome_words(self.outcome).usable
        return Wear(kind, self.hours if worn is None else worn, self.outcome, usable, error)

    @property
    def errors(self) -> tuple[float, float] | None:
        """Error before and after [mg]: over the sphere, or where that is not known on held-out postures."""
        everywhere = self.row["calibration_error_before_mg"], self.row["calibration_error_mg"]
        pairs = (everywhere, (self.row["before_mg"], self.row["after_mg"]))
        return next((pair for pair in pairs if None not in pair), None)

    @property
    def finding(self) -> str:
        """Words about the problem, or what the recording is a copy of; empty without one."""
        row, kind = self.row, "" if self.problem is None else self.problem.key
        if self.copy_of:
            return sentences.copied(self.copy_of)
        if kind == "uncertain":
            return sentences.uncertain(row["calibration_error_mg"], row["calibration_error_high_mg"])
        if kind == "damaged":
            return sentences.lost(row["lost_percent"])
        if kind == "changed":
            return sentences.changed(row["change"], row["change_at"], row["change_mg"])
        if kind == "misfit":
            return sentences.not_described(row["misfits"])
        return self.message if kind else ""

    @property
    def link(self) -> int | str:
        """Address for the script: 0 for none, 1 where it follows from the recording's name."""
        if self.address is None:
            return 0
        same = self.address == re.sub(r"\.[^./]+$", "", self.path) + ".html"
        return 1 if same else self.href or 0


def _shown(value: Any) -> Any:
    """Make texts printable, and numbers that are not finite None."""
    if isinstance(value, str):
        return printable(value)
    return None if isinstance(value, float) and not isfinite(value) else value


def _limit_mg(summary: dict[str, Any]) -> float:
    limit = section(summary, "settings").get("max_error_mg")
    return float(limit) if isinstance(limit, int | float) else LIMIT_MG


Group = tuple[ProblemKind, list[_Entry]]


def _groups(entries: Sequence[_Entry]) -> list[Group]:
    """Return the recordings with each kind of problem, the worst first."""
    groups = [(kind, [entry for entry in entries if entry.problem is kind]) for kind in KINDS]
    return [(kind, sorted(members, key=_Entry.order)) for kind, members in groups if members]


def _listed(groups: Sequence[Group]) -> list[tuple[ProblemKind, list[_Entry], int]]:
    """Cut the groups to LISTED recordings in all; the number is that of all of the kind."""
    left, listed = LISTED, []
    for kind, members in groups:
        listed.append((kind, members[:left], len(members)))
        left -= len(listed[-1][1])
    return listed


def _headline(entries: Sequence[_Entry], copies: int) -> dict[str, str]:
    """Return the study in a few figures, to which copies do not count."""
    usable = sum(outcome_words(entry.outcome).usable and not entry.excluded for entry in entries)
    pairs = [entry.errors for entry in entries if entry.errors is not None]
    headline = {
        "Recordings": f"{len(entries):,}{f' (and {copies:,} copied from them)' if copies else ''}",
        "Can be used": f"{usable:,} ({100 * usable / len(entries):.1f} %)" if entries else "0",
        "With a problem": f"{sum(entry.problem is not None for entry in entries):,}",
        "Devices": f"{len({entry.row['device_serial'] for entry in entries} - {None, ''}):,}",
    }
    if pairs:
        before, after = (median(errors) for errors in zip(*pairs, strict=True))
        headline["Median error"] = f"{mg_of_two_digits(before)} mg before, {mg_of_two_digits(after)} mg after"
    return headline


def _notes(summary: dict[str, Any]) -> list[str]:
    """Return what users must know that the study says of itself."""
    waiting, pools = summary.get("waiting"), section(summary, "pools")
    notes = []
    if isinstance(waiting, int) and waiting:
        notes.append(f"{counted(waiting, 'recording')} waiting: not started yet.")
    if pools:
        notes.append(f"{counted(len(pools), 'pool')} of recordings of one device.")
    return notes


def _left_out(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Return name and reason of the files that the study leaves out, those by its options aside."""
    texts = [
        (printable(str(one.get("path"))), printable(str(one.get("message"))))
        for one in _objects(summary.get("files_left_out"))
        if one.get("code") != "excluded"
    ]
    return texts[:LISTED]


def _outcomes(entries: Sequence[_Entry]) -> list[dict[str, Any]]:
    """Return a line for each outcome, and one for each reason of those that are not usable."""
    total, numbers = len(entries), Counter(entry.outcome for entry in entries)
    lines: list[dict[str, Any]] = []
    for outcome in sorted(numbers, key=lambda one: list(OUTCOMES).index(one) if one in OUTCOMES else 99):
        number, words = numbers[outcome], outcome_words(outcome)
        own = [entry for entry in entries if entry.outcome == outcome]
        lines.append(
            {"outcome": outcome, "name": outcome.replace("_", " "), "meaning": words.use,
             "number": number, "share": figures.bar(number, total), "percent": f"{100 * number / total:.1f}",
             "reasons": [] if words.usable else _reasons(own, total)}
        )  # fmt: skip
    return lines


def _reasons(entries: Sequence[_Entry], total: int) -> list[dict[str, Any]]:
    """Return the reasons of an outcome, the most frequent first."""
    numbers = Counter(sentences.in_words(entry.row["reason"] or "no reason is known") for entry in entries)
    often = sorted(numbers.items(), key=lambda one: (-one[1], one[0]))
    lines, others = often[:REASONS], sum(number for _, number in often[REASONS:])
    if others:
        lines.append((counted(len(often) - REASONS, "other reason"), others))
    return [{"text": text, "number": number, "share": figures.bar(number, total)} for text, number in lines]


def _marked(
    scatter: figures.Scatter, entries: Sequence[_Entry], groups: Sequence[Group]
) -> list[tuple[_Entry, float, float]]:
    """Return the recordings to look at first with their places in the scatter: links that need no script."""
    places = {id(entry): place for entry, place in zip(entries, scatter.places, strict=True)}
    first = [entry for _, members in groups for entry in members[:FIRST]]
    return [(entry, *place) for entry in first if (place := places[id(entry)]) is not None]


def _spaced(names: Iterable[str]) -> list[str]:
    return [name.replace("_", " ") for name in names]


def _recordings_table(entries: Sequence[_Entry], scatter: figures.Scatter) -> dict[str, Any]:
    """Return the table of all recordings, column by column, as the script reads it."""

    def of(name: str) -> list[Any]:
        return [getattr(entry, name) for entry in entries]

    def of_row(name: str, absent: Any = None) -> list[Any]:
        return [absent if entry.row[name] is None else entry.row[name] for entry in entries]

    pairs = [errors or (None, None) for errors in of("errors")]
    return {
        "what": "recording",
        "columns": [
            column("path", "recording", "text", 19, of("path")),
            choice_column("outcome", 8, _spaced(of("outcome")), _spaced(OUTCOMES)),
            choice_column("use", 7, of_row("use", ""), ["yes", "with care", "no", ""]),
            choice_column("problem", 9, of("problem_name"), ["", *(kind.short for kind in KINDS), COPY]),
            number_column("before", "before, mg", 7.5, (pair[0] for pair in pairs), kind="mg"),
            number_column("after", "after, mg", 7, (pair[1] for pair in pairs), kind="mg"),
            choice_column("device", 9, of("device")),
            column("start", "start", "minutes", 10, [_minutes(start) for start in of_row("start_time")]),
            number_column("hours", "hours", 5.5, of("hours")),
            number_column("worn", "worn, h", 6, of_row("wear_hours")),
            choice_column("reason", 13, of_row("reason", "")),
            choice_column("model", 5.5, of_row("model", "")),
            number_column("change", "change, mg", 8, of("change_mg"), kind="mg"),
            number_column("lost", "lost, %", 6, (percent or None for percent in of_row("lost_percent"))),
            message_column("message", "finding", 70, of("finding")),
        ],
        "pages": of("link"),
        "results": of_row("result", ""),
        "scatter": scatter.scale(),
    }


def _devices_table(devices: Sequence[DeviceLine]) -> dict[str, Any]:
    """Return the table of all devices."""
    verdicts = [line.verdict for line in devices]
    return {
        "what": "device",
        "columns": [
            column("device", "device", "text", 12, [line.name for line in devices]),
            choice_column("verdict", 6, verdicts, VERDICTS),
            number_column("recordings", "recordings", 7.5, (line.recordings for line in devices)),
            number_column("used", "used", 5, (line.used for line in devices)),
            number_column("refused", "refused", 6, (line.refused for line in devices)),
            column("first", "first", "text", 8, [(line.first or "")[:10] for line in devices]),
            column("last", "last", "text", 8, [(line.last or "")[:10] for line in devices]),
            number_column("held", "held out, mg", 8.5, (line.held_out_mg for line in devices), kind="mg"),
            *_drift("offset", "offset, mg a month", [line.offset for line in devices]),
            *_drift("percent", "scale, % a month", [line.percent for line in devices]),
            column("why", "why", "text", 60, ["; ".join(line.reasons) for line in devices]),
        ],
        "pages": [],
    }


def _drift(key: str, label: str, drifts: Sequence[Drift | None]) -> list[dict[str, Any]]:
    """Return two columns: the drift and its standard error."""
    pairs = [(None, None) if drift is None else (drift.per_month, drift.error) for drift in drifts]
    return [
        number_column(key, label, 11, (pair[0] for pair in pairs)),
        number_column(f"{key}_error", "±", 6, (pair[1] for pair in pairs)),
    ]


NUMBER = re.compile(r"\d+(?:\.\d+)?")
"""Pattern of a number in a message."""


def column(key: str, label: str, kind: str, width: float, values: Sequence[Any]) -> dict[str, Any]:
    """Return a column `width` rem wide, whose values are of a kind that the script knows."""
    return {"key": key, "label": label, "kind": kind, "width": width, "values": values}


def choice_column(key: str, width: float, values: Sequence[str], order: Sequence[str] = ()) -> dict[str, Any]:
    """Return a column of few different texts: their list, and the place of each value in it."""
    there = set(values)
    names = [*(name for name in order if name in there), *sorted(there - set(order))]
    place = {name: index for index, name in enumerate(names)}
    return column(key, key, "choice", width, [place[one] for one in values]) | {"names": names}


def number_column(
    key: str, label: str, width: float, values: Iterable[float | None], kind: str = "number"
) -> dict[str, Any]:
    """Return a column of numbers to four significant digits."""
    short = [None if value is None else float(f"{value:.4g}") for value in values]
    shown = [int(one) if one is not None and one.is_integer() else one for one in short]
    return column(key, label, kind, width, shown)


def _minutes(start: str | None) -> int | None:
    """Return a time by the clock that wrote it, in minutes since 1970."""
    try:
        moment = datetime.fromisoformat((start or "")[:16])
    except ValueError:
        return None
    return int((moment.replace(tzinfo=None) - datetime(1970, 1, 1)).total_seconds() // 60)


def message_column(key: str, label: str, width: float, texts: Sequence[str]) -> dict[str, Any]:
    """Return a column of messages: the texts without their numbers once, and the numbers of each.

    Thousands of messages differ in their numbers alone. A value is [which text, its numbers ...]; 0 for none.
    """
    places: dict[str, int] = {}
    values: list[Any] = []
    for message in texts:
        place = places.setdefault(NUMBER.sub("\0", message), len(places)) if message else 0
        values.append([place, *NUMBER.findall(message)] if message else 0)
    return column(key, label, "message", width, values) | {"names": [text.split("\0") for text in places]}


def embedded(value: Any) -> Markup:
    """Write JSON for a script element: nothing in it ends the element or a line of script."""
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    for char in "<>&\u2028\u2029":
        text = text.replace(char, f"\\u{ord(char):04x}")
    return Markup(text)
