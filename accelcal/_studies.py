"""The functions for many files: a study, exports, pages and simulated recordings."""

from __future__ import annotations

import sys
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing, nullcontext
from dataclasses import fields
from datetime import datetime
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack

from accelcal._calling import check_number, public, sentence, worded
from accelcal._options import StudyOptions
from accelcal._results import Report, Result
from accelcal._sources import NAMES, AnyPath, clock_times, path_of, paths_of, texts_of
from accelcal_cli.core.errors import AccelcalError, UsageError, counted
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.paths import is_file
from accelcal_cli.core.settings import Settings
from accelcal_cli.core.system import temporary_folder
from accelcal_cli.output.files import write_text
from accelcal_cli.pipeline import outputs
from accelcal_cli.pipeline.jobs import REPORT_SUFFIX, Request
from accelcal_cli.pipeline.options import chosen_settings, field_values, folder_rules, read_options
from accelcal_cli.run_log import LOG, run_log
from accelcal_cli.studies.records import FAILED, Item
from accelcal_cli.studies.study import Study, chosen_shard, with_learnt_prior

if TYPE_CHECKING:
    import pandas as pd

    from accelcal_cli.exports.data import ExportOptions

Coefficients = Literal["ggir", "biobank", "omconvert", "json"]
Data = Literal["actipy", "skdh", "csv", "npz", "mhealth", "bids", "parquet"]
SIMULATED = {
    "days": (0, 1e5), "rate_hz": (0.01, 1e5), "errors": (0, 100), "misalignment": (-100, 100),
    "noise_mg": (0, 1e5), "lsb_per_g": (1, 1e6), "range_g": (1, 1e4), "seed": (0, 2**32 - 1),
}  # fmt: skip
"""Bounds of the numbers of `simulate`."""

OUTPUT = "give the folder of a study's outputs"
VERIFIED = "write the result first: result.write(FOLDER)"
EXPORTED = "give results, or the output folder of a study"
LEAST_HZ = 1e-3
"""Lowest rate to resample to."""


