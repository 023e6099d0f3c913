"""Jobs: which outputs belong to which recording, decided before any work; requests and results.

Also the identity of input files, and copies of inputs that can be read only once.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shlex
import stat
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from accelcal_cli.core.errors import OutputError, UnreadableError, UsageError, printable, unread
from accelcal_cli.core.formats import EACH, IF_GIVEN, UNUSED, ReadOptions, without
from accelcal_cli.core.input_files import ANY, ARCHIVES, files_of, is_pattern
from accelcal_cli.core.paths import is_file, is_folder
from accelcal_cli.core.paths import stat_or_none as look
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.settings import DEFAULT, EffectiveSettings, PoseSettings, Settings
from accelcal_cli.core.system import cpus, temporary_folder
from accelcal_cli.core.unpacking import plain_name
from accelcal_cli.formats import all_formats, is_export, refuse_unused, unused_options
from accelcal_cli.output.sections import ReportView, report_view
from accelcal_cli.pipeline.options import FolderRules, StatedOption, stated_options, with_stated

if TYPE_CHECKING:
    from accelcal_cli.output.coefficients import Coefficients
    from accelcal_cli.output.registry import RegistryEntry

STDIN = Path("-")
PARQUET_SUFFIX = ".calibrated.parquet"
UNCALIBRATED_SUFFIX = ".uncalibrated.parquet"
REPORT_SUFFIX = ".calibration.json"
INTEGERS_SUFFIX = ".integers.json"
DRAWS_SUFFIX = ".draws.json"
QUALITY_SUFFIX = ".quality.json"
PAGE_SUFFIX = ".html"
PARQUET, JSON = ".parquet", ".json"
DEFAULT_CHUNK_SAMPLES = 1 << 18

HASHED_BYTES = 1 << 22
"""Part [bytes] of a file that is hashed at a time; between parts a thread may wait for Python's lock."""

FileStamp = tuple[int, int]
"""Size [bytes] and time of the last change [ns since 1970] of a file."""

Progress = Callable[[int], None]
"""Called with the number of bytes of the file that have been read."""

ProgressMaker = Callable[[str, int], Progress]
"""Called with the name of a stage and the bytes to read; makes a Progress."""


def no_progress(_stage: str, _total: int) -> Progress:
    """Return a Progress that shows nothing."""
    return lambda _end_byte: None


@dataclass(frozen=True, slots=True)
class Job:
    """One recording, and the paths of its results."""

    source: Path
    parquet: Path
    report: Path

    @property
    def integers(self) -> Path:
        """Path of the fit's integers, if they are asked for."""
        return self._sibling(INTEGERS_SUFFIX)

    @property
    def draws(self) -> Path:
        """Path of plausible coefficients, if they are asked for."""
        return self._sibling(DRAWS_SUFFIX)

    @property
    def uncalibrated(self) -> Path:
        """Path of the raw values of a refused recording, if they are asked for."""
        return self._sibling(UNCALIBRATED_SUFFIX)

    @property
    def quality(self) -> Path:
        """Path of the recording's quality along time, if it has blocks of time."""
        return self._sibling(QUALITY_SUFFIX)

    @property
    def page(self) -> Path:
        """Path of the recording's page, if it is asked for."""
        return self._sibling(PAGE_SUFFIX)

    @property
    def outputs(self) -> tuple[Path, ...]:
        """All files that may be written."""
        return (self.parquet, self.report, self.integers, self.draws, self.quality, self.uncalibrated)

    def _sibling(self, suffix: str) -> Path:
        return self.report.with_name(self.report.name.removesuffix(REPORT_SUFFIX) + suffix)


def parquet_of(report: Path) -> Path | None:
    """Return the calibrated file next to a report; None if there is none of its name."""
    stem = report.name.removesuffix(REPORT_SUFFIX)
    paths = (report.with_name(name) for name in (stem + PARQUET_SUFFIX, stem + PARQUET, stem))
    return next((path for path in paths if path != report and is_file(path)), None)


def report_of(parquet: Path) -> Path:
    """Return where the report of a calibrated file is."""
    name = parquet.name.removesuffix(PARQUET_SUFFIX)
    return parquet.with_name(name.removesuffix(PARQUET) + REPORT_SUFFIX)


def resolved_path(path: Path) -> Path:
    """Return the absolute path without links.

    A loop of links, a path in a working folder that is gone, and a name that no file can have are kept.
    """
    try:
        return Path(os.path.realpath(path))
    except (FileNotFoundError, ValueError):
        return path


