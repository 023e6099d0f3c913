"""Calibrated samples in the forms that other tools read: text tables, arrays of numpy, BIDS, and Parquet.

All are streamed from the row groups of the Parquet file; arrays lie in unnamed temporary files until their
lengths are known.
"""

from __future__ import annotations

import gzip
import json
import re
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, StampClock, Stretches
from accelcal_cli.core.errors import UnreadableError, UsageError, output_error, printable
from accelcal_cli.core.gravity import STANDARD_GRAVITY
from accelcal_cli.core.local_time import UTC
from accelcal_cli.exports.rows import (
    LARGEST_RATIO,
    LEAST_RATIO,
    CalibratedFile,
    SampleRows,
    open_calibrated,
    resampled,
    smoothed,
    starts_in,
    width_for,
)
from accelcal_cli.exports.selection import refuse_outputs, why_excluded
from accelcal_cli.output import decisions
from accelcal_cli.output.columns import schema_of
from accelcal_cli.output.files import replacing, stored_schema
from accelcal_cli.parquet import Column, Memory, ParquetSink
from accelcal_cli.pipeline.jobs import ProgressMaker, no_progress

MOTION = re.compile(r"sub-[a-zA-Z0-9]+_(?:[a-z]+-[a-zA-Z0-9]+_)*task-([a-zA-Z0-9]+)_tracksys-([a-zA-Z0-9]+)_"
                    r"(?:[a-z]+-[a-zA-Z0-9]+_)*motion\.tsv")  # fmt: skip
"""Pattern of a name of Motion-BIDS, with task and tracking system."""

MOTION_EXAMPLE = "sub-01_task-freeliving_tracksys-wrist_motion.tsv"
COPIED_BYTES = 1 << 20
GZIP_LEVEL = 4


@dataclass
class ExportedData:
    """The written rows: their times, and the number of stretches without a gap.

    Attributes:
        resampled: True if they have a fixed rate.
        gzip: True if tables of text are compressed.
    """

    about: CalibratedFile
    stretches: int = 0
    resampled: bool = False
    gzip: bool = False
    _clock: Stretches = field(init=False)

    def __post_init__(self) -> None:
        self._clock = Stretches(round(MICROSECONDS / self.about.rate_hz))

    @property
    def rows(self) -> int:
        """Number of the rows."""
        return self._clock.samples

    @property
    def first_us(self) -> int:
        """Time of the first row [us]; 0 without any."""
        return self._clock.first_us or 0

    def count(self, rows: SampleRows) -> None:
        """Count the next rows."""
        last_us = self._clock.last_us
        found = starts_in(rows, last_us, self.about.rate_hz)
        self._clock.add(StampClock(rows.time_us), len(rows), found)
        self.stretches += len(found) + (last_us is None)

    @property
    def seconds(self) -> float:
        """Time from the first row to one period after the last [s], without resets of the clock."""
        return self._clock.span_us / MICROSECONDS + 1 / self.about.rate_hz


