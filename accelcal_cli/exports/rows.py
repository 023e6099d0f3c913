"""A calibrated Parquet file read back a portion at a time: times, x, y, z, temperature, and others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import StampClock
from accelcal_cli.core.errors import UnreadableError, printable
from accelcal_cli.core.local_time import UTC
from accelcal_cli.core.recording import Validity
from accelcal_cli.core.results import Outcome
from accelcal_cli.output.columns import described
from accelcal_cli.output.files import metadata_of, stored_schema
from accelcal_cli.output.report_reading import section
from accelcal_cli.parquet import ParquetSource

NAMES = ("time", "x", "y", "z")
NAME_ONE = "name a Parquet file that accelcal wrote, STEM.calibrated.parquet"
NOT_MEASURED = (Validity.FILLED, Validity.RECOVERED)
"""What `--measured-only` leaves out; a clipped row was measured, and is as large as the sensor could say."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """n consecutive rows.

    Attributes:
        time_us: (n,) us since 1970.
        xyz: (n, 3) calibrated acceleration [g], float32.
        celsius: (n,) temperature [degrees C], float32; None without thermometer.
        others: (n,) further columns, by name; what is resampled has none.
    """

    time_us: NDArray[np.int64]
    xyz: NDArray[np.float32]
    celsius: NDArray[np.float32] | None
    others: dict[str, NDArray[Any]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.time_us)

    @property
    def clock(self) -> StampClock:
        """The times as a clock."""
        return StampClock(self.time_us)

    def part(self, start: int, stop: int) -> Rows:
        """Rows start..stop-1."""
        return self.kept(slice(start, stop))

    def kept(self, rows: Any) -> Rows:
        """Some of the rows: a slice or a mask."""
        celsius = None if self.celsius is None else self.celsius[rows]
        others = {name: values[rows] for name, values in self.others.items()}
        return Rows(self.time_us[rows], self.xyz[rows], celsius, others)

    @property
    def validity(self) -> NDArray[np.uint8]:
        """(n,) where each is from; measured where nothing says it."""
        marks = self.others.get("validity")
        return np.zeros(len(self), np.uint8) if marks is None else marks


def joined_rows(parts: Sequence[Rows]) -> Rows:
    """Rows that follow each other, at least one stretch of them."""
    if len(parts) == 1:
        return parts[0]
    celsius = [part.celsius for part in parts if part.celsius is not None]
    return Rows(
        np.concatenate([part.time_us for part in parts]),
        np.concatenate([part.xyz for part in parts]),
        np.concatenate(celsius) if len(celsius) == len(parts) else None,
        {name: np.concatenate([part.others[name] for part in parts]) for name in parts[0].others},
    )


@dataclass(frozen=True, slots=True)
class About:
    """What a calibrated file says of itself.

    Attributes:
        rate_hz: nominal sampling rate, or that of what is resampled.
        utc: times are in UTC; else the device's clock, of an unknown zone.
        clock_ahead_s: seconds that the device's clock is ahead of UTC; 0 where that is not known.
        has_temperature: whether rows have a temperature.
        more: names of the columns beside these, without `validity`.
        smoothed: samples of a rolling mean that the file says it has been through; None: of none.
        said: the file's metadata.
    """

    path: Path
    rate_hz: float
    range_g: float | None
    utc: bool
    clock_ahead_s: int
    has_temperature: bool
    recording: dict[str, Any]
    more: tuple[str, ...] = ()
    smoothed: int | None = None
    said: dict[str, Any] = field(default_factory=dict)


class CalibratedRows:
    """An open calibrated file.

    Attributes:
        measured_only: leave out rows that the device filled in, and those of damaged blocks.
    """

    def __init__(
        self, source: ParquetSource, about: About, more: Sequence[str] = (), *, measured_only: bool
    ) -> None:
        self._source, self._more, self.about, self.measured_only = source, more, about, measured_only
        self.rows = source.rows

    def portions(self, number: int) -> Iterator[Rows]:
        """All rows, at most so many at a time; none of the portions is empty.

        Raises:
            UnreadableError: the file is damaged.
        """
        while len((columns := dict(zip(self._source.names, self._source.take(number), strict=True)))["time"]):
            xyz = np.stack([columns[name] for name in "xyz"], axis=1).astype(np.float32, copy=False)
            others = {name: columns[name] for name in (*self._more, "validity")}
            rows = Rows(columns["time"], xyz, columns.get("temperature"), others)
            if self.measured_only:
                rows = rows.kept(~np.isin(rows.validity, NOT_MEASURED))
            if len(rows):
                yield rows


@contextmanager
def calibrated_rows(
    path: Path, *, measured_only: bool = False, everything: bool = False
) -> Iterator[CalibratedRows]:
    """Open a calibrated file.

    Args:
        everything: rows have all columns of the file.

    Raises:
        UnreadableError: it cannot be read, or accelcal did not write it.
    """
    about = _about(path)
    temperature = ("temperature",) if about.has_temperature else ()
    more = about.more if everything else ()
    with ParquetSource(path, (*NAMES, *temperature, *more, "validity")) as source:
        yield CalibratedRows(source, about, more, measured_only=measured_only)


def _about(path: Path) -> About:
    if not path.is_file():
        raise UnreadableError("is not a file that can be read", path=path, hint=NAME_ONE)
    said, schema = metadata_of(path, UnreadableError), stored_schema(path, UnreadableError)
    recording = section(said, "recording")
    if said.get("outcome") == Outcome.REFUSED:
        text = f"holds raw values, since its recording was refused ({said.get('message')})"
        raise UnreadableError(printable(text), path=path, hint="export a calibrated recording")
    rate_hz, range_g = recording.get("sample_rate_hz"), recording.get("range_g")
    if schema is None or not isinstance(rate_hz, int | float) or not 0 < rate_hz < 1e6:
        raise UnreadableError("is no calibrated recording of accelcal", path=path, hint=NAME_ONE)
    held = described(schema)
    if not {*NAMES, "validity"} <= held["columns"].keys():
        raise UnreadableError("lacks columns of a calibrated recording", path=path, hint=NAME_ONE)
    return About(
        path,
        float(rate_hz),
        float(range_g) if isinstance(range_g, int | float) else None,
        held["time_zone"] == UTC,
        _clock_ahead_s(recording.get("start_time")),
        "temperature" in held["columns"],
        recording,
        tuple(name for name in held["columns"] if name not in (*NAMES, "temperature", "validity")),
        section(said, "smoothed").get("samples"),
        said,
    )


def _clock_ahead_s(start: Any) -> int:
    """The offset from UTC of an ISO time; 0 where it has none."""
    try:
        offset = datetime.fromisoformat(str(start)).utcoffset()
    except ValueError:
        return 0
    return 0 if offset is None else round(offset.total_seconds())