def stem(path: Path) -> str:
    """Return the file name without its suffixes (`.csv.gz`), or what a pattern names, or its folder."""
    if ANY in path.name and is_pattern(path):
        plain = re.sub(r"[._-]*\*", "", _without_suffix(path.name)).strip("._-")
        return plain or path.parent.name or "parts"
    return _without_suffix(path.name)


def _without_suffix(name: str) -> str:
    if (packed := next((one for one in ARCHIVES if name.lower().endswith(one)), None)) is not None:
        return name[: -len(packed)]
    name = plain_name(name)
    known = {suffix for item in all_formats() for suffix in item.suffixes}
    suffix = Path(name).suffix
    return name[: -len(suffix)] if suffix.lower() in known else name


def plan(sources: list[Path], output_dir: Path | None, output: Path | None) -> list[Job]:
    """Return the jobs in the order of the sources.

    Raises:
        UsageError: `output` with several recordings, a standard input named twice, or two
            recordings with one output; `output` has no name, or that of a file of another kind.
    """
    refuse_dash(output_dir)
    if output is not None and len(sources) > 1:
        raise UsageError("-o/--output names one file, but there are several recordings", hint="use -d")
    jobs = [_job(source, output_dir, output) for source in sources]
    _refuse_collisions(jobs)
    return jobs


def plan_report(source: Path, output_dir: Path | None, report: Path | None, *inputs: Path) -> Job:
    """Return the job of a command that writes a report and no Parquet.

    Args:
        report: name of the report, if not the usual one.
        inputs: further files that must not be written to.

    Raises:
        UsageError: an input would be overwritten, or the report's name is that of another kind of file.
    """
    refuse_dash(output_dir)
    job = _job(source, output_dir, None)
    if report is not None:
        refuse_overwriting((report,), (source, *inputs))
        refuse_misnamed(report, JSON)
        base = report.name.removesuffix(".json").removesuffix(".calibration")
        job = Job(source, report.with_name(base + PARQUET_SUFFIX), report)
    _refuse_collisions([job])
    refuse_overwriting((job.report,), inputs)
    return job


def refuse_nameless(output: Path) -> None:
    """Raise UsageError for an output whose name can only be that of a folder."""
    if output.name in ("", ".."):
        raise UsageError(f"{printable(output)!r} does not name a file", hint="give the name of a new file")
    refuse_dash(output)


def refuse_dash(output: Path | None) -> None:
    """Raise UsageError for `-`, which elsewhere means standard output: results are files."""
    if output == STDIN:
        raise UsageError("results are not written to standard output, but to files", hint="give a name")


def refuse_misnamed(output: Path, suffix: str) -> None:
    """Raise UsageError for an output without a name, or with one that promises another kind of file."""
    refuse_nameless(output)
    if output.suffix.lower() not in ("", suffix):
        hint = f"use {shlex.quote(printable(output.with_suffix(suffix)))}"
        if suffix == PARQUET:
            hint += "; for CSV, calibrate first and then use accelcal export --to csv"
        raise UsageError(f"{printable(output)} has to end in {suffix}", hint=hint)


def refuse_overwriting(outputs: Iterable[Path], inputs: Iterable[Path | None]) -> None:
    """Raise UsageError if an output would take the place of a file that is read."""
    places = {resolved_path(path) for path in outputs}
    for path in inputs:
        if path is not None and resolved_path(path) in places:
            raise UsageError(f"{printable(path)} would be overwritten by the output", hint="use -o or -d")


def _job(source: Path, output_dir: Path | None, output: Path | None) -> Job:
    if output is not None:
        refuse_overwriting((output,), (source,))
        refuse_misnamed(output, PARQUET)
        base = output.name.removesuffix(".parquet").removesuffix(".calibrated")
        return Job(source, output, output.with_name(base + REPORT_SUFFIX))
    if source == STDIN:
        folder, name = output_dir or Path(), "stdin"
    else:
        folder, name = output_dir or source.parent, stem(source)
    return Job(source, folder / (name + PARQUET_SUFFIX), folder / (name + REPORT_SUFFIX))