@public
def study(
    folder: AnyPath | Sequence[AnyPath],
    output: AnyPath,
    *,
    include: str | Sequence[str] = (),
    exclude: str | Sequence[str] = (),
    jobs: int | None = None,
    executor: Executor | None = None,
    timeout: float | None = None,
    borrow: bool = False,
    pool: bool = False,
    report_only: bool = False,
    keep_refused: bool = False,
    retry_failed: bool = False,
    newer_than: datetime | None = None,
    decisions: AnyPath | None = None,
    keep_teaching: bool = False,
    html: bool = False,
    force: bool = False,
    prune: bool = False,
    shard: str | None = None,
    collect: bool = False,
    log: AnyPath | None = None,
    dry_run: bool = False,
    progress: bool | None = None,
    **options: Unpack[StudyOptions],
) -> pd.DataFrame:
    """Calibrate all recordings below a folder, as `accelcal study` does; resumes an earlier run.

    It can be called in a plain script, in a notebook and in threads: workers never run the calling program.

    Args:
        folder: the folder of the recordings, or several.
        output: folder into which the outputs are written.
        include, exclude: patterns of files to process and to leave out, such as `*.cwa`.
        jobs: workers; None for as many as CPUs and memory allow, 1 for this process alone.
        executor: finds each recording's own result instead: any executor of concurrent.futures, such as
            `client.get_executor()` of a Dask client.
        timeout: longest time for a recording [minutes].
        borrow: use the coefficients of the device's recording nearest in time where a recording cannot be
            calibrated well.
        pool: calibrate all recordings of a device together.
        report_only: write reports but no Parquet.
        keep_refused: write raw data of refused recordings, marked as raw.
        retry_failed: try again recordings that failed and have not changed since.
        newer_than: process only files that were modified since then.
        decisions: table of your decisions about recordings; None: decisions.csv in `output`.
        keep_teaching: let recordings that you excluded lend, pool and teach like others.
        html: also write the pages of the study and of its recordings.
        force: redo what is up to date, and replace files that accelcal did not write.
        prune: remove results whose recording is gone.
        shard: process one part only, such as `2/8`, or `slurm`: that of this job array task. The table is
            that of the part.
        collect: merge the results of all shards; a warning says how many recordings were not started.
        log: file to which a dated log of this run is added.
        dry_run: write nothing, and return what would be done instead: `path`, `state` (`todo`, `waiting`,
            `left_out` or the outcome that there is) and `why`.
        progress: show a bar; None: at a terminal and in a notebook.
        options: those of `calibrate`, for all recordings; `prior` may also be `study` or `device`.

    Returns:
        the table of the study, with a row for each recording (docs/study.md); `start_time` is a datetime of
        the device's clock.

    Raises:
        AccelcalError: the options do not go together, or the folder cannot be used.

    Example:
        >>> import accelcal, tempfile
        >>> with tempfile.TemporaryDirectory() as out:
        ...     table = accelcal.study("sample_data", out, include=["*.bin"], jobs=1, report_only=True)
        >>> table["outcome"].tolist()
        ['calibrated']
    """
    # few programs do both
    import pandas as pd

    from accelcal_cli.studies.discovery import Where
    from accelcal_cli.studies.run import run

    out = path_of(output, OUTPUT)
    if executor is not None and not isinstance(executor, Executor):
        raise TypeError("executor is a concurrent.futures.Executor, such as client.get_executor() of Dask")
    check_number("jobs", 1 if jobs is None else jobs, 1, 1024, whole=True)
    folders = tuple(paths_of(folder, "calibrate what is in memory one by one: accelcal.calibrate(frame)"))
    if files := [one for one in folders if is_file(one)]:
        inside = list(dict.fromkeys(str(one.parent if one in files else one) for one in folders))
        given = f"{inside[0] if len(inside) == 1 else inside!r}, {str(out)!r}"
        only = f", include={[escape(one.name) for one in files]!r}" if len(files) == len(folders) else ""
        what = "is a file: a study is of a folder"
        raise UsageError(what, path=files[0], hint=f"accelcal.study({given}{only})")
    values = field_values(options, ReadOptions, Settings)
    request = Request(
        options=read_options(values),
        settings=chosen_settings(values, in_study=True),
        report_only=report_only,
        keep_refused=keep_refused,
        force=force,
        several=True,
        command=("accelcal.study",),
        rules=folder_rules(folders),
        parts=True,
    )
    wanted = Study(
        Where(folders, out, texts_of(include), texts_of(exclude)),
        request,
        jobs=jobs,
        timeout_s=None if timeout is None else 60 * timeout,
        newer_than_s=None if newer_than is None else newer_than.timestamp(),
        retry_failed=retry_failed,
        shard=chosen_shard(
            {"shard": shard, "collect": collect, "prune": prune, "decisions": decisions, "html": html}
        ),
        collect=collect,
        borrow=borrow,
        pool=pool,
        prune=prune,
        decisions=None if decisions is None else Path(decisions),
        keep_teaching=keep_teaching,
        executor=None if executor is None else lambda: nullcontext(executor),
        in_process=jobs == 1 and timeout is None,
    )
    if dry_run:
        return _foreseen(wanted)
    path = None if log is None else Path(log)
    with closing(_Bar(progress)) as bar, run_log(path, "accelcal.study", _warn):
        summary = run(with_learnt_prior(wanted), bar)
    if collect and summary.waiting:
        _warn(f"{counted(summary.waiting, 'recording')} not started")
    if html:
        report(out, force=force)
    table = pd.read_parquet(out / f"{wanted.shard.basename}.parquet")
    return table.assign(start_time=clock_times(table["start_time"]))


def _foreseen(wanted: Study) -> pd.DataFrame:
    """Return what a study would do with each recording and each other file."""
    import pandas as pd

    from accelcal_cli.studies.run import preview

    states, left, again = preview(with_learnt_prior(wanted), _warn)
    rows = [(one.name, state, one.refusal or again.get(one.name)) for one, state in states.items()]
    rows += [(name, "left_out", sentence(why)) for name, why in left.items()]
    frame = pd.DataFrame(sorted(rows, key=lambda row: row[0]), columns=["path", "state", "why"])
    return frame.assign(why=frame["why"].map(worded, na_action="ignore"))


def _warn(text: str) -> None:
    warnings.warn(worded(text), stacklevel=5)


