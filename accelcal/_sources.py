"""Recordings as users have them: a path, bytes, an open file, an array, or a table of any library.

All but paths become temporary files, so that they are read and judged as a file of the same values is: the
results are the same bits. Such a file is named after what was given: `array`, `frame`, `table`, `columns`.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from os import PathLike
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Protocol, runtime_checkable
from weakref import finalize

import numpy as np
from numpy.typing import ArrayLike, NDArray

from accelcal_cli.core.errors import OutputError, UsageError
from accelcal_cli.core.identity import SAMPLES, identity, is_ours
from accelcal_cli.core.recording import METADATA_KEY, NOT_CALIBRATED
from accelcal_cli.core.system import new_folder, remove_folder
from accelcal_cli.pipeline.jobs import Job

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

AnyPath = str | PathLike[str]
NAME = re.compile(r"\w[\w .+()-]{0,99}")
NAMES = "give each recording a name: accelcal.calibrate(..., name='P001')"
OWN = "omit it: a file has its own"
BYTES = (bytes, bytearray, memoryview)
NOT_ROWS = (str, PathLike, Mapping, *BYTES)
"""Kinds of which a sequence holds several recordings, and not rows."""

ARGUMENTS = {"file", "allow_pickle"}
"""Names of columns that `numpy.savez` has for something else."""


@runtime_checkable
class SupportsArray(Protocol):
    """An array or a table of numpy, pandas, polars, xarray, torch and others."""

    def __array__(self) -> NDArray[Any]: ...


@runtime_checkable
class SupportsArrow(Protocol):
    """A table of pyarrow, polars, DuckDB and others."""

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object: ...


Times = ArrayLike | Sequence[datetime]
Source = (
    AnyPath
    | bytes
    | bytearray
    | memoryview
    | IO[bytes]
    | IO[str]
    | SupportsArray
    | SupportsArrow
    | Sequence[Sequence[float]]
    | Mapping[str, Times]
)
"""A recording: a path, the content of a file, an open file, (n, 3) values, or a table with columns."""


def check_channels(channels: Mapping[str, Any], rows: int) -> None:
    """Raise ValueError if a further channel of an array has another number of rows."""
    for name, one in channels.items():
        wanted = (rows, 3) if name == "gyroscope" else (rows,)
        if (shape := np.shape(one)) != wanted:
            raise ValueError(f"{name} has the shape {shape}, not {wanted}{transposed(name, one, rows)}")


def transposed(name: str, array: Any, rows: int | None = None) -> str:
    """Return what to type for an array that lies on its side; empty if it does not."""
    on_its_side = np.ndim(array) == 2 and len(array) == 3 and rows in (None, np.shape(array)[1])
    return f"; it lies on its side: give {name}.T" if on_its_side else ""


class Given:
    """A recording as a file.

    Attributes:
        path: of the user's file, or of a temporary one.
        folder: the folder of the temporary file, which is removed with `close` or when nobody uses this any
            more; None for the user's own file.
    """

    def __init__(self, path: Path, folder: Path | None = None) -> None:
        self.path, self.folder = path, folder
        self._removal = None if folder is None else finalize(self, _remove_own, folder, os.getpid())

    @property
    def job(self) -> Job:
        """The recording as a job; one that was in memory has a name, and no folder."""
        source = self.path if self.folder is None else Path(self.path.name)
        return Job(source, source, source)

    def __reduce__(self) -> tuple[Any, ...]:
        """Let a temporary file go along to another process."""
        if self.folder is None:
            return Given, (self.path,)
        return _unpacked, (self.path.name, self.path.read_bytes(), self.path.stat().st_mtime_ns)

    def close(self) -> None:
        """Remove the temporary file."""
        if self._removal is not None:
            self._removal()


def _remove_own(folder: Path, process: int) -> None:
    """Remove a folder, but not from a forked copy of the process that made it."""
    if os.getpid() == process:
        remove_folder(folder)


def _unpacked(name: str, content: bytes, changed_ns: int) -> Given:
    folder = new_folder()
    given = Given(folder / name, folder)
    given.path.write_bytes(content)
    os.utime(given.path, ns=(changed_ns, changed_ns))
    return given


def as_file(
    source: Source, name: str | None = None, serial: str | None = None, **channels: Times | None
) -> Given:
    """Return a source as a file.

    Args:
        channels: of an array: temperature (n,) [degrees C], gyroscope (n, 3) [degrees/s], time (n,).
        name, serial: of a recording in memory, and of its device.

    Raises:
        TypeError: it is nothing that holds a recording, or an object of this package.
        ValueError: an array has the wrong shape.
        UsageError: channels, a name or a serial number are given with what has its own.
        OutputError: there is no room for the temporary file.
    """
    refuse_own(source)
    extra = {key: column_of(key, one) for key, one in channels.items() if one is not None}
    given = [word for word, value in (("name", name), ("serial", serial)) if value is not None]
    if isinstance(source, str | PathLike):
        _refuse_channels(extra, "a file has its own")
        if given:
            raise UsageError(f"{' and '.join(given)} can be given to what is in memory", hint=OWN)
        return Given(Path(source))
    if name is not None and not (isinstance(name, str) and NAME.fullmatch(name)):
        raise UsageError(f"name cannot be {name!r}", hint="give a short one for a file, such as 'P001'")
    if serial is not None and not isinstance(serial, str):
        raise UsageError(f"serial cannot be {serial!r}", hint="give it as text, such as '0042'")
    try:
        folder = new_folder()
        try:
            return Given(_written(source, extra, folder, name, serial), folder)
        except BaseException:
            remove_folder(folder)
            raise
    except OSError as error:
        what = f"the values cannot be stored ({error.strerror or error})"
        raise OutputError(what, path=error.filename, hint="set TMPDIR to a disk with more space") from error


def paths_of(given: Any, instead: str) -> list[Path]:
    """Return one path or several as a list.

    Args:
        instead: what to call with what is in memory.

    Raises:
        TypeError: it is a table, an array or anything else in memory. UsageError: it is an empty list.
    """
    is_table = isinstance(given, Mapping) or hasattr(given, "columns") or hasattr(given, "_instead")
    single = isinstance(given, str | PathLike) or is_table or not isinstance(given, Iterable)
    if not (several := [given] if single else [*given]):
        raise UsageError("there is no path in an empty list", hint="give one or more")
    return [path_of(one, instead) for one in several]


def path_of(given: Any, instead: str) -> Path:
    """Return one path; raises TypeError for anything else, also for a list."""
    if not isinstance(given, str | PathLike):
        raise TypeError(f"a path is needed, not {type(given).__name__!r}: {instead}")
    return Path(given)


def texts_of(given: str | Sequence[str]) -> tuple[str, ...]:
    """Return one text or several as several."""
    return (given,) if isinstance(given, str) else tuple(given)


def clock_times(texts: pd.Series) -> pd.Series:
    """Return times as texts of reports as datetimes of the device's clock, without their offsets."""
    import pandas as pd

    return pd.to_datetime(texts.str.slice(0, len("2024-03-04T00:00:00.000000")))