def _refuse_collisions(jobs: list[Job]) -> None:
    owners: dict[Path, Path] = {}
    for job in jobs:
        target = resolved_path(job.report)
        if target in owners:
            raise UsageError(
                f"{owners[target]} and {job.source} would both write {job.report}",
                hint="calibrate them separately with -d, or rename one",
            )
        owners[target] = job.source
        if job.source != STDIN and resolved_path(job.source) in (target, resolved_path(job.parquet)):
            raise UsageError(f"{job.source} would be overwritten by its own output", hint="use -o or -d")


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal; of parts, that of their lines `SHA-256  NAME`, by name.

    Raises:
        UnreadableError: one cannot be read.
    """
    if (files := files_of(path)) is not None:
        lines = (f"{sha256(one)}  {printable(one.name)}\n" for one in files)
        return hashlib.sha256("".join(lines).encode()).hexdigest()
    try:
        with path.open("rb") as file:
            digest, block = hashlib.sha256(), memoryview(bytearray(HASHED_BYTES))
            while size := file.readinto(block):
                digest.update(block[:size])
            return digest.hexdigest()
    except OSError as error:
        raise unread(error, path) from error


def file_stamp(path: Path) -> FileStamp | None:
    """Return the stamp of a file, or of all parts together; None if one cannot be looked at."""
    try:
        status = look(path)
    except OSError:
        return None
    if status is not None and not stat.S_ISDIR(status.st_mode):
        return status.st_size, status.st_mtime_ns
    if status is None and not is_pattern(path):
        return None
    try:
        found = [one.stat() for one in files_of(path) or ()]
    except (OSError, UnreadableError):
        return None
    return sum(one.st_size for one in found), max((one.st_mtime_ns for one in found), default=0)


def check_unchanged(path: Path, before: FileStamp | None) -> None:
    """Raise UnreadableError if a file changed, or went, since its stamp: what was read does not agree."""
    if before is not None and file_stamp(path) != before:
        raise UnreadableError(
            "changed while it was read",
            path=path,
            hint="try again when it is complete (study --settle SECONDS waits until then)",
        )


@contextlib.contextmanager
def spooled(stream: BinaryIO) -> Iterator[Path]:
    """Copy a stream to a temporary file, for the two passes; remove it at the end.

    Raises:
        OutputError: there is no room for it.
    """
    import shutil  # few runs read standard input

    with contextlib.ExitStack() as stack:
        try:
            path = stack.enter_context(temporary_folder()) / "stdin"
            with path.open("wb") as file:
                shutil.copyfileobj(stream, file, 1 << 20)
        except OSError as error:
            raise OutputError(
                f"standard input cannot be stored ({error.strerror or error})",
                path=error.filename,
                hint="set TMPDIR to a disk with more space",
            ) from error
        yield path


@dataclass(frozen=True, slots=True)
class Request:
    """The options of a run.

    Attributes:
        settings: those of a session with known orientations, or of any other recording.
        poses: a file that lists a session's poses; None: the six faces are found.
        coefficients: those to apply, None to find the recording's own.
        registry: good calibrations of devices, for recordings that cannot be calibrated by themselves.
        any_device: apply them to recordings of any device.
        report_only: write no Parquet.
        keep_refused: write the raw values of a recording that is refused.
        integers: also write the fit's points and result as integers.
        draws: how many plausible coefficient sets are also written.
        windows: where all still windows go; None: nowhere.
        effect: also find what the calibration changes in measures of activity.
        force: overwrite what accelcal did not write, and redo what is up to date.
        command: the command line, for the provenance.
        threads: how many may work at a time on one recording.
        several: the options are for several recordings; those that mean nothing for one are left out there.
        unused: of this recording's options those that mean nothing; its report names them.
        rules: reading options by name, of `study.toml`.
        parts: a folder or a pattern stands for the parts of one recording.
        joined: so do the recordings in an archive, whatever their names.
        may_replace_result_of_deleted: a result of a recording that is gone gives way to that of another.
        ignore_sidecars: what files next to the recording state does not count, only the reading options do.
        each: the sensor that stands for `each`: in a study one of the file's, None in a file of one.
    """

    options: ReadOptions = field(default_factory=ReadOptions)
    settings: Settings | PoseSettings = DEFAULT
    poses: Path | None = None
    chunk_samples: int = DEFAULT_CHUNK_SAMPLES
    report_only: bool = False
    keep_refused: bool = False
    integers: bool = False
    draws: int = 0
    windows: Path | None = None
    effect: bool = False
    force: bool = False
    command: tuple[str, ...] = ()
    coefficients: Coefficients | None = None
    registry: Sequence[RegistryEntry] | None = None
    any_device: bool = False
    threads: int = field(default_factory=cpus)
    several: bool = False
    unused: tuple[str, ...] = ()
    rules: tuple[FolderRules, ...] = ()
    parts: bool = False
    joined: bool = False
    ignore_sidecars: bool = False
    may_replace_result_of_deleted: bool = False
    each: str | None = EACH

    def options_of(self, path: Path) -> ReadOptions:
        """Return how a recording is read, by options and files next to it; raises UsageError on conflict."""
        return with_stated(self.options, self.choices_of(path), path)

    def choices_of(self, path: Path) -> dict[str, StatedOption]:
        """Return what files next to a recording state; raises UsageError if it contradicts the options."""
        said = {} if self.ignore_sidecars else stated_options(path, self.rules, self.options.layout)
        if "sensor" in said and said["sensor"].value == EACH:
            given = self.options.one_sensor or self.each  # one of them, if one is named
            said["sensor"] = replace(said["sensor"], value=given)
        return said

    def for_recording(self, path: Path, *, listing: bool = False) -> Request:
        """Return the request for one recording: with what files next to it state, and without options that
        are meant for others of several recordings.

        Args:
            listing: its sensors are to be listed.

        Raises:
            UnreadableError, UsageError: see `find_format` and `options_of`; or it is a folder, and parts are
                not asked for; or each sensor is asked for, outside a study.
        """
        if not self.parts and is_folder(path) and not is_export(path):
            hint = (
                f"to calibrate the recordings in it: accelcal study {shlex.quote(printable(path))} -d OUT; "
            )
            more = "if its files are parts of one recording, add --parts"
            raise UnreadableError("is a folder", path=path, hint=hint + more)
        said = self.choices_of(path)
        options = with_stated(self.options, said, path)
        if options.sensor == EACH and not listing:
            folder = shlex.quote(printable(path.parent))
            hint = f"use accelcal study {folder} -d OUT --sensor each, or name one with --sensor"
            raise UsageError("--sensor each works in a study", path=path, hint=hint)
        unused = unused_options(path, options) if self.several or said else ()
        unused = tuple(name for name in unused if self.several or name in said)
        return replace(
            self, options=without(options, unused), unused=unused or self.unused, ignore_sidecars=True
        )

    def for_jobs(self, planned: Sequence[Job]) -> Request:
        """Return the request for several recordings; raises UsageError for options without any meaning."""
        if len(planned) < 2:
            return self
        if all(job.source != STDIN for job in planned):
            refuse_unused([job.source for job in planned], self.options)
        return replace(self, several=True)

    @property
    def recording_settings(self) -> Settings:
        """The settings by which stillness is found and judged."""
        return self.settings.stillness if isinstance(self.settings, PoseSettings) else self.settings

    def effective_settings(self, companion: Path | None) -> EffectiveSettings:
        """Return all that decides the result besides the recording.

        Args:
            companion: the file that says how to read the recording; its content counts.
        """
        poses = (None, None) if self.poses is None else (self.poses.name, sha256(self.poses))
        used = input_settings(self.options, companion) | ({UNUSED: [*self.unused]} if self.unused else {})
        return EffectiveSettings(self.settings, self.report_only, used, poses, self.effect)


def input_settings(options: ReadOptions, companion: Path | None) -> dict[str, Any]:
    """Return the `input` object of a report's settings: what the user said of the recording."""
    stated = asdict(options)
    given = {name for name, value in stated.items() if value is not None and value is not False}
    used = {name: value for name, value in stated.items() if name not in IF_GIVEN or name in given}
    used["layout"] = None if companion is None else printable(companion.name)
    used["layout_sha256"] = None if companion is None else sha256(companion)
    used["columns"] = None if options.columns is None else list(options.columns)
    if options.gyro_columns is not None:
        used["gyro_columns"] = list(options.gyro_columns)
    return used


@dataclass(frozen=True, slots=True)
class Result:
    """One recording's report, and whether it was up to date already.

    Attributes:
        kept: whether the raw values were written, since it was refused.
    """

    job: Job
    report: dict[str, Any]
    up_to_date: bool = False
    kept: bool = False

    @property
    def view(self) -> ReportView:
        """Typed view of the report."""
        return report_view(self.report)

    @property
    def outcome(self) -> Outcome:
        """The report's outcome."""
        return Outcome(self.report["outcome"])

    @property
    def has_parquet(self) -> bool:
        """True if the calibrated recording was written too."""
        return self.report["calibration"] is not None and not self.report["settings"]["report_only"]

    @property
    def parquet(self) -> Path | None:
        """The Parquet file that was written; None if none was."""
        if self.kept:
            return self.job.uncalibrated
        return self.job.parquet if self.has_parquet else None
