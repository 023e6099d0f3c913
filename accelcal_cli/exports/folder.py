"""A folder of calibrated recordings ready for another tool: tables or arrays, coefficients, and a script.

Recordings are exported several at a time, each a portion of rows at a time, so that memory does not depend on
their number or length. What cannot be exported is skipped, and said.
"""

from __future__ import annotations

import json
import shlex
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from importlib.resources import files
from math import isclose
from pathlib import Path
from threading import Event
from typing import Any

from accelcal_cli.core.errors import AccelcalError, UsageError
from accelcal_cli.core.local_time import UTC
from accelcal_cli.core.parallel import parallel_map
from accelcal_cli.core.version import __version__
from accelcal_cli.exports import coefficients
from accelcal_cli.exports.data import ExportedData, ExportOptions, export_data, r_zone
from accelcal_cli.exports.rows import CalibratedFile, described_file
from accelcal_cli.exports.selection import Selected, refuse_existing
from accelcal_cli.output.files import write_text
from accelcal_cli.pipeline.jobs import PARQUET_SUFFIX
from accelcal_cli.pipeline.outputs import make_folder

SUFFIXES = {"npz": ".npz", "skdh": ".npz", "parquet": ".parquet"}
"""Suffix of a recording's file in each form; .csv in others, with .gz if they are compressed."""

SCRIPTS = {
    "ggir": "run_ggir.R",
    "biobank": "run_accprocess.sh",
    "actipy": "run_actipy.py",
    "skdh": "run_skdh.py",
}
"""Script of each tool that reads data."""

RUN_BY = {".R": "Rscript", ".sh": "sh", ".py": "python"}
COEFFICIENT_FILES = {"ggir": "coefficients.csv", "biobank": "coefficients.txt"}

EVEN = 1e-6
"""Greatest relative difference of a measured rate from the nominal one that needs no resampling."""

LEAST_RANGE_G = 8.0
"""Range [g] that is stated for a recording of unknown range: GGIR takes what is beyond for clipped."""


@dataclass(frozen=True, slots=True)
class Planned:
    """A recording and its file in the folder."""

    recording: Selected
    about: CalibratedFile
    output: Path


@dataclass(frozen=True, slots=True)
class Made:
    """A planned recording after its export: its rows, or the error that stopped it."""

    planned: Planned
    written: ExportedData | None = None
    error: AccelcalError | None = None


@dataclass(frozen=True, slots=True, order=True)
class Group:
    """Recordings that one call of GGIR takes: its arguments hold for all of them."""

    rate_hz: float
    range_g: float
    temperature: bool
    uneven: bool
    zone: str

    @property
    def folder(self) -> str:
        """Name of the folder of its recordings."""
        words = [f"{self.rate_hz:g}hz", f"{self.range_g:g}g", *(["temperature"] if self.temperature else [])]
        return "_".join([*words, *([] if self.uneven else ["even"]), self.zone.replace("/", "-")])

    def in_r(self) -> str:
        """Write it as a list of R; GGIR's epochs need a whole number of samples in a second."""
        uneven, temperature = (str(value).upper() for value in (self.uneven, self.temperature))
        rate = max(1, round(self.rate_hz))
        return (
            f'  list(folder = "{self.folder}", rate = {rate}, range = {self.range_g:g},\n'
            f'       temperature = {temperature}, uneven = {uneven}, zone = "{self.zone}")'
        )


def group_of(recording: Selected, about: CalibratedFile, resample_hz: float | None) -> Group:
    """Return the group of a recording."""
    measured = None if recording.held is None else recording.held["file_health"].get("rate_hz_measured")
    rate_hz = resample_hz or about.rate_hz
    even = resample_hz is not None or (measured is not None and isclose(measured, rate_hz, rel_tol=EVEN))
    uneven = not even or rate_hz != round(rate_hz)
    range_g = LEAST_RANGE_G if about.range_g is None else about.range_g
    return Group(rate_hz, range_g, about.has_temperature, uneven, r_zone(about) or UTC)


def plan(form: str, selected: Sequence[Selected], options: ExportOptions, *, force: bool) -> list[Made]:
    """Give each usable recording its file in a folder; others are made already, with their error.

    Recordings of the same name get those of their folders as well.

    Args:
        options: those of each recording; its `output` is the folder.

    Raises:
        OutputError: a file is there already.
    """
    folder, planned = options.output, []
    outputs: list[Path] = []
    suffix = SUFFIXES.get(form, ".csv.gz" if options.gzip else ".csv")
    usable = [(one, one.parquet) for one in selected if one.skipped is None and one.parquet is not None]
    for (one, parquet), name in zip(usable, _names([path for _, path in usable]), strict=True):
        try:
            about = described_file(parquet)
        except AccelcalError as error:
            planned.append(Made(Planned(one, _NOTHING, folder), error=error))
            continue
        place = folder / group_of(one, about, options.resample_hz).folder if form == "ggir" else folder
        outputs.append(place / (name + suffix))
        planned.append(Made(Planned(one, about, outputs[-1])))
    outputs += [folder / tool[form] for tool in (SCRIPTS, COEFFICIENT_FILES) if form in tool]
    if not force:
        refuse_existing(outputs)
    return planned


