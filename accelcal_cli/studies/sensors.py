"""Files of several sensors or people in a study that asks for each: a recording for each of them.

Which they are is found by reading all rows, by a worker, and kept in the ledger. A recording is identified by
its file and by the value of --sensor that chooses it; names of its outputs end with that value.
"""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from accelcal_cli.core.errors import UnreadableError, UsageError, printable
from accelcal_cli.core.formats import EACH
from accelcal_cli.core.input_files import files_of
from accelcal_cli.core.unpacking import plain_name
from accelcal_cli.formats import all_formats, open_recording
from accelcal_cli.pipeline.jobs import REPORT_SUFFIX, ProgressMaker, Request
from accelcal_cli.studies.discovery import job_at
from accelcal_cli.studies.records import Entry, Item, ProgressCallback
from accelcal_cli.studies.task import CalibrationTask, StageProgress, TaskResult, guarded

SENSORS = "sensors"
"""Round, in entries of the ledger, of the lists of sensors: an entry has them as `inputs`."""

COLUMN = re.compile(r"(^|,)[^=,]*=")
"""The name of a column in a value of --sensor."""

PLAIN = re.compile(r"\w(?:[\w.-]{0,38}[\w-])?")
"""A sensor that stands as it is in the names of its outputs."""

NOT_PLAIN = re.compile(r"[^\w-]+")


@dataclass(frozen=True, slots=True)
class SensorsTask(CalibrationTask):
    """One file whose sensors are to be listed."""

    def failure(self, code: int, message: str, *, again: bool) -> Entry:
        """See `Task`: the file counts as one recording, which failed; the next run tries again."""
        return CalibrationTask.failure(self, code, message, again=True)


@guarded
def listed(task: SensorsTask, report_progress: ProgressCallback) -> TaskResult:
    """List the sensors of a file; none of a file of one."""
    item = task.item
    request = task.common.request.for_recording(item.source, listing=True)
    sensors = _sensors(item.source, request, EACH, StageProgress(report_progress).stage)
    return TaskResult(Entry(item.name, item.stamps, task.common.asked, None, round=SENSORS, inputs=sensors))


def _sensors(path: Path, request: Request, wanted: str, progress: ProgressMaker) -> tuple[str, ...]:
    """Return values of --sensor that choose each of the sensors among the wanted rows.

    Raises:
        AccelcalError: a file cannot be read.
    """
    options = replace(request.options, sensor=wanted)
    try:
        with open_recording(path, options, request.threads, request.unused, joined=request.joined) as reader:
            shown = progress("reading", reader.recording.total_bytes)
            for chunk in reader.chunks(request.chunk_samples) if reader.may_hold_several else ():
                shown(chunk.end_byte)
    except UsageError as error:  # of formats that do not know `each`, too
        found = error.sensors
    except UnreadableError as error:
        if not error.sensors and wanted == EACH:
            raise
        found = error.sensors
    else:
        found = ()
    within = ((one, _sensors(path, request, f"{one},{EACH}", progress)) for one in found)
    return tuple(one for sensor, more in within for one in more or (sensor,))


def wants_each(item: Item, request: Request) -> bool:
    """Return True if each sensor of a file is to be a recording, and its kind of file may have several."""
    stated = {one.field: one.value for one in item.choices}
    suffix = Path(plain_name(item.source.name.lower())).suffix
    each = stated.get("sensor", request.options.sensor) == EACH and suffix not in _of_one()
    return each and files_of(item.source) is None


@cache
def _of_one() -> set[str]:
    """Return the suffixes of formats whose files have one sensor."""
    one = [form for form in all_formats() if "sensor" in form.ignores]
    several = {suffix for form in all_formats() if form not in one for suffix in form.suffixes}
    return {suffix for form in one for suffix in form.suffixes} - several


def in_place_of(item: Item, sensors: Sequence[str]) -> list[Item]:
    """Return the recordings of a file's sensors; of a file of one, the item itself."""
    report = item.job.report
    names: set[str] = set()
    files: set[str] = set()
    found = []
    for sensor in sorted(sensors):  # so that the same one gives way where two names are alike
        shown, file_name, digest = _names(sensor)
        shown = f"{shown}-{digest}" if shown in names else shown
        file_name = f"{file_name}-{digest}" if file_name.casefold() in files else file_name
        names.add(shown)
        files.add(file_name.casefold())
        job = job_at(item.source, report.with_name(f"{stem_of(report)}.{file_name}"))
        found.append(replace(item, name=f"{item.name} [{shown}]", job=job, sensor=sensor))
    return found or [item]


def stem_of(report: Path) -> str:
    """Return what the names of a recording's outputs begin with."""
    return report.name.removesuffix(REPORT_SUFFIX)


def report_of_all(report: Path, sensor: str) -> Path | None:
    """Return where the report of the whole file is whose sensor has a report; None if its name is no such."""
    _, file_name, digest = _names(sensor)
    ends = [end for end in (f".{file_name}-{digest}", f".{file_name}") if stem_of(report).endswith(end)]
    return report.with_name(stem_of(report).removesuffix(ends[0]) + REPORT_SUFFIX) if ends else None


def _names(sensor: str) -> tuple[str, str, str]:
    """Return a sensor's name for people and in file names, without columns, and the tag of what is alike."""
    shown = printable(COLUMN.sub(r"\1", sensor)).replace("/", "_")
    digest = hashlib.sha256(sensor.encode("utf-8", "surrogateescape")).hexdigest()[:8]
    plain = unicodedata.normalize("NFC", shown)
    return shown, plain if PLAIN.fullmatch(plain) else f"{NOT_PLAIN.sub('_', plain)[:32]}-{digest}", digest