def refuse_own(source: Any) -> None:
    """Raise TypeError, with what to call instead, for a result, an open recording or a report of accelcal."""
    said = getattr(source, "_instead", None)
    kind = "report" if isinstance(source, Mapping) else type(source).__name__
    if isinstance(source, Mapping) and is_ours(source):
        said = "its coefficients are applied by accelcal.apply(report, xyz)"
    if said is not None:
        raise TypeError(f"a {kind} of accelcal is not a recording: {said}")


def _written(source: Any, extra: dict[str, Any], folder: Path, name: str | None, serial: str | None) -> Path:
    """Write a source into a folder, and return the path of the new file."""
    device = {} if serial is None else {"serial": np.array(serial)}
    if isinstance(source, BYTES) or hasattr(source, "read"):
        _refuse_channels(extra, "a file has its own")
        if device:
            raise UsageError("serial can be given to arrays and tables", hint=OWN)
        return _spooled(source, folder, name)
    if names := getattr(getattr(source, "dtype", None), "names", None):  # records of numpy
        source = {name: source[name] for name in names}
    if isinstance(source, Mapping) and not hasattr(source, "data_vars"):  # a dataset of xarray is one, too
        _refuse_channels(extra, "name it among the columns")
        if not source:
            raise ValueError("there are no columns: give x, y, z and time")
        columns = {str(name): column_of(str(name), column) for name, column in source.items()}
        return _saved(folder / (name or "columns"), columns | device)
    if (table := arrow_of(source)) is not None:
        _refuse_channels(extra, "make it a column of the table")
        import pyarrow.feather

        path = folder / (name or ("frame" if hasattr(source, "head") else "table"))  # of pandas, or not
        _refuse_values_of_result(table, path)
        if serial is not None:
            table = table.replace_schema_metadata({**(table.schema.metadata or {}), "serial": serial})
        pyarrow.feather.write_feather(table, str(path), compression="uncompressed")
        return path
    xyz = array_of(source)
    if "time" in getattr(source, "coords", ()) and "time" not in extra:  # of xarray
        extra["time"] = np.asarray(source.coords["time"])
    check_channels(extra, len(xyz))
    return _saved(folder / (name or "array"), {"xyz": xyz, **extra} | device)