class _Bar:
    """Observer of a study that shows a bar, and counts failures in it."""

    def __init__(self, wanted: bool | None) -> None:
        terminal = sys.stderr is not None and sys.stderr.isatty()
        shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
        # in a Jupyter kernel, and not just where one could be started
        self._shown = (terminal or hasattr(shell, "kernel")) if wanted is None else wanted
        self._bar: Any = None
        self._failed = 0

    def begin(self, items: Sequence[Item]) -> None:
        """See `StudyObserver`; every round has its own bar."""
        if self._shown:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # without ipywidgets the bar is one of text
                from tqdm.auto import tqdm
            self.close()
            self._bar = tqdm(total=sum(item.size for item in items), unit="B", unit_scale=True, leave=False)

    def advance(self, bytes_done: float) -> None:
        """See `StudyObserver`."""
        if self._bar is not None:
            self._bar.update(bytes_done)

    def finished(self, item: Item, result: Any) -> None:
        """See `StudyObserver`."""
        self._failed += (result.entry.row or {}).get("outcome") == FAILED
        if self._bar is not None and self._failed:
            self._bar.set_postfix(failed=self._failed)

    def note(self, text: str) -> None:
        """See `StudyObserver`."""
        LOG.info("note: %s", text)

    def found(self, line: str, *, new: bool) -> None:
        """See `StudyObserver`."""
        LOG.info("to act on: %s", line)
        if new:
            _warn(line)

    def stopped(self, done: int) -> None:
        """See `StudyObserver`."""

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.close()


@public
def export(
    results: Result | AnyPath | Sequence[Result | AnyPath],
    *,
    to: Coefficients | Data,
    output: AnyPath | None = None,
    folder: AnyPath | None = None,
    gzip: bool = False,
    jobs: int | None = None,
    resample: float | None = None,
    smooth: int | Literal["auto"] | None = None,
    measured_only: bool = False,
    force: bool = False,
) -> str:
    """Write results in the form of another tool, as `accelcal export` does.

    Args:
        results: results, or paths of reports, of calibrated Parquet files or of output folders of studies.
        to: `ggir`, `biobank`, `omconvert` or `json`: coefficients, unless a folder is given; `actipy`,
            `skdh`, `csv`, `npz`, `mhealth`, `bids` or `parquet`: data.
        output: the new file; not needed for coefficients. How much accuracy other tools lose without
            misalignment is in each report (`without_misalignment`).
        folder: a folder for the data of all results, with a script for the tool.
        gzip: compress tables in the folder; jobs: recordings at a time, None for as many as CPUs.
        resample: new rate of the data [Hz].
        smooth: number of samples of a rolling mean over the data; `auto`: by the rate.
        measured_only: leave out rows of the data that were not measured.
        force: replace a file that is there.

    Returns:
        coefficients as text, or else the path of the file or the folder. Warnings name each recording that
        is skipped because it was refused, and temperatures that the tool cannot use.

    Raises:
        AccelcalError: there are no coefficients or no data, or a file cannot be written.

    Example:
        >>> import accelcal
        >>> text = accelcal.export(accelcal.calibrate("sample_data/evening.csv.gz"), to="ggir")
        >>> "evening.csv.gz" in text
        True
    """
    from accelcal_cli.exports.data import ExportOptions, export_file
    from accelcal_cli.exports.rows import WIDEST
    from accelcal_cli.exports.selection import COEFFICIENTS, check_form, refuse_other_kind

    data = {"resample": resample, "smooth": smooth, "measured_only": measured_only}
    check_form(to, {"gzip": gzip, "jobs": jobs, **data}, folder=folder is not None)
    if folder is not None and output is not None:
        raise UsageError("output names one file, and folder a folder", hint="give one of them")
    check_number("jobs", 1 if jobs is None else jobs, 1, 64, whole=True)
    check_number("resample", 1 if resample is None else resample, LEAST_HZ, 1e5)
    check_number("smooth", 2 if smooth in (None, "auto") else smooth, 2, WIDEST, whole=True)
    given = _results(results)
    _refuse_same_name([one for one in given if isinstance(one, Result)])
    width = 0 if smooth == "auto" else smooth
    text = folder is None and to in COEFFICIENTS
    with temporary_folder() as place:
        paths = [_file(one, place / str(n), data=not text) for n, one in enumerate(given)]
        for path in paths if folder is None else ():
            refuse_other_kind(path, to)
        if folder is not None:
            wanted = ExportOptions(Path(folder), resample, measured_only, width, gzip)
            return _folder(to, paths, wanted, jobs, force=force)
        if text:
            return _coefficients(to, paths, None if output is None else Path(output), force=force)
        if len(paths) != 1 or output is None or paths[0].is_dir():
            hint = "give one and output=FILE, or folder=DIR"
            raise UsageError("data are exported from one result into a file", hint=hint)
        export_file(to, paths[0], ExportOptions(Path(output), resample, measured_only, width), force=force)
        return str(Path(output))


def _results(given: Any) -> list[Result | Path]:
    """Return results and paths of results as a list; raises TypeError for anything else."""
    several = given if isinstance(given, list | tuple) else [given]
    found: list[Result | Path] = []
    for one in several:
        found += [one] if isinstance(one, Result) else paths_of(one, EXPORTED)
    return found


