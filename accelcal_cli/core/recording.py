"""The records that flow from a reader to the rest: Recording, Chunk, Problem."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import Clock

Counts = NDArray[np.int16] | NDArray[np.int32]
NO_BREAKS: NDArray[np.int64] = np.empty(0, np.int64)

FLOAT_LSB_PER_G = float(1 << 24)
"""Counts per g given to values that arrive as decimal fractions: a grid of 0.06 micro-g."""


class Validity(IntEnum):
    """Where a row comes from, as in the Parquet column `validity`."""

    MEASURED = 0
    FILLED = 1
    CLIPPED = 2
    RECOVERED = 3


@dataclass(frozen=True, slots=True)
class Device:
    """Who recorded; None where the file does not say."""

    model: str | None = None
    serial: str | None = None
    firmware: str | None = None


@dataclass(frozen=True, slots=True)
class Recording:
    """What is known of a recording before its samples are read.

    Attributes:
        format: name of the format, as in `--format`.
        rate_hz: nominal sampling rate.
        lsb_per_g: raw counts in one g.
        range_g: the sensor clips at +- this; None where unknown.
        start_us: time of the first sample, microseconds since 1970 on the device's clock; None
            where the file has none (times then count from 1970-01-01).
        timezone: zone of the times, None where they are local times of an unknown zone.
        samples: number of samples, None where only reading everything would tell.
        duration_s: length from headers and first and last pages, None where unknown.
        gyro_dps_per_lsb: deg/s in one count of each gyroscope axis, None without a gyroscope.
        companion: a file beside the recording that says how to read it, such as a layout.
        notes: what a user should know of how the file was understood.
    """

    path: Path
    format: str
    rate_hz: float
    lsb_per_g: float
    total_bytes: int
    device: Device = Device()
    range_g: float | None = None
    start_us: int | None = None
    timezone: str | None = None
    samples: int | None = None
    duration_s: float | None = None
    has_temperature: bool = False
    gyro_dps_per_lsb: tuple[float, float, float] | None = None
    companion: Path | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Problem:
    """Something wrong with a file that did not stop its reading.

    Attributes:
        code: stable lower-case name, such as `checksum` or `truncated`.
        byte_offset: where in the file (in the uncompressed stream for .gz), None if unknown.
        sample: number of the first sample after the problem.
        count: how many units (pages, rows, bytes: as the message says) are concerned.
        lost_bytes: how many bytes of the (uncompressed) file could not be used because they are
            damaged; 0 for what is missing, repeated or normal.
    """

    code: str
    message: str
    byte_offset: int | None
    sample: int
    count: int = 1
    lost_bytes: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """A stretch of consecutive rows, at most a few hundred thousand of them; may be empty.

    Attributes:
        first_sample: number of row 0 within the recording.
        counts: (n, 3) int16 or int32, raw counts of x, y, z.
        clock: the rows' times.
        end_byte: how far into the file this chunk reaches, for progress.
        breaks: rows r in 0..n-1, ascending, before which the recording is not continuous (lost
            data, a jump of the clock); the recording's very first row is not one.
        temperature_mc: (n,) int32, thousandths of a degree Celsius, or None.
        gyro_counts: (n, 3) int16 or int32, or None.
        validity: (n,) uint8 of `Validity`, or None where all rows were measured.
        problems: what was found wrong while reading these rows.
        used_bytes: how many bytes of the (uncompressed) file these rows were made of, without
            headers and unused memory.
    """

    first_sample: int
    counts: Counts
    clock: Clock
    end_byte: int
    breaks: NDArray[np.int64] = field(default_factory=lambda: NO_BREAKS)
    temperature_mc: NDArray[np.int32] | None = None
    gyro_counts: Counts | None = None
    validity: NDArray[np.uint8] | None = None
    problems: tuple[Problem, ...] = ()
    used_bytes: int = 0

    def __len__(self) -> int:
        return len(self.counts)


class Reader:
    """An open recording: its description, and its samples as a stream that can be run again.

    A format subclasses this. `chunks` may be called several times; each call starts from the
    beginning, and the rows do not depend on `chunk_samples`. Problems travel with the chunks.

    Attributes:
        threads: how many may work at a time; a format may leave them unused.
    """

    recording: Recording
    threads: int = 1

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, about `chunk_samples` at a time (whole pages, at least one).

        Raises:
            UnreadableError: the file cannot be read on at all.
        """
        raise NotImplementedError

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Yield up to `pieces` chunks spread over the file where it can be entered anywhere.

        Each begins anew: rows of different pieces are not continuous. The default reads the
        first chunks.
        """
        for _, chunk in zip(range(pieces), self.chunks(chunk_samples), strict=False):
            yield chunk

    def close(self) -> None:
        """Release the file."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def as_json_device(device: Device) -> dict[str, Any]:
    """The report's `device` object."""
    return {"model": device.model, "serial": device.serial, "firmware": device.firmware}
