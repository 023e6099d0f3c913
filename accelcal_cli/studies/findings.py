"""Finds what a person must act on in a study.

Each finding is said once, also with `-q`, and stands at the top of the study's page while it lasts.
`study.json` keeps what was found: the next quiet run says only what is new or has changed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from accelcal_cli.core.errors import Reason, printable
from accelcal_cli.core.local_time import UNKNOWN, UTC
from accelcal_cli.core.results import Outcome
from accelcal_cli.output.decisions import MOST_LISTED, Merged, excludes, of_another_name
from accelcal_cli.output.report_reading import section
from accelcal_cli.output.sentences import clause, sentence
from accelcal_cli.studies.orphans import Orphans
from accelcal_cli.studies.records import FAILED
from accelcal_cli.studies.summary import time_zones

STAYS = "stays, and --prune removes it"
FINDINGS = "findings"
"""Key of `study.json`."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Something to act on: its code with values, and the line for people."""

    reason: Reason
    line: str

    @property
    def key(self) -> str:
        """Text by which the next run knows it; more recordings of mixed times change nothing."""
        return self.reason.code if self.reason.code == "times_mixed" else self.line

    def as_json(self) -> dict[str, Any]:
        """Return the object of `study.json`."""
        return {**self.reason.as_json(), "message": self.line}


def of_decisions(merged: Merged | None, last: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield what is wrong with decisions, or that those of the last run are gone.

    Args:
        last: what `study.json` says of the last run.
    """
    if merged is not None:
        for one in merged.findings:
            yield Finding(one, f"{merged.decisions.file}: {sentence(one)}")
        return
    held = section(dict(last), "decisions")
    if isinstance(number := held.get("decided"), int) and number:
        reason = Reason.of("decisions_gone", number=number)
        yield Finding(reason, f"{printable(str(held.get('file')))}: {sentence(reason)}")
    else:
        yield from (one for one in _listed(last) if one.reason.code == "decisions_gone")


def of_rows(rows: Sequence[Mapping[str, Any]]) -> Iterator[Finding]:
    """Yield recordings whose file is cut short, and those of two names with the same bytes."""
    excluded = {row["path"] for row in rows if excludes(row)}
    for row in rows:
        path, first = row["path"], row.get("copy_of")
        if first and of_another_name(path, first) and excluded.isdisjoint((path, first)):
            reason = Reason.of("copied_under_another_name", first=first)
            yield Finding(reason, f"{path}: {sentence(reason)}")
        elif not first and "cut_short" in (row.get("cautions") or "").split():
            reason = Reason.of("file_cut_short", lost_percent=row["lost_percent"])
            yield Finding(reason, f"{path}: {sentence(reason)}")


def of_orphans(orphans: Orphans, *, pruned: bool) -> Iterator[Finding]:
    """Yield results whose recording is gone, and folders whose disk may be away."""
    for folder, number in sorted(orphans.away.items()):
        reason = Reason.of("disk_may_be_away", results=number)
        yield Finding(reason, f"{printable(folder)}: {sentence(reason)}")
    for one in () if pruned else orphans.found:
        yield Finding(one.reason, f"{printable(one.name)} {STAYS}: {clause(one.reason)}")


def of_times(rows: Sequence[Mapping[str, Any]]) -> Iterator[Finding]:
    """Yield a warning against joining the Parquet files, if `time` is not of one type in all of them."""
    zones = time_zones(rows)
    if len(zones) > 1:
        reason = Reason.of("times_mixed", utc=zones[UTC], unknown=zones[UNKNOWN])
        yield Finding(reason, sentence(reason))


def of_pools(pools: Mapping[str, Mapping[str, Any]]) -> Iterator[Finding]:
    """Yield the devices whose recordings could not be pooled."""
    for pool in pools.values():
        if pool["outcome"] in (FAILED, Outcome.REFUSED):
            values = {name: pool[name] for name in ("recordings", "device_serial", "message")}
            reason = Reason.of("pool_refused", **values)
            yield Finding(reason, sentence(reason))


def as_json(findings: Sequence[Finding]) -> dict[str, Any]:
    """Return the object of `study.json`: of many only the first, and a hash of the rest."""
    rest = [one.line for one in findings[MOST_LISTED:]]
    digest = hashlib.sha256("\n".join(rest).encode()).hexdigest()[:16] if rest else None
    listed = [one.as_json() for one in findings[:MOST_LISTED]]
    return {"number": len(findings), "listed": listed, "rest": digest}


def lines(findings: Sequence[Finding], last: Mapping[str, Any]) -> Iterator[tuple[str, bool]]:
    """Yield the line of each finding, and whether it is new since the last run.

    Args:
        last: what `study.json` says of the last run.
    """
    said = {text for one in _listed(last) for text in (one.reason.code, one.line)}
    rest = as_json(findings)["rest"]
    for one in findings[:MOST_LISTED]:
        yield one.line, one.key not in said
    if rest:
        more = f"and {len(findings) - MOST_LISTED} more to act on"
        yield more, rest != section(dict(last), FINDINGS).get("rest")


def _listed(last: Mapping[str, Any]) -> list[Finding]:
    """Return the findings of the last run, as far as others have not changed them."""
    listed = section(dict(last), FINDINGS).get("listed")
    held = [one for one in listed if isinstance(one, dict)] if isinstance(listed, list) else []
    return [
        Finding(Reason(str(one.get("code")), section(one, "values")), str(one.get("message"))) for one in held
    ]