def _saved(path: Path, arrays: dict[str, Any]) -> Path:
    """Write columns as an archive of NumPy, or as a table of Arrow if one is of Arrow.

    Raises:
        ValueError: one has neither one value nor as many rows as the others.
    """
    shapes = {name: np.shape(one) for name, one in arrays.items()}
    rows = max((max(shape) for shape in shapes.values() if shape), default=0)
    single = {name for name, shape in shapes.items() if not shape or shape[0] == 1 != rows}
    for name, shape in shapes.items():
        if name not in single and rows not in shape:
            raise ValueError(f"{name!r} has the shape {shape}, and the longest column {rows} rows")
    if all(isinstance(one, np.ndarray) for one in arrays.values()) and not arrays.keys() & ARGUMENTS:
        with path.open("wb") as file:
            np.savez(file, **arrays)
        return path
    import pyarrow as pa
    from pyarrow import feather

    about = {name: str(np.asarray(arrays[name]).item()) for name in single}
    whole = {name: _arrow_column(one, rows) for name, one in arrays.items() if name not in single}
    table = pa.table({name: one for name, one in whole.items() if one is not None})
    feather.write_feather(table.replace_schema_metadata(about), str(path), compression="uncompressed")
    return path


def _arrow_column(values: Any, rows: int) -> Any:
    """Return (n,) or (n, 3) values, or these on their side, as a column of Arrow; None for any other."""
    import pyarrow as pa

    if np.ndim(values) == 2:
        values = values.T if values.shape[0] == 3 != rows else values
        flat = pa.array(np.ascontiguousarray(values).ravel())
        return pa.FixedSizeListArray.from_arrays(flat, 3) if values.shape[1] == 3 else None
    return pa.array(values) if np.ndim(values) == 1 else None


def column_of(name: str, values: Any) -> Any:
    """Return values as an array of numpy, with NaN for what is masked; of Arrow if numpy would lose their
    zone, or make objects of them.

    Raises:
        UsageError: some times have a zone and some do not.
    """
    if isinstance(values, np.ma.MaskedArray):
        return _unmasked(values)
    kind = getattr(values, "dtype", getattr(values, "type", None))
    zone = getattr(kind, "tz", None) or getattr(kind, "time_zone", None)  # of pandas and Arrow, of polars
    try:
        array = None if zone else np.asarray(values)
    except ValueError:  # rows of different lengths
        array = np.asarray(values, object)
    if array is not None and array.dtype.kind != "O":
        return array
    import pyarrow as pa

    if array is not None and len({one.tzinfo is None for one in array.flat if isinstance(one, datetime)}) > 1:
        what, hint = f"some times in {name!r} have a zone and some do not", "give all of them one, or none"
        raise UsageError(what, hint=hint)
    values = values.combine_chunks() if isinstance(values, pa.ChunkedArray) else values
    try:
        return pa.array(values if array is None else array)
    except pa.ArrowException:  # numbers and texts
        return pa.array([None if one is None else str(one) for one in np.ravel(np.asarray(values))])


def _unmasked(values: Any) -> NDArray[Any]:
    """Return a masked array of numpy as a plain one, NaN or NaT where it is masked."""
    if not np.ma.is_masked(values):
        return np.asarray(values)
    values = values.astype(np.float64) if values.dtype.kind in "biu" else values
    empty = {"f": np.nan, "m": np.timedelta64("NaT"), "M": np.datetime64("NaT")}.get(values.dtype.kind)
    return np.asarray(values.filled(empty))


def _refuse_channels(extra: Mapping[str, Any], instead: str) -> None:
    if extra:
        raise UsageError(f"{' and '.join(extra)} can be given with an array only", hint=instead)