_NOTHING = CalibratedFile(Path(), 1.0, None, False, 0, False, {})


def _names(paths: Sequence[Path]) -> list[str]:
    """Return a name for each file that no other has, of as few of its folders as that needs."""
    parts = [(*path.absolute().parts[1:-1], path.name.removesuffix(PARQUET_SUFFIX)) for path in paths]
    depth = [1] * len(paths)
    while True:
        names = ["-".join(words[-number:]) for words, number in zip(parts, depth, strict=True)]
        twice = {name for name, count in Counter(name.casefold() for name in names).items() if count > 1}
        again = [index for index, name in enumerate(names) if name.casefold() in twice]
        if not any(depth[index] < len(parts[index]) for index in again):
            return names
        for index in again:
            depth[index] += 1


class _StoppedError(Exception):
    """The command ends before this recording was written."""


def export_folder(
    form: str, planned: Sequence[Made], options: ExportOptions, threads: int
) -> Generator[Made]:
    """Write all that is planned, and yield what became of each, in order."""
    stopped = Event()

    def go_on(_done: int) -> None:
        if stopped.is_set():
            raise _StoppedError

    def work(one: Made) -> Made:
        if one.error is not None:
            return one
        target = one.planned.output
        own, source = replace(options, output=target), one.planned.recording.parquet
        assert source is not None
        try:
            make_folder(target.parent)
            found = export_data(form, source, own, lambda _stage, _total: go_on)
        except (AccelcalError, _StoppedError) as error:
            failed = error if isinstance(error, AccelcalError) else UsageError("was stopped", path=target)
            return Made(one.planned, error=failed)
        return Made(one.planned, found)

    with closing(parallel_map(work, planned, threads)) as results:
        try:
            yield from results
        finally:
            stopped.set()


def write_script(form: str, made: Sequence[Made], options: ExportOptions) -> Path | None:
    """Write the tool's script for what was exported; return its path, None for a form without."""
    if form not in SCRIPTS:
        return None
    done = [one.planned for one in made if one.written is not None]
    if form == "ggir":
        groups = {group_of(one.recording, one.about, options.resample_hz) for one in done}
        text = ",\n".join(group.in_r() for group in sorted(groups))
    else:
        rate = options.resample_hz
        text = "\n".join(LINES[form](one.output.name, one.about, rate or one.about.rate_hz) for one in done)
    name = SCRIPTS[form]
    template = files("accelcal_cli.exports").joinpath("scripts", f"{name}.in").read_text("utf-8")
    path = options.output / name
    filled = template.replace("@version@", __version__).replace("@groups@", text).replace("@lines@", text)
    write_text(path, filled)
    return path


LINES: dict[str, Callable[[str, CalibratedFile, float], str]] = {
    "biobank": lambda name, about, _: f'process {shlex.quote(f"./{name}")} {r_zone(about) or UTC} "$@"',
    "actipy": lambda name, _, rate_hz: f"    {json.dumps(name)}: {rate_hz:.10g},",
    "skdh": lambda name, about, _: (
        f"    {json.dumps(name)}: {r_zone(about) or (UTC if about.utc else None)!r},"
    ),
}
"""Line of a recording in each script."""


def write_coefficients(form: str, made: Sequence[Made], folder: Path) -> list[str]:
    """Write the coefficients of what was exported, for those who keep their raw files.

    Returns:
        messages: recordings that are not among them, or whose coefficients may be over the limit.
    """
    if form not in COEFFICIENT_FILES:
        return []
    reports: dict[str, Any] = {}
    messages = []
    for one in made:
        report = one.planned.recording.report
        if one.written is None or report is None:
            continue
        try:
            found = coefficients.read_exported(report)
            if found.file_name in reports:
                text = f"not in {COEFFICIENT_FILES[form]}: another recording has the name {found.file_name}"
                messages.append(f"{report}: {text}")
            reports.setdefault(found.file_name, found)
            if (doubt := coefficients.over_limit(found)) is not None:
                messages.append(f"{COEFFICIENT_FILES[form]}: {report}: {doubt}")
        except AccelcalError as error:
            messages.append(f"not in {COEFFICIENT_FILES[form]}: {error}")
    text = coefficients.TABLES[form](list(reports.values()))
    write_text(folder / COEFFICIENT_FILES[form], text)
    return messages
