"""Writes HDF5 recordings: /accel with its attributes, and what else a recording has."""

from __future__ import annotations

import io
from collections.abc import Iterable
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np

from accelcal_cli.core.clock import UniformClock, rate_fraction
from accelcal_cli.core.errors import OutputError
from accelcal_cli.core.formats import Encoder
from accelcal_cli.core.recording import Chunk, Recording

CHUNK_ROWS = 65_536
"""Rows of an HDF5 chunk."""

FILE_VERSIONS = ("earliest", "v110")
"""Versions of the format that the HDF5 library may use."""

EPOCH = datetime(1970, 1, 1)


def write(path: Path, recording: Recording, chunks: Iterable[Chunk]) -> None:
    """Write all chunks as datasets of gzip-packed HDF5 chunks.

    `/accel` (n, 3) holds the raw counts; `/temperature` (n,) degrees Celsius; `/gyro` (n, 3) raw
    counts; `/time` (n,) microseconds on the device's clock, only where times are not evenly spaced. The
    same recording gives the same bytes.

    Raises:
        OSError: the system does not let it be written.
        OutputError: HDF5 does not.
    """
    try:
        with path.open("wb+", buffering=0) as plain:
            target = _Target(plain)
            with h5py.File(target, "w", libver=FILE_VERSIONS) as file:
                writer = _Writer(file, recording)
                for chunk in chunks:
                    writer.append(chunk)
                    target.raise_failure()
            target.raise_failure()
    except (OSError, RuntimeError) as error:
        if isinstance(error, OSError) and error.strerror:
            raise
        what = f"cannot be written ({' '.join(str(error).split())[:200]})"
        raise OutputError(what, path=path, hint="check the free space and the permissions") from error


class _Target(io.RawIOBase):
    """A file that keeps failed writes until they are asked for: HDF5 would not survive them.

    Args:
        file: without a buffer, which would try to write again what failed, wherever HDF5 goes next.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._failure: OSError | None = None

    def raise_failure(self) -> None:
        """Raise the first failed write, if there was one."""
        if self._failure is not None:
            raise self._failure

    def readinto(self, buffer: Any) -> int:
        done = 0
        while done < len(buffer) and (data := self._file.read(len(buffer) - done)):
            buffer[done : done + len(data)] = data
            done += len(data)
        return done

    def write(self, data: Any) -> int:
        """Write, or keep the failure."""
        left = memoryview(data)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError as error:
            self._failure = self._failure or error
        return len(data)

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def truncate(self, size: int | None = None) -> int:
        """Set the file's size, or keep the failure."""
        try:
            return self._file.truncate(size)
        except OSError as error:
            self._failure = self._failure or error
            return size or 0


class _Writer:
    """Appends chunks to growing datasets."""

    def __init__(self, file: Any, recording: Recording) -> None:
        self._file = file
        self._recording = recording
        self._rate = rate_fraction(recording.rate_hz)
        self._rows = 0
        start = EPOCH + timedelta(microseconds=recording.start_us or 0)
        # Times count from a year before on the device's clock: numbers that count from 1970 are UTC.
        self._since = start if start == EPOCH else datetime(max(start.year - 1, 1971), 1, 1)
        self._since_us = (self._since - EPOCH) // timedelta(microseconds=1)

    def append(self, chunk: Chunk) -> None:
        """Add one chunk to every dataset that it has values for."""
        accel = self._dataset("accel", chunk.counts)
        if not self._rows:
            self._describe(accel)
        self._add(accel, chunk.counts)
        if chunk.temperature_mc is not None:
            degrees = (chunk.temperature_mc / 1000).astype(np.float32)
            self._add(self._dataset("temperature", degrees, units="C"), degrees)
        if chunk.gyro_counts is not None:
            steps = self._recording.gyro_dps_per_lsb or (1.0, 1.0, 1.0)
            self._add(self._dataset("gyro", chunk.gyro_counts, dps_per_lsb=steps[0]), chunk.gyro_counts)
        self._add_times(chunk)
        self._rows += len(chunk)

    def _describe(self, accel: Any) -> None:
        """State what the reader needs, and what is known of the device; unknown facts are left out."""
        about, start = self._recording, self._recording.start_us
        stated = {
            "sample_rate": float(about.rate_hz),
            "units": "counts",
            "lsb_per_g": float(about.lsb_per_g),
            "range_g": about.range_g,
            "start_time": None if start is None else (EPOCH + timedelta(microseconds=start)).isoformat(),
            "timezone": about.timezone,
            "serial": about.device.serial,
            "model": about.device.model,
            "firmware": about.device.firmware,
        }
        _set(accel, stated)

    def _dataset(self, name: str, values: Any, **attributes: Any) -> Any:
        """Return the dataset of this name, made when its first values come."""
        if name not in self._file:
            dataset = self._file.create_dataset(
                name,
                shape=(0, *values.shape[1:]),
                maxshape=(None, *values.shape[1:]),
                dtype=values.dtype.newbyteorder("<"),
                chunks=(CHUNK_ROWS, *values.shape[1:]),
                compression="gzip",
                compression_opts=1,
                shuffle=True,
                track_times=False,
            )
            _set(dataset, attributes)
        return self._file[name]

    def _add(self, dataset: Any, values: Any) -> None:
        start = len(dataset)
        dataset.resize(start + len(values), axis=0)
        dataset[start:] = values

    def _add_times(self, chunk: Chunk) -> None:
        """Write times, from the beginning on, once they leave the even grid."""
        times = chunk.clock.times(0, len(chunk))
        if "time" not in self._file:
            if np.array_equal(times, self._even(self._rows, self._rows + len(chunk))):
                return
            dataset = self._dataset("time", times, units=f"us since {self._since.isoformat()}")
            for start in range(0, self._rows, CHUNK_ROWS):
                self._add(dataset, self._even(start, min(start + CHUNK_ROWS, self._rows)) - self._since_us)
        self._add(self._file["time"], times - self._since_us)

    def _even(self, start: int, stop: int) -> Any:
        return UniformClock(self._recording.start_us or 0, 0, self._rate).times(start, stop)


def _set(dataset: Any, attributes: dict[str, Any]) -> None:
    for name, value in attributes.items():
        if isinstance(value, str) and value:
            raw = value.encode()
            dataset.attrs.create(name, raw, dtype=h5py.string_dtype("utf-8", len(raw)))
        elif value is not None and value != "":
            dataset.attrs[name] = value


ENCODER = Encoder(name="hdf5", suffix=".h5", write=write, gyroscope=True)