def _spooled(source: Any, folder: Path, name: str | None) -> Path:
    name = name or getattr(source, "name", None)
    path = folder / (Path(name).name if isinstance(name, str) and Path(name).name else "bytes")
    with path.open("wb") as file:
        if isinstance(source, BYTES):
            file.write(source)
        elif isinstance(source.read(0), str):
            file.write(source.read().encode())
        else:
            shutil.copyfileobj(source, file, 1 << 20)
    return path


def arrow_of(source: Any) -> pa.Table | None:
    """Return a table of any library as one of pyarrow; None if it has no columns with names."""
    import pyarrow as pa

    if type(source).__name__ == "LazyFrame":  # of polars
        source = source.collect()
    if hasattr(source, "data_vars"):  # a dataset of xarray
        source, about = source.to_dataframe().reset_index(), source.attrs
        source.attrs = about
    if isinstance(source, Mapping):
        return pa.table({str(name): column_of(str(name), column) for name, column in source.items()})
    if hasattr(source, "iloc") and hasattr(source, "columns"):  # pandas
        import pandas as pd

        if source.index.names == [None] and not pd.api.types.is_integer_dtype(source.index.dtype):
            source = source.rename_axis("time")
        held = [name for name in source.index.names if name is not None and name not in source.columns]
        source = source.reset_index(held) if held else source
        frame = source.rename(columns=str)
        for name in (name for name, kind in frame.dtypes.items() if isinstance(kind, pd.PeriodDtype)):
            frame = frame.assign(**{str(name): frame[name].dt.to_timestamp()})
        mixed = frame.columns[(frame.dtypes == "object") & frame.columns.is_unique]
        objects = {name: column_of(name, frame[name]) for name in mixed}
        table = pa.Table.from_pandas(frame.drop(columns=[*objects]), preserve_index=False)
        for name, column in objects.items():
            table = table.append_column(name, column)
        return table
    if isinstance(source, pa.RecordBatch):
        return pa.Table.from_batches([source])
    if hasattr(source, "__arrow_c_stream__") and not hasattr(source, "ndim"):
        return pa.table(source)
    return source.to_arrow() if hasattr(source, "to_arrow") else None


def values_of_result(recording: Mapping[str, Any], result: Mapping[str, Any]) -> dict[str, Any]:
    """Return the attributes by which a frame of calibrated values says what it holds, as Parquet does.

    They are short, since each frame that is made of it has a copy.
    """
    return {METADATA_KEY.decode(): {**identity(SAMPLES), "recording": recording, "result": result}}


def in_local_time(frame: pd.DataFrame, zone: str | None) -> pd.DataFrame:
    """Return a frame whose index is of moments with these as times of a zone, if one is known."""
    return frame if zone is None or getattr(frame.index, "tz", None) is None else frame.tz_convert(zone)


def _refuse_values_of_result(table: pa.Table, path: Path) -> None:
    """Raise UsageError for a result's values in a table that has lost what says so, as those of polars do."""
    types, about = {field.name: str(field.type) for field in table.schema}, table.schema.metadata or {}
    alike = [types.get(name) for name in (*"xyz", "validity")] == [*["float"] * 3, "uint8"]
    said = METADATA_KEY in about or b'"accelcal"' in about.get(b"pandas", b"")  # the attrs of a frame
    if alike and not said and len(table) and (table["validity"][0].as_py() or 0) < NOT_CALIBRATED:
        what = "has the columns and types of values that accelcal calibrated"
        hint = "give the raw recording; if these are raw values, omit the column validity"
        raise UsageError(what, path=path, hint=hint)


def array_of(source: Any, name: str = "xyz") -> NDArray[Any]:
    """Return (n, 3) numbers as an array.

    Raises:
        TypeError: they are not numbers. ValueError: they have another shape.
    """
    first = source[0] if isinstance(source, list | tuple) and source else None
    if isinstance(first, NOT_ROWS) or hasattr(first, "columns"):
        each = "several recordings: [accelcal.calibrate(one) for one in [...]]"
        raise TypeError(f"{each}; or all of a folder: accelcal.study(FOLDER, OUT)")
    array: NDArray[Any] | None = None
    with suppress(ValueError):  # rows of different lengths
        array = _unmasked(source) if isinstance(source, np.ma.MaskedArray) else np.asarray(source)
    if array is None or array.dtype.kind not in "iuf" or not array.ndim:
        raise TypeError(
            f"{type(source).__name__!r} is not a recording: give a path, (n, 3) numbers, or a table"
        )
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} has the shape {array.shape}, not (n, 3){transposed(name, array)}")
    return array
