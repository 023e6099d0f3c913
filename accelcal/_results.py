"""Results that functions return: a report that shows itself, a result with its values, a calibration."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from os import PathLike
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from accelcal._calling import Answering, check_number, public, speaking_python, worded
from accelcal._sources import NAMES, AnyPath, Given, clock_times, in_local_time, transposed, values_of_result
from accelcal_cli.core import calibration as core
from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import OutputError, Reason, UsageError, printable
from accelcal_cli.core.identity import WINDOWS, identity
from accelcal_cli.core.recording import METADATA_KEY, Chunk
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.output import report as reports
from accelcal_cli.output.advice import page_verdict
from accelcal_cli.output.coefficients import calibration_of
from accelcal_cli.output.files import write_text
from accelcal_cli.output.numbers import number
from accelcal_cli.output.report import ReportInput
from accelcal_cli.output.report_reading import read_document
from accelcal_cli.output.sections import EQUATION, ReportView, report_view
from accelcal_cli.pipeline import export, jobs, survey
from accelcal_cli.pipeline.activity import EPOCH_S, LONGEST_EPOCH_S
from accelcal_cli.pipeline.calibrate import FirstPass
from accelcal_cli.pipeline.calibrate import calibrate as run_job
from accelcal_cli.pipeline.jobs import FileStamp, Job, Request

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    import pyarrow as pa
    import xarray as xr
    from matplotlib.axes import Axes

LARGEST_MC = 2.0e9
"""Temperature [thousandths of a degree C] that fits 32 bits."""

TEXT = re.compile(r"<(style|script)\b.*?</\1>|>[^<>]+<", re.DOTALL)
"""Text between the tags of a page. Styles and scripts are found whole, to be left alone."""

LINE = 160
"""Most characters of a line of a `repr`."""


class Calibration(Answering):
    """Coefficients, a = K (v + q v^2 + o + s (T - Tref)); call it with raw values.

    Args:
        report: a result, a report, or the path of one (NAME.calibration.json).

    Raises:
        AccelcalError: the report cannot be read, or has no calibration.

    Example:
        >>> import accelcal
        >>> found = accelcal.calibrate("sample_data/recording.bin").calibration
        >>> found([0.0, 0.0, 1.0], 25.0).shape
        (3,)
    """

    def __init__(self, report: Report | Mapping[str, Any] | AnyPath | None = None) -> None:
        if report is None:
            found = "a Calibration is found in a recording: accelcal.calibrate(xyz, rate=100).calibration"
            raise TypeError(f"{found}; or read from a report: accelcal.Calibration(PATH)")
        if isinstance(report, str | PathLike):
            report = read_document(Path(report)).report
        content = report.report if isinstance(report, Report) else report
        if content["calibration"] is None:
            raise UsageError(f"there is nothing to apply: {content['message']}")
        self._core: core.Calibration = calibration_of(content["calibration"])

    @property
    def gain(self) -> NDArray[np.float64]:
        """K, (3, 3)."""
        return self._core.gain()

    @property
    def offset(self) -> NDArray[np.float64]:
        """o, (3,) [g]."""
        return self._core.offset_g()

    @property
    def bend(self) -> NDArray[np.float64]:
        """q, (3,) [per g]; zeros for a response that was taken to be straight."""
        return self._core.bend_per_g()

    @property
    def slope(self) -> NDArray[np.float64]:
        """s, (3,) [g per degree C]; zeros where the offsets do not depend on temperature."""
        return self._core.slope_g_per_c()

    @property
    def reference_temperature(self) -> float | None:
        """Tref [degrees C]; None where the offsets do not depend on temperature."""
        return None if self._core.temperature is None else self._core.reference_c()

    _instead = "call it with raw values: calibration(xyz, temperature)"

    @property
    def model(self) -> str:
        """`9`, `6` or `3` parameters, with `T` if the offsets depend on temperature; `12` of six poses."""
        return self._core.model

    def __call__(
        self, xyz: ArrayLike, temperature: ArrayLike | None = None, *, first_sample: int = 0
    ) -> NDArray[np.float32]:
        """Calibrate raw values.

        Args:
            xyz: (n, 3) or (3,) raw acceleration [g].
            temperature: (n,) or one for all [degrees C], taken to the nearest thousandth; needed where
                the offsets depend on it. Rows whose temperature is NaN come out as NaN.
            first_sample: number of the first row in its recording, where the calibration follows a change.

        Returns:
            of the shape of `xyz` [g], the same bits as in the Parquet file.

        Raises:
            UsageError: it needs temperatures. ValueError: an array has another shape.
        """
        if METADATA_KEY.decode() in getattr(xyz, "attrs", {}):
            raise UsageError("these values are calibrated already", hint="give the raw ones")
        rows = np.asarray(xyz, np.float64)
        if rows.ndim not in (1, 2) or rows.shape[-1] != 3:
            raise ValueError(f"xyz has the shape {rows.shape}, not (n, 3) or (3,){transposed('xyz', rows)}")
        v = rows.reshape(-1, 3)
        warmth, unknown = self._warmth(temperature, len(v))
        transform = core.Transform.of(self._core, lsb_per_g=1.0)
        made = np.stack(transform.apply(core.RawRows(v, warmth, first_sample)), axis=1)
        made[unknown] = np.nan
        return made.reshape(rows.shape)

    def _warmth(
        self, temperature: ArrayLike | None, rows: int
    ) -> tuple[NDArray[np.int32] | None, NDArray[np.bool_]]:
        """Return temperatures [thousandths of a degree C], and which rows have none."""
        if self._core.temperature is None:
            return None, np.zeros(rows, np.bool_)
        if temperature is None:
            raise UsageError("the calibration needs temperatures", hint="give one for each row")
        given = np.asarray(temperature, np.float64)
        if given.shape not in ((), (1,), (rows,)):
            raise ValueError(f"temperature has the shape {given.shape}, not {(rows,)}")
        mc = np.rint(np.broadcast_to(given, (rows,)) * 1000)
        unknown = ~(np.abs(mc) <= LARGEST_MC)
        return np.where(unknown, 0, mc).astype(np.int32), unknown

    def __repr__(self) -> str:
        axes = zip("xyz", np.diag(self.gain), 1000 * self.offset, 1000 * self.slope, strict=True)
        lines = [
            f"  {axis}  gain {gain:.5f}  offset {offset:+.2f} mg"
            + ("" if self._core.temperature is None else f"  slope {slope:+.3f} mg per °C")
            for axis, gain, offset, slope in axes
        ]
        return "\n".join([f"<accelcal.Calibration of model {self.model}: {EQUATION}>", *lines])


class Report(Answering):
    """A verdict on a recording, on still-window means, or on a session of known orientations.

    Args:
        report: as the command writes it, or the path of one (NAME.calibration.json).

    Attributes:
        report: as the command writes it (docs/outputs.md); `self["calibration"]` is short for its keys.
    """

    def __init__(self, report: dict[str, Any] | AnyPath) -> None:
        self.report = read_document(Path(report)).report if isinstance(report, str | PathLike) else report

    def __getitem__(self, key: str) -> Any:
        return self.report[key]

    @property
    def outcome(self) -> str:
        """`calibrated`, `provisional`, `reduced_model`, `already_good` or `refused`."""
        return str(self.report["outcome"])

    @property
    def usable(self) -> bool:
        """True if the result can be used: there is a calibration."""
        return self.report["calibration"] is not None

    @property
    def reason(self) -> str:
        """Code of the reason for the outcome (docs/reasons.md)."""
        return str(self.report["reason"])

    @property
    def values(self) -> dict[str, Any]:
        """Values of the reason, by name."""
        return dict(self.report["values"])

    @property
    def message(self) -> str:
        """The reason for the outcome, in sentences."""
        return worded(str(self.report["message"]))

    @property
    def cautions(self) -> tuple[Reason, ...]:
        """Reasons not to trust the result without a look."""
        return tuple(Reason(**one) for one in self.report["cautions"])

    @property
    def advice(self) -> tuple[Reason, ...]:
        """Steps to take next."""
        return tuple(Reason(**one) for one in self.report["advice"])

    @property
    def calibration(self) -> Calibration:
        """The coefficients, which can be called with raw values; raises AccelcalError if it was refused."""
        return Calibration(self)

    @property
    def calibration_error_mg(self) -> float | None:
        """Expected error of the coefficients over all orientations [mg]; None if it is not known."""
        known = self.report.get("calibration_error_mg")
        return None if known is None else float(known["mean"])

    @property
    def view(self) -> ReportView:
        """The report as typed records."""
        return report_view(self.report)

    def summary(self) -> dict[str, Any]:
        """Return the recording's row in a study's table (docs/study.md)."""
        from accelcal_cli.output.quality import wear_hours
        from accelcal_cli.studies import summary
        from accelcal_cli.studies.records import Item

        path, worn = Path(self.view.recording.path), wear_hours(self.quality() or {})
        row = summary.of_report(Item(path.name, Job(path, path, path), ()), 0, self.report, {}, worn)
        return {name: value for name, value in row.items() if name != "exit_code"}

    def quality(self) -> dict[str, Any] | None:
        """Return the recording's error and state hour by hour (docs/quality.md); None if not known."""
        return None

    def quality_frame(self) -> pd.DataFrame | None:
        """Return the rows of `quality` as a data frame, by their start on the device's clock; None as there.

        A column such as `before_mg.p95` is `p95` of `before_mg`.
        """
        import pandas as pd

        if (held := self.quality()) is None:
            return None
        columns = {
            f"{name}.{part}" if part else name: values
            for name, column in held["rows"].items()
            for part, values in (column.items() if isinstance(column, dict) else [("", column)])
        }
        frame = pd.DataFrame(columns)
        return frame.assign(start=clock_times(frame["start"])).set_index("start")

    @public
    def to_html(self, path: AnyPath | None = None, *, force: bool = False) -> str:
        """Return the page of `accelcal report`, and write it if a path is given.

        Args:
            force: replace a file that accelcal did not write.

        Raises:
            OutputError: the file cannot be written, or a file of another program has its name.
        """
        from accelcal_cli.pages.recording import page
        from accelcal_cli.pages.write import refuse_foreign_page

        text = page(self.report, self.quality())
        if path is not None:
            refuse_foreign_page(Path(path), force=force)
            write_text(Path(path), text)
        return text

    def _repr_html_(self) -> str:
        from accelcal_cli.pages.recording import fragment

        shown = fragment(self.report, self.quality())
        return TEXT.sub(lambda found: found[0] if found[1] else worded(found[0]), shown)

    def __repr__(self) -> str:
        view = self.view
        verdict, recording = page_verdict(view), view.recording
        name = printable(recording.path.rpartition("/")[2])
        model = "no calibration" if view.calibration is None else f"model {view.calibration.model}"
        rate, said = recording.sample_rate_hz, (verdict.headline, *(verdict.error[:1] or [self.message]))
        about = [f"{recording.samples} samples", *([f"{number(rate)} Hz"] if rate else []), recording.format]
        use = ".calibration, .summary(), .to_html()" if self.usable else ".message, .advice, .to_html()"
        return "\n".join([
            f"<accelcal.{type(self).__name__} of {shorten(name, LINE)}: {self.outcome}, {model}>",
            f"  verdict    {shorten(worded(' '.join(said)), LINE)}",
            f"  recording  {', '.join(about)}",
            f"  cautions   {', '.join(one.code for one in self.cautions) or 'none'}",
            f"  use        {use}{self._more_uses}",
        ])  # fmt: skip

    _more_uses = ""

    @property
    def _instead(self) -> str:
        return "its coefficients are .calibration; give the recording that it is of"

    if not TYPE_CHECKING:

        def __iter__(self) -> Any:
            raise TypeError(
                f"a {type(self).__name__} is one object: use .to_pandas() and .report of a result"
            )

        def __array__(self, *_kind: Any, **_copy: Any) -> Any:
            raise TypeError('a result is not an array: use .to_pandas()[["x", "y", "z"]].to_numpy()')