def _refuse_same_name(results: Sequence[Result]) -> None:
    """Raise UsageError if two recordings from memory have one name."""
    names = Counter(one.source for one in results if one.from_memory)
    for name in (name for name, count in names.items() if count > 1):
        raise UsageError(f"{names[name]} recordings have the name {str(name)!r}", hint=NAMES)


def _file(one: Result | AnyPath, folder: Path, *, data: bool) -> Path:
    """Return the file of a result, which is written into a folder if it has none."""
    if not isinstance(one, Result):
        return Path(one)
    if data:
        written, made = one.write(folder)
        return written or made
    source = one.source
    folder.mkdir()
    path = folder / f"{source.name}{REPORT_SUFFIX}"
    outputs.save_report(path, outputs.with_provenance(one.report, ("accelcal.export",), recording=source))
    return path


def _coefficients(form: str, paths: Sequence[Path], output: Path | None, *, force: bool) -> str:
    from accelcal_cli.exports import coefficients
    from accelcal_cli.exports.selection import refuse_outputs, select

    if output is not None:
        refuse_outputs((output,), paths, force=force)
    selected = select(paths, data=False)
    read, done = coefficients.read_for(form), []
    for one in selected:
        try:
            if one.report is None or one.skipped is not None:
                raise UsageError(one.skipped or "has no report", path=one.path)
            done.append(read(one.report))
        except AccelcalError as error:
            if len(selected) == 1:
                raise
            _warn(f"{error}; skipped")
    if not done:
        raise UsageError("none of the recordings has coefficients that can be exported")
    text = coefficients.TABLES[form](done)
    for one in done if form != "json" else ():
        for note in filter(None, (coefficients.over_limit(one), coefficients.temperature_note(one, form))):
            _warn(f"{one.file_name}: {note}")
    if output is not None:
        write_text(output, text)
    return text


def _folder(form: str, paths: Sequence[Path], wanted: ExportOptions, jobs: int | None, *, force: bool) -> str:
    from accelcal_cli.core.system import cpus
    from accelcal_cli.exports import folder
    from accelcal_cli.exports.selection import select

    selected = select(paths, data=True)
    planned = folder.plan(form, selected, wanted, force=force)
    made = list(folder.export_folder(form, planned, wanted, jobs or cpus()))
    skipped = [f"{one.path}: {one.skipped}" for one in selected if one.skipped is not None]
    for text in [*skipped, *(str(one.error) for one in made if one.error is not None)]:
        _warn(f"{text}; skipped")
    if not any(one.written for one in made):
        raise UsageError("none of the recordings has calibrated values that can be exported")
    for text in folder.write_coefficients(form, made, wanted.output):
        _warn(text)
    folder.write_script(form, made, wanted)
    return str(wanted.output)


@public
def report(what: Report | AnyPath, output: AnyPath | None = None, *, force: bool = False) -> Path:
    """Write an HTML page of a report or of a study, as `accelcal report` does.

    Args:
        what: a result, the path of a report, or the output folder of a study (all changed pages are written).
        output: path of the page; None: next to the report. Needed if `what` is a result.
        force: replace a file that accelcal did not write.

    Returns:
        the path of the page.

    Raises:
        AccelcalError: the report cannot be read, or the page cannot be written.
    """
    from accelcal_cli.pages import write

    if isinstance(what, Report):
        if output is None:
            raise UsageError("the page of a result needs a name", hint='give one: report(result, "x.html")')
        what.to_html(output, force=force)
        return Path(output)
    source = path_of(what, "calibrate it, and give the result")
    if source.is_dir():
        return write.write_study_pages(source, force=force).page
    page = write.page_of(source) if output is None else Path(output)
    write.refuse_foreign_page(page, force=force)
    write.write_page(source, page)
    return page


