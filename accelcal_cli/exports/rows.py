"""A calibrated Parquet file read back a portion at a time: times, x, y, z and temperature."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError, printable
from accelcal_cli.core.recording import Validity
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.zones import UTC
from accelcal_cli.output.files import metadata_of
from accelcal_cli.output.parquet import ParquetSource, described, stored_schema
from accelcal_cli.output.report import section

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
    """

    time_us: NDArray[np.int64]
    xyz: NDArray[np.float32]
    celsius: NDArray[np.float32] | None

    def __len__(self) -> int:
        return len(self.time_us)

    def part(self, start: int, stop: int) -> Rows:
        """Rows start..stop-1."""
        celsius = None if self.celsius is None else self.celsius[start:stop]
        return Rows(self.time_us[start:stop], self.xyz[start:stop], celsius)


@dataclass(frozen=True, slots=True)
class About:
    """What a calibrated file says of itself.

    Attributes:
        rate_hz: nominal sampling rate, or that of what is resampled.
        utc: times are in UTC; else the device's clock, of an unknown zone.
        clock_ahead_s: seconds that the device's clock is ahead of UTC; 0 where that is not known.
        has_temperature: whether rows have a temperature.
    """

    path: Path
    rate_hz: float
    range_g: float | None
    utc: bool
    clock_ahead_s: int
    has_temperature: bool
    recording: dict[str, Any]


class CalibratedRows:
    """An open calibrated file.

    Attributes:
        measured_only: leave out rows that the device filled in, and those of damaged blocks.
    """

    def __init__(self, source: ParquetSource, about: About, *, measured_only: bool) -> None:
        self._source, self.about, self.measured_only = source, about, measured_only
        self.rows = source.rows

    def portions(self, number: int) -> Iterator[Rows]:
        """All rows, at most so many at a time; none of the portions is empty.

        Raises:
            UnreadableError: the file is damaged.
        """
        while len((columns := dict(zip(self._source.names, self._source.take(number), strict=True)))["time"]):
            xyz = np.stack([columns[name] for name in "xyz"], axis=1).astype(np.float32, copy=False)
            rows = Rows(columns["time"], xyz, columns.get("temperature"))
            if self.measured_only:
                kept = ~np.isin(columns["validity"], NOT_MEASURED)
                celsius = None if rows.celsius is None else rows.celsius[kept]
                rows = Rows(rows.time_us[kept], xyz[kept], celsius)
            if len(rows):
                yield rows


@contextmanager
def calibrated_rows(path: Path, *, measured_only: bool = False) -> Iterator[CalibratedRows]:
    """Open a calibrated file.

    Raises:
        UnreadableError: it cannot be read, or accelcal did not write it.
    """
    about = _about(path)
    temperature = ("temperature",) if about.has_temperature else ()
    with ParquetSource(path, (*NAMES, *temperature, "validity")) as source:
        yield CalibratedRows(source, about, measured_only=measured_only)


def _about(path: Path) -> About:
    if not path.is_file():
        raise UnreadableError("is not a file that can be read", path=path, hint=NAME_ONE)
    said, schema = metadata_of(path), stored_schema(path)
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
    )


def _clock_ahead_s(start: Any) -> int:
    """The offset from UTC of an ISO time; 0 where it has none."""
    try:
        offset = datetime.fromisoformat(str(start)).utcoffset()
    except ValueError:
        return 0
    return 0 if offset is None else round(offset.total_seconds())