class Result(Report):
    """One recording's calibration, and its values, calibrated.

    Attributes:
        report: as the command writes it (docs/outputs.md).
    """

    def __init__(
        self,
        report: dict[str, Any],
        data: ReportInput,
        request: Request,
        first_pass: FirstPass,
        given: Given,
        before: FileStamp | None,
    ) -> None:
        super().__init__(report)
        self._data, self._request, self._first_pass = data, request, first_pass
        self._given, self._before = given, before

    @property
    def source(self) -> Path:
        """Path of the recording; a name alone if the recording was in memory."""
        return self._given.job.source

    @property
    def from_memory(self) -> bool:
        """True if the recording was given as bytes, an array or a table."""
        return self._given.folder is not None

    _more_uses = ", .to_pandas(), .plot(), .windows(), .write(folder)"

    @property
    def _instead(self) -> str:
        raw = "the raw values" if self.from_memory else repr(str(self.source))
        return f"it has .to_pandas() with calibrated values, and .calibration; to begin again give {raw}"

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Yield the calibrated recording in pieces with the Parquet file's columns; reads the file again.

        Raises:
            AccelcalError: the recording was refused, changed while it was read, or cannot be read to its end.
        """
        import pyarrow as pa

        from accelcal_cli.output.columns import schema_of, values_of

        data, columns = self._data, export.columns_of(self._data)
        with speaking_python(), self._chunks(others=True) as chunks:
            schema = schema_of(columns, reports.parquet_metadata(data))
            for chunk, xyz in export.calibrated(chunks, export.transform_of(data), lambda _byte: None):
                values = zip(values_of(columns, chunk, xyz), schema, strict=True)
                arrays = [pa.array(part, item.type) for part, item in values]
                yield pa.record_batch(arrays, schema=schema)

    @contextmanager
    def _chunks(self, *, others: bool = False) -> Iterator[Iterator[Chunk]]:
        """Open the recording again, and yield its chunks, with other quantities; raises as `batches` does."""
        path, request = self._given.path, self._request
        if self._data.judgement.calibration is None:
            raise UsageError(f"there are no calibrated values: refused: {self.message}", path=path)
        jobs.check_unchanged(path, self._before)
        with survey.open_marked(path, request.options, request.threads, joined=request.joined) as reader:
            reader.with_others = others and bool(self._data.recording.others)
            yield reader.chunks(request.chunk_samples)

    @public
    def epochs(self, seconds: int = EPOCH_S, *, local: bool = False) -> pd.DataFrame:
        """Return measures of activity of the calibrated values by epoch; reads the file again.

        ENMO, MAD and the arm's angle have 95 % intervals, of what the calibration leaves uncertain. An epoch
        of which less than four fifths was measured is left out, as in `effect`.

        Args:
            seconds: length of an epoch, 1 to 3600.
            local: times in the recording's zone instead of UTC, if that is known.

        Returns:
            `enmo_mg`, `mad_mg` and `angle_deg` with their ends (`enmo_low_mg`, `enmo_high_mg`, ...),
            `temperature_c`, `samples`, and `worn` by the hour, with the start of the epoch as index.

        Raises:
            AccelcalError: as `batches` does; or no epoch was measured, as it is longer than the recording.
        """
        import pandas as pd

        from accelcal_cli.activity_effect import epochs

        check_number("seconds", seconds, 1, LONGEST_EPOCH_S, whole=True)
        with self._chunks() as chunks:
            frame = pd.DataFrame(epochs(chunks, self._data, int(seconds)))
        if frame.empty:
            what = f"less than four fifths of each epoch of {seconds} s was measured"
            raise UsageError(what, path=self.source, hint="give a smaller number of seconds")
        offset_s, quality = self._data.facts.utc_offset_s, self.quality()
        hours = pd.array([None] if quality is None else quality["rows"]["worn"], dtype="boolean")
        row = frame.pop("sample") // (len(hours) if quality is None else quality["row"]["samples"])
        frame["worn"] = hours.take(np.minimum(row, len(hours) - 1))
        times = pd.to_datetime(frame.pop("time_us") - MICROSECONDS * (offset_s or 0), unit="us")
        frame.index = pd.DatetimeIndex(times, name="time")
        if offset_s is None:
            return frame
        return in_local_time(frame.tz_localize("UTC"), self.view.recording.timezone if local else None)

    def to_arrow(self) -> pa.Table:
        """Return all calibrated values in memory (a week at 100 Hz: 1.3 GB); raises as `batches` does."""
        import pyarrow as pa

        return pa.Table.from_batches(self.batches())

    def to_pandas(self, *, local: bool = False) -> pd.DataFrame:
        """Return all calibrated values as a data frame, with `time` as index; raises as `batches` does.

        Args:
            local: times in the recording's zone instead of UTC, if that is known.
        """
        frame: pd.DataFrame = self.to_arrow().to_pandas().set_index("time")
        frame.attrs |= self._about
        return in_local_time(frame, self.view.recording.timezone) if local else frame

    def to_polars(self) -> pl.DataFrame:
        """Return all calibrated values as a polars data frame; raises as `batches` does."""
        import polars as pl

        return pl.DataFrame(self.to_arrow())

    def to_xarray(self) -> xr.Dataset:
        """Return all calibrated values as a dataset along `time` (UTC if the zone is known); needs xarray."""
        import xarray as xr

        table = self.to_arrow()
        along = {}
        for field in table.schema:
            unit = (field.metadata or {}).get(b"unit")
            about = {"units": unit.decode()} if unit else {}
            along[field.name] = ("time", table[field.name].to_numpy(), about)
        _, times, _ = along.pop("time")
        said = {name: json.dumps(about) for name, about in self._about.items()}  # as files of it can hold it
        return xr.Dataset(along, coords={"time": times}, attrs={"message": self.message, **said})

    @property
    def _about(self) -> dict[str, Any]:
        about = {name: self["recording"][name] for name in ("path", "sample_rate_hz")}
        return values_of_result(about, reports.result_json(self.report))

    def windows(self) -> pd.DataFrame:
        """Return all still windows and how each was used, with the columns of `calibrate --windows`."""
        from accelcal_cli.output.windows import arrow

        first = self._first_pass
        assert first.log is not None
        table: pd.DataFrame = arrow(first.log.table(self._data, first.points)).to_pandas()
        table.attrs[METADATA_KEY.decode()] = identity(WINDOWS)
        return table

    def quality(self) -> dict[str, Any] | None:
        """Return the error and state hour by hour (docs/quality.md); None with profile `paper`."""
        from accelcal_cli.output.quality import dumps_quality, quality_json

        made = self._first_pass.quality()
        return None if made is None else json.loads(dumps_quality(quality_json(made)))

    @public
    def write(self, folder: AnyPath | None = None, *, force: bool = False) -> tuple[Path | None, Path]:
        """Write the files of the command `calibrate` next to the recording, or into a folder.

        Returns:
            the Parquet file (None without calibrated values) and the report.

        Raises:
            OutputError: a file cannot be written, or a file of another program has its name.
            UsageError: the recording was in memory, and no folder is given.
        """
        if folder is None and self.from_memory:
            raise UsageError("the recording is in no folder", hint="give one: .write(FOLDER)")
        (job,) = jobs.plan([self._given.path], None if folder is None else Path(folder), None)
        job = replace(job, source=self.source)
        try:
            result = run_job(job, replace(self._request, force=force), source=self._given.path)
        except OutputError as error:
            if self.from_memory and error.path == job.report:
                error.hint = f"{NAMES}; or replace it with force=True"
            raise
        return result.parquet, job.report

    def plot(self, axes: Axes | None = None) -> Axes:
        """Plot `|a|` of still windows over time, before and after calibration; needs matplotlib.

        Args:
            axes: axes of matplotlib; None for new ones.

        Returns:
            the axes, with the verdict as title, the limit as a band and the time zone at the axis.
        """
        import matplotlib.pyplot as plt
        from matplotlib.dates import ConciseDateFormatter

        windows, zone = self.windows(), self.view.recording.timezone
        axes = plt.subplots(figsize=(9, 3.8))[1] if axes is None else axes
        time = windows["time"]
        if time.dt.tz is not None:
            time = time.dt.tz_convert(zone or "UTC").dt.tz_localize(None)
        axes.plot(time, windows["raw_g"], ".", markersize=2, color="0.6", label="before")
        if self.usable:
            axes.plot(time, windows["calibrated_g"], ".", markersize=2, color="C0", label="after")
        limit = self.view.setting("max_error_mg", DEFAULT.max_error_mg)
        axes.axhspan(1 - limit / 1000, 1 + limit / 1000, color="C2", alpha=0.15, label=f"1 g ± {limit:g} mg")
        axes.set_ylabel("|a| of still windows [g]")
        axes.set_xlabel(f"time ({zone or ('UTC' if windows['time'].dt.tz is not None else 'device clock')})")
        verdict = page_verdict(self.view)
        title = " ".join([f"{self._given.path.name}: {verdict.headline}", *verdict.error[:1]])
        axes.set_title(title, fontsize=9, wrap=True)
        formatter: Any = ConciseDateFormatter  # it has no types
        axes.xaxis.set_major_formatter(formatter(axes.xaxis.get_major_locator()))
        axes.legend(loc="upper right", fontsize=8)
        return axes