@public
def verify(
    report: AnyPath,
    recording: AnyPath | None = None,
    *,
    values: bool = False,
    layout: AnyPath | None = None,
    poses: AnyPath | None = None,
    coefficients: AnyPath | None = None,
) -> dict[str, Any]:
    """Reproduce a report from its recording and compare the two bit for bit, as `accelcal verify` does.

    Args:
        report: its path.
        recording: None for the one that the report names, next to the report or where it was.
        values: also compare every value of the Parquet file next to the report.
        layout, poses, coefficients: files that the report was made with, if they have moved.

    Returns:
        what `accelcal verify --json` prints; `result` is `identical` or `differs`.

    Raises:
        AccelcalError: one of the files cannot be read, or the recording is not that of the report.

    Example:
        >>> import accelcal, tempfile
        >>> with tempfile.TemporaryDirectory() as out:
        ...     _, report = accelcal.calibrate("sample_data/evening.csv.gz", report_only=True).write(out)
        ...     accelcal.verify(report, "sample_data/evening.csv.gz")["result"]
        'identical'
    """
    from accelcal_cli import verify as verification  # few programs do both

    own, others = path_of(report, VERIFIED), (recording, layout, poses, coefficients)
    given, *files = (None if one is None else path_of(one, VERIFIED) for one in others)
    options = verification.VerifyOptions(files[0], files[1], files[2], values)
    used = given or verification.recording_of(own)
    verified = verification.verify(own, used, options)
    return verification.as_json(own, used, verified)


@public
def devices(
    output: AnyPath,
    *,
    device: str | None = None,
    rules: Mapping[str, float] | None = None,
    registry: AnyPath | None = None,
) -> dict[str, Any]:
    """Judge the devices of a study: which of them drift or need service, and why, as `accelcal devices` does.

    Args:
        output: the output folder of the study.
        device: serial number of the only one that is wanted.
        rules: numbers of the rules by name, such as `{"drift_mg": 2}`.
        registry: a file to which the good calibrations are added; it is made if it is missing.

    Returns:
        what `accelcal devices --json` prints; `pandas.DataFrame(found["devices"])` has a row for each.

    Raises:
        AccelcalError: the folder holds no study, or there is no such device or rule.
    """
    from accelcal_cli.devices.review import as_json, chosen, review
    from accelcal_cli.devices.table import added
    from accelcal_cli.devices.trends import Rules, bounds_of

    out = path_of(output, OUTPUT)
    known = [one.name for one in fields(Rules)]
    for name, value in (rules or {}).items():
        if name not in known:
            raise UsageError(f"there is no rule {name!r}", hint=f"possible: {', '.join(known)}")
        check_number(f"rules[{name!r}]", value, *bounds_of(name))
    found = review(out, Rules(**(rules or {})), datetime.now().timestamp())
    made = as_json(found, chosen(found, device, out))
    if registry is not None:
        added(out, Path(registry))
    return made


@public
def simulate(
    output: AnyPath,
    *,
    format: str = "flash",
    days: float = 1.0,
    rate: float = 100.0,
    seed: int = 1,
    truth: int | None = None,
    errors: float = 1.0,
    misalignment: float = 1.0,
    temp_slope: tuple[float, float, float] = (0.0, 0.0, 0.0),
    noise_mg: float = 3.0,
    lsb_per_g: float = 256.0,
    range_g: float = 8.0,
    gyro: bool = False,
    no_temperature: bool = False,
    force: bool = False,
) -> tuple[Path, dict[str, Any]]:
    """Write a recording of simulated wrist wear, as `accelcal simulate` does.

    Args:
        output: the recording; the format's suffix is added if it is missing.
        format: flash, raw, csv, hdf5, cwa, geneactiv or gt3x.
        days: length of the recording; rate: samples per second [Hz].
        seed: random seed of movement and noise; truth: seed of the sensor's errors, None for `seed`.
        errors, misalignment: factors by which the sensor's errors are multiplied; 0 for a perfect sensor.
        temp_slope: change of the offsets of x, y, z [mg per degree C].
        noise_mg: standard deviation of the noise of each axis [mg].
        lsb_per_g: counts per g; range_g: range of the sensor [g].
        gyro: record a gyroscope too; no_temperature: record no temperature.
        force: replace files that are there.

    Returns:
        the recording's path, and the content of OUT.truth.json, which is written next to it.

    Raises:
        AccelcalError: the format cannot hold it, or a file cannot be written.
    """
    from accelcal_cli.simulate import plan_of
    from accelcal_cli.simulate import simulate as written

    values: dict[str, Any] = {
        "days": days, "rate_hz": rate, "seed": seed, "truth": truth, "errors": errors,
        "misalignment": misalignment, "temp_slope": temp_slope, "noise_mg": noise_mg, "lsb_per_g": lsb_per_g,
        "range_g": range_g, "gyro": gyro, "gyro_temp_slope": (0.0, 0.0, 0.0),
        "no_temperature": no_temperature,
    }  # fmt: skip
    for name, (low, high) in SIMULATED.items():
        check_number(name.removesuffix("_hz"), values[name], low, high)
    return written(Path(output), format, plan_of(values), force=force, progress=lambda _done: None)