Table = Callable[[SampleRows, ExportedData], dict[str, pa.Array]]
"""Makes columns of text and numbers from rows that `ExportedData` has counted."""


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Options of an export.

    Attributes:
        resample_hz: a fixed rate; None: the original samples.
        measured_only: leave out rows that the device filled in, and those of damaged blocks.
        smooth: samples of a rolling mean; 0: the usual number for the rate; None: no mean.
        gzip: compress text tables.
        batch_rows: rows in memory at a time; the output does not depend on it.
    """

    output: Path
    resample_hz: float | None = None
    measured_only: bool = False
    smooth: int | None = None
    gzip: bool = False
    batch_rows: int = 1 << 17


def outputs_of(form: str, output: Path) -> tuple[Path, ...]:
    """Return all files of a form; raises UsageError for a name that it cannot have."""
    if form != "bids":
        if form in ("npz", "skdh") and output.suffix != ".npz":
            hint = f"give a name such as {printable(output.with_suffix('.npz'))}"
            raise UsageError("an array file has to end in .npz", path=output, hint=hint)
        return (output,)
    if MOTION.fullmatch(output.name) is None:
        raise UsageError("is not a Motion-BIDS name", path=output, hint=f"name it as in {MOTION_EXAMPLE}")
    stem = output.name.removesuffix("_motion.tsv")
    return (output, *(output.with_name(stem + end) for end in ("_channels.tsv", "_motion.json")))


def export_data(
    form: str, path: Path, options: ExportOptions, progress: ProgressMaker = no_progress
) -> ExportedData:
    """Write a calibrated Parquet file in another form.

    Raises:
        UnreadableError: it cannot be read, or is not one of ours.
        UsageError: the rate asked for is too far from its own, no row is left, or it is smoothed already.
        OutputError: an output cannot be written.
    """
    everything = form == "parquet" and options.resample_hz is None
    with open_calibrated(path, measured_only=options.measured_only, everything=everything) as source:
        about, shown = source.about, progress("reading", source.rows)
        about = about if everything else replace(about, more=())
        portions = _with_progress(source.portions(options.batch_rows), shown)
        if options.smooth is not None:
            about = _to_smooth(about, options.smooth)
            assert about.smoothed is not None
            portions = smoothed(portions, about.rate_hz, about.smoothed)
        if options.resample_hz is not None:
            if not LEAST_RATIO <= options.resample_hz / about.rate_hz <= LARGEST_RATIO:
                text = f"has {about.rate_hz:g} Hz, too far from {options.resample_hz:g}"
                raise UsageError(text, path=path, hint="choose another rate with --resample")
            portions = resampled(portions, about.rate_hz, options.resample_hz)
            about = replace(about, rate_hz=options.resample_hz)
        first = next(portions, None)
        if first is None:
            raise UsageError("no row would be left", path=path, hint="omit --measured-only")
        portions = chain([first], portions)
        with ExitStack() as stack:
            places = [stack.enter_context(replacing(place)) for place in outputs_of(form, options.output)]
            written = ExportedData(about, resampled=options.resample_hz is not None)
            written.gzip = options.gzip
            try:
                FORMS[form](places, options.output, portions, written)
            except OSError as error:
                raise output_error(error, options.output) from error
    return written


def export_file(
    form: str, path: Path, options: ExportOptions, progress: ProgressMaker = no_progress, *, force: bool
) -> ExportedData:
    """Write one file as `export_data` does; see `refuse_outputs` for what it is not written over.

    Raises UsageError if people excluded the recording from its study.
    """
    if (why := why_excluded(path, {})) is not None:
        raise UsageError(f"is not exported: {why}", path=path, hint=f"change {decisions.NAME} if it is to be")
    refuse_outputs(outputs_of(form, options.output), [path], force=force)
    return export_data(form, path, options, progress)


def _to_smooth(about: CalibratedFile, width: int) -> CalibratedFile:
    if about.smoothed is not None:
        text = f"is a rolling mean of {about.smoothed} samples already"
        raise UsageError(text, path=about.path, hint="omit --smooth, or export the calibrated recording")
    return replace(about, smoothed=width or width_for(about.rate_hz))


def _with_progress(portions: Iterator[SampleRows], shown: Callable[[int], None]) -> Iterator[SampleRows]:
    done = 0
    for rows in portions:
        yield rows
        done += len(rows)
        shown(done)


def r_zone(about: CalibratedFile) -> str | None:
    """Return the name that R has for the zone of a recording in UTC; None for the device's clock."""
    zone = about.recording.get("timezone")
    if not about.utc or not isinstance(zone, str):
        return None
    if "/" in zone or zone == UTC:
        return zone
    hours, rest = divmod(about.clock_ahead_s, 3600)
    return None if rest or not -12 <= hours <= 14 else f"Etc/GMT{-hours:+d}" if hours else UTC


def _iso(time_us: NDArray[np.int64], about: CalibratedFile) -> pa.Array:
    """Return ISO 8601, with Z if it is UTC: for GGIR's `rmc.*` arguments, actipy, stepcount, accProcess."""
    times = pc.utf8_replace_slice(_clock_text(time_us, "us"), 10, 11, "T")
    return pc.binary_join_element_wise(times, "Z", "") if about.utc else times


def _unix(time_us: NDArray[np.int64], about: CalibratedFile) -> pa.Array:
    """Return seconds since 1970 for GGIR, which R reads without a zone.

    They are those of the device's clock where R has no name for its zone (`r_zone`).
    """
    ahead_us = about.clock_ahead_s * MICROSECONDS if r_zone(about) is None else 0
    return pa.array((time_us + ahead_us) / MICROSECONDS)


def _device_iso(time_us: NDArray[np.int64], about: CalibratedFile) -> pa.Array:
    """Return times for accProcess, which takes them for those of the device's clock, and its zone."""
    return _clock_text(time_us + _ahead_us(about), "us")


def _device_ms(time_us: NDArray[np.int64], about: CalibratedFile) -> pa.Array:
    """Return times of the device's clock to a ms, as MIMSunit reads mHealth."""
    return _clock_text((time_us + _ahead_us(about) + 500) // 1000, "ms")


def _ahead_us(about: CalibratedFile) -> int:
    """Return how far the device's clock is ahead of the times [us]."""
    return about.clock_ahead_s * MICROSECONDS if about.utc else 0


@dataclass(frozen=True, slots=True)
class TextForm:
    """A table of text: times, acceleration [g], and maybe temperature [degrees C] (docs/exports.md).

    Attributes:
        names: of the time and the axes.
        times: makes the column of times.
        warm: it has the temperature, where there is one.
    """

    names: tuple[str, ...]
    times: Callable[[NDArray[np.int64], CalibratedFile], pa.Array]
    warm: bool = False

    def __call__(
        self, places: Sequence[Path], _output: Path, portions: Iterator[SampleRows], written: ExportedData
    ) -> None:
        """Write the table."""
        names = [*self.names, *(["temperature"] if self.warm and written.about.has_temperature else [])]
        _text(places[0], names, portions, written, self._columns)

    def _columns(self, rows: SampleRows, written: ExportedData) -> dict[str, pa.Array]:
        times = {"time": self.times(rows.time_us, written.about)}
        return times | _axes(rows.xyz) | (_celsius(rows) if self.warm else {})


def bids(places: Sequence[Path], output: Path, portions: Iterator[SampleRows], written: ExportedData) -> None:
    """Write Motion-BIDS: `_motion.tsv` without a head, `_channels.tsv` and `_motion.json`.

    The first channel is the latency [s]: it shows gaps. Accelerations are in m/s^2.
    """
    motion, channels, sidecar = places
    _text(motion, None, portions, written, _motion)
    lines = [("name", "component", "type", "tracked_point", "units", "sampling_frequency")]
    rate = f"{written.about.rate_hz:.10g}"
    lines.append(("latency", "n/a", "LATENCY", "n/a", "s", rate))
    lines += [(f"acc_{axis}", axis, "ACCEL", "wrist", "m/s^2", rate) for axis in "xyz"]
    if written.about.has_temperature:
        lines.append(("temperature", "n/a", "MISC", "wrist", "oC", rate))
    channels.write_text("".join("\t".join(line) + "\n" for line in lines), "utf-8", newline="\n")
    text = json.dumps(_sidecar(output, written, len(lines) - 1), indent=2)
    sidecar.write_text(text + "\n", "utf-8", newline="\n")


def _motion(rows: SampleRows, written: ExportedData) -> dict[str, pa.Array]:
    seconds = (rows.time_us - written.first_us) / MICROSECONDS
    # BIDS takes SI units, in which g is the gram.
    metres = (rows.xyz.astype(np.float64) * STANDARD_GRAVITY).astype(np.float32)
    return {"latency": pa.array(seconds), **_axes(metres), **_celsius(rows)}


def _sidecar(output: Path, written: ExportedData, channels: int) -> dict[str, Any]:
    motion = MOTION.fullmatch(output.name)
    assert motion is not None
    about = written.about
    device = about.recording.get("device")
    device = device if isinstance(device, dict) else {}
    known = {"ManufacturersModelName": device.get("model"), "DeviceSerialNumber": device.get("serial")}
    return {
        "TaskName": motion[1],
        "TrackingSystemName": motion[2],
        "SamplingFrequency": written.about.rate_hz,
        "SamplingFrequencyEffective": round(written.rows / written.seconds, 6),
        "RecordingDuration": round(written.seconds, 6),
        "MotionChannelCount": channels,
        "ACCELChannelCount": 3,
        "LATENCYChannelCount": 1,
        **({"MISCChannelCount": 1} if written.about.has_temperature else {}),
        "MissingValues": "n/a",
        **({"RollingMeanSamples": about.smoothed} if about.smoothed else {}),
        "TrackedPointsCount": 1,
        **{name: value for name, value in known.items() if value},
    }


def _clock_text(values: NDArray[np.int64], unit: str) -> pa.Array:
    """Return times since 1970 as `2024-03-04 00:00:00.040`, with all digits of the unit.

    This is faster than strftime.
    """
    return pa.array(values).cast(pa.timestamp(unit)).cast(pa.string())


def _axes(xyz: NDArray[np.float32]) -> dict[str, pa.Array]:
    return {axis: pa.array(np.ascontiguousarray(xyz[:, number])) for number, axis in enumerate("xyz")}


def _celsius(rows: SampleRows) -> dict[str, pa.Array]:
    return {} if rows.celsius is None else {"temperature": pa.array(rows.celsius, from_pandas=True)}


def _text(
    place: Path,
    names: Sequence[str] | None,
    portions: Iterator[SampleRows],
    written: ExportedData,
    table: Table,
) -> None:
    """Write a text table: with these names as its head and commas, or with tabs and without a head."""
    writer = None
    with ExitStack() as stack:
        file: IO[bytes] = stack.enter_context(place.open("wb"))
        if written.gzip:  # without a name and a time: the same bytes at any time of day
            packed = gzip.GzipFile("", "wb", GZIP_LEVEL, file, mtime=0)
            file = cast("IO[bytes]", stack.enter_context(packed))
        if names is not None:
            file.write((",".join(names) + "\n").encode())
        options = pa.csv.WriteOptions(
            include_header=False, delimiter="\t" if names is None else ",", quoting_style="none"
        )
        for rows in portions:
            written.count(rows)
            batch = pa.record_batch(table(rows, written))
            if names is None and rows.celsius is not None:
                words = pc.fill_null(batch.column("temperature").cast(pa.string()), "n/a")
                batch = batch.set_column(batch.schema.get_field_index("temperature"), "temperature", words)
            if writer is None:
                writer = pa.csv.CSVWriter(file, batch.schema, write_options=options)
            writer.write_batch(batch)
        if writer is not None:
            writer.close()


def npz(places: Sequence[Path], _output: Path, portions: Iterator[SampleRows], written: ExportedData) -> None:
    """Write arrays for skdh: `time` [s since 1970], `accel` (n, 3) [g], `fs` [Hz], maybe `temperature`.

    Not compressed. While it is written, the disk holds them twice.
    """
    kinds: dict[str, tuple[str, tuple[int, ...]]] = {"time": ("<f8", ()), "accel": ("<f4", (3,))}
    if written.about.has_temperature:
        kinds["temperature"] = ("<f4", ())
    with ExitStack() as stack:
        folder = places[0].parent
        files = {name: stack.enter_context(tempfile.TemporaryFile(dir=folder)) for name in kinds}
        for rows in portions:
            written.count(rows)
            columns = {"time": rows.time_us / MICROSECONDS, "accel": rows.xyz, "temperature": rows.celsius}
            for name, file in files.items():
                file.write(np.ascontiguousarray(columns[name], kinds[name][0]).tobytes())
        with zipfile.ZipFile(places[0], "w", zipfile.ZIP_STORED) as archive:
            for name, (kind, shape) in kinds.items():
                with _member(archive, name, kind, (written.rows, *shape)) as member:
                    files[name].seek(0)
                    shutil.copyfileobj(files[name], member, COPIED_BYTES)
            with _member(archive, "fs", "<f8", ()) as member:
                member.write(np.float64(written.about.rate_hz).tobytes())


def parquet(
    places: Sequence[Path], output: Path, portions: Iterator[SampleRows], written: ExportedData
) -> None:
    """Write all columns of the file, and note in its metadata what was done to x, y and z.

    Resampled rows have only these, time and temperature.
    """
    about, single = written.about, pa.float32()
    schema = stored_schema(about.path, UnreadableError)
    assert schema is not None
    names = ["time", *"xyz", *(["temperature"] if about.has_temperature else [])]
    names += [] if written.resampled else [*about.more, "validity"]
    units = {name: (schema.field(name).metadata or {}).get(b"unit", b"").decode() for name in names}
    types = {name: single if name in "xyz" else schema.field(name).type for name in names}
    timed = Column.timed("time", units["time"], types["time"])
    columns = [timed, *(Column(name, units[name], types[name], _never) for name in names[1:])]
    done: dict[str, Any] = {"smoothed": {"samples": about.smoothed}} if about.smoothed else {}
    done |= {"resampled_hz": about.rate_hz} if written.resampled else {}

    def fill(rows: SampleRows, memory: Memory) -> None:
        written.count(rows)
        values = dict(zip("xyz", rows.xyz.T, strict=True)) | {"temperature": rows.celsius} | rows.others
        for column, array in memory:
            array[:] = values[column.name]

    with ParquetSink(places[0], output, columns, schema_of(columns, {**about.metadata, **done})) as sink:
        for _ in sink.write(portions, fill):
            pass
        sink.close()


def _never(*_rows: Any) -> NDArray[Any]:
    raise AssertionError("rows are given as columns")


@contextmanager
def _member(archive: zipfile.ZipFile, name: str, kind: str, shape: tuple[int, ...]) -> Iterator[IO[bytes]]:
    """Open an array in an archive, begun with its head; the same bytes at any time of day."""
    info = zipfile.ZipInfo(f"{name}.npy")
    with archive.open(info, "w", force_zip64=True) as member:
        head = {"descr": kind, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(member, head)
        yield member


FORMS: dict[str, Callable[[Sequence[Path], Path, Iterator[SampleRows], ExportedData], None]] = {
    "csv": TextForm(("time", *"xyz"), _iso, warm=True),
    "ggir": TextForm(("time", *"xyz"), _unix, warm=True),
    "biobank": TextForm(("time", *"xyz"), _device_iso),
    "npz": npz,
    "actipy": TextForm(("time", *"xyz"), _iso, warm=True),
    "skdh": npz,
    "mhealth": TextForm(("HEADER_TIME_STAMP", *"XYZ"), _device_ms),
    "bids": bids,
    "parquet": parquet,
}
