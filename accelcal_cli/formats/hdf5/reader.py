"""HDF5 files of laboratories: what their datasets and attributes say, and their rows as chunks.

The names and attributes that are understood are listed in docs/hdf5-files.md. `Hdf5Reader` streams the
files of other layouts too, once it is known what to read.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core import recording
from accelcal_cli.core.clock import MICROSECONDS, Clock, StampClock, UniformClock, rate_fraction
from accelcal_cli.core.daylight import FOLLOWED
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.parallel import thread_pool
from accelcal_cli.core.recording import Channels, Chunk, Device, Problem, Reader, Recording
from accelcal_cli.formats._problems import ProblemLog, Run
from accelcal_cli.formats._stamps import GAP_PERIODS
from accelcal_cli.formats.hdf5 import description, units
from accelcal_cli.formats.hdf5 import file as h5
from accelcal_cli.formats.hdf5.channels import Axes, Channel, dps_per_lsb, find_channels
from accelcal_cli.formats.hdf5.datasets import Track, all_tracks, chosen_axes, find_accel
from accelcal_cli.formats.hdf5.description import Plan, Source, Timeline
from accelcal_cli.formats.hdf5.rows import REFUSE_ABOVE_BYTES, RowSelection, TrackRows
from accelcal_cli.formats.hdf5.storage import Stored
from accelcal_cli.formats.hdf5.times import RowTimes
from accelcal_cli.formats.hdf5.units import Scale

LSB_NAMES = ("lsb_per_g", "counts_per_g", "count_per_g", "lsbs_per_g", "sensitivity_lsb_per_g")
RANGE_NAMES = ("range_g", "accel_range_g", "full_scale_g", "dynamic_range_g")
SERIAL_NAMES = ("serial", "serial_number", "device_serial", "device_id", "sensor_id")
MODEL_NAMES = ("model", "device_model", "device", "device_type", "sensor_model")
FIRMWARE_NAMES = ("firmware", "firmware_version", "device_firmware")
ZONE_NAMES = ("timezone", "time_zone", "tz")

SINGLE = 100
"""Problems of a kind that are given one by one."""

PIECE_BYTES = 16 << 20
"""Of the datasets' values at a time, however many samples are wanted: wide numbers take memory."""

AHEAD = ("clock_gap", "jumps forward of the times")
BACK = ("clock_back", "jumps back of the times")


def open_recording(path: Path, options: ReadOptions) -> Hdf5Reader:
    """Open an HDF5 file whose acceleration is an (n, 3) dataset or three of length n.

    Raises:
        UnreadableError: damaged, cut short, or nothing in it is known as acceleration.
        UsageError: several datasets fit, or the rate, unit or counts per g are stated nowhere.
    """
    with h5.open_hdf5(path) as file, h5.h5py_guard(path, "list of datasets"):
        tracks, damaged = all_tracks(file)
        missing = h5.missing_bytes(file, path)
        with h5.explaining(path, missing, damaged), h5.h5py_guard(path, "description of the recording"):
            if options.columns is not None:
                group = chosen_axes(tracks, options.columns, path)
            else:
                group = find_accel(tracks, path, options.sensor)
            attributes = h5.attributes_of(file, group[0].path)
            return Hdf5Reader(_plan(Source(file, path, options, tracks, group, attributes, damaged)))


def _plan(source: Source) -> Plan:
    timeline = description.find_timeline(source)
    rate = description.checked_rate(timeline.rate_hz, source.path)
    accel = Axes(source.group, _scale(source))
    channels, notes = find_channels(source.file, source.tracks, source.accel, source.path)
    return Plan(
        recording=_recording(source, timeline, rate, accel, channels, notes),
        rows=source.accel.rows,
        accel=accel,
        stamps=timeline.stamps,
        channels=channels,
        problems=timeline.problems + description.header_problems(source.attributes, source.damaged),
        missing_bytes=h5.missing_bytes(source.file, source.path),
    )


def _recording(
    source: Source,
    timeline: Timeline,
    rate: float,
    accel: Axes,
    channels: dict[str, Channel],
    notes: tuple[str, ...],
) -> Recording:
    attributes = source.attributes
    rows = source.accel.rows
    zone, zone_notes = _zone(source, timeline)
    axes = [item for item in (accel, *channels.values()) if isinstance(item, Axes)]
    known = timeline.stamps is None and all(item.scale.exact is not None for item in axes)
    return Recording(
        path=source.path,
        format="hdf5",
        rate_hz=rate,
        lsb_per_g=accel.scale.lsb,
        total_bytes=source.path.stat().st_size,
        device=Device(
            attributes.text(*MODEL_NAMES), attributes.text(*SERIAL_NAMES), attributes.text(*FIRMWARE_NAMES)
        ),
        range_g=_range(attributes),
        start_us=timeline.start_us,
        timezone=zone,
        has_offsets=timeline.has_offsets,
        stamped=timeline.stamps is not None and not timeline.stamps.scale.base_us,
        samples=rows if known else None,
        duration_s=rows / rate if timeline.duration_s is None else timeline.duration_s,
        has_temperature="temperature_mc" in channels,
        gyro_dps_per_lsb=dps_per_lsb(channels),
        notes=timeline.notes + notes + zone_notes,
    )


def _range(attributes: h5.Attributes) -> float | None:
    value = attributes.number(*RANGE_NAMES)
    return value if value is not None and 0 < value <= 1000 else None


def _zone(source: Source, timeline: Timeline) -> tuple[str | None, tuple[str, ...]]:
    """The zone that the file states; times that are UTC for certain outweigh any name."""
    name = source.attributes.text(*ZONE_NAMES)
    zone = description.known_zone(name)
    if timeline.is_utc:
        place = name if zone is None else zone
        return "UTC", () if place in (None, "UTC") else (
            f"its times are UTC; it names the time zone {place}",
        )
    return zone, () if name is None or zone else (f"its time zone {name!r} is not known and was not used",)


def _scale(source: Source) -> Scale:
    """Counts or physical units: what the user says outweighs the attributes."""
    unit, lsb = _unit_and_lsb(source)
    dtype = np.result_type(*(item.dtype for item in source.group))
    if unit == "counts":
        return _count_scale(source, _checked_lsb(lsb, source.path), dtype)
    return units.physical_scale(unit, dtype)


def _unit_and_lsb(source: Source) -> tuple[str, float | None]:
    options = source.options
    file_unit, file_lsb = _shared_unit_and_lsb(source)
    lsb = file_lsb if options.lsb_per_g is None else options.lsb_per_g
    if options.unit is not None:
        return options.unit, lsb
    whole = all(item.dtype.kind in "iu" for item in source.group)
    if lsb is not None and (whole or file_unit is None):
        return "counts", lsb
    unit = "counts" if file_unit is None and whole else units.accel_unit(file_unit or "")
    if unit is not None:
        return unit, lsb
    what = f"the unit {file_unit!r} is not known" if file_unit else "the file does not state the unit"
    raise UnreadableError(
        f"{what} of {source.accel.path}", path=source.path, hint=f"give --unit {'|'.join(units.PER_G)}|counts"
    )


def _shared_unit_and_lsb(source: Source) -> tuple[str | None, float | None]:
    """Unit and counts per g in the attributes of the axes, which must not contradict each other."""
    attributes = [h5.attributes_of(source.file, item.path) for item in source.group]
    units = {found.text("units", "unit") for found in attributes} - {None}
    scales = {found.number(*LSB_NAMES) for found in attributes} - {None}
    if len(units) > 1 or len(scales) > 1:
        raise UnreadableError(
            "the axes have different units or counts per g", path=source.path, hint="give them one scale"
        )
    return next(iter(units), None), next(iter(scales), None)


def _checked_lsb(lsb: float | None, path: Path) -> float:
    if lsb is None:
        raise UnreadableError(
            "the file does not state the counts per g", path=path, hint="give --lsb-per-g N"
        )
    if not 0 < lsb <= recording.FLOAT_LSB_PER_G * units.LARGEST_G:
        raise UnreadableError(f"{lsb:g} counts per g cannot be right", path=path, hint="give --lsb-per-g N")
    return lsb


def _count_scale(source: Source, lsb: float, dtype: np.dtype[Any]) -> Scale:
    """Counts as they are; those with decimal fractions (averages) on the grid of fractions."""
    if dtype.kind == "f":
        for item in source.group:
            seen = description.spread_rows(source.file, item, source.path)
            seen = seen[np.isfinite(seen)]
            if np.any(seen != np.rint(seen)):
                return Scale(recording.FLOAT_LSB_PER_G, lsb, units.LARGEST_G)
    return units.count_scale(lsb, dtype)


class Hdf5Reader(Reader):
    """Streams the rows of a plan. The file is open only while a stream runs."""

    def __init__(self, plan: Plan) -> None:
        self.recording = plan.recording
        self._plan = plan
        self._stored: dict[str, Stored | None] = {}

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, from `chunk_samples` rows of the datasets at a time.

        Raises:
            UnreadableError: no row at all is usable, or the datasets cannot be reached.
        """
        delivered = 0
        with closing(self._pieces(0, self._plan.rows, chunk_samples)) as pieces:
            for chunk in pieces:
                delivered += len(chunk)
                yield chunk
        if not delivered:
            self._refuse()

    def _refuse(self) -> None:
        plan, path = self._plan, self.recording.path
        with h5.explaining(path, plan.missing_bytes):
            raise UnreadableError(
                f"none of the {plan.rows} rows of {plan.accel.tracks[0].path} is usable",
                path=path,
                hint="copy the file again from its source",
            )

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Yield up to `pieces` chunks spread evenly over the file."""
        rows = self._plan.rows
        if rows <= pieces * chunk_samples:
            yield from self.chunks(chunk_samples)
            return
        for piece in range(pieces):
            start = piece * rows // pieces
            yield from self._pieces(start, start + chunk_samples, chunk_samples)

    def _zone_of_stamps(self) -> str | None:
        return self.recording.timezone if self.recording.stamped else None

    def _pieces(self, start: int, stop: int, chunk_samples: int) -> Generator[Chunk, None, None]:
        path = self.recording.path
        with h5.open_hdf5(path) as file, thread_pool(self.threads, "hdf5") as pool:
            with h5.explaining(path, self._plan.missing_bytes), h5.h5py_guard(path, "datasets"):
                opened = partial(TrackRows, file, path=path, pool=pool, stored=self._stored)
                stream = _Stream(opened, self._plan, start, self._zone_of_stamps())
                stream.refuse_unbounded(path)
            step = max(1, min(chunk_samples, PIECE_BYTES // stream.row_bytes))
            for row in range(start, stop, step):
                yield stream.piece(row, min(row + step, stop), last=row + step >= stop)


def _message(run: Run) -> str:
    return run.event.text if run.event.code == FOLLOWED else f"{run.count} {run.event.text}"


class _Stream:
    """One run through the rows: what is carried from one chunk to the next."""

    def __init__(
        self, opened: Callable[[Track], TrackRows], plan: Plan, start: int, zone: str | None
    ) -> None:
        self._plan = plan
        self._rate = rate_fraction(plan.recording.rate_hz)
        self._accel = [*map(opened, plan.accel.tracks)]
        self._channels = {name: [*map(opened, channel.tracks)] for name, channel in plan.channels.items()}
        self._before: Channels = {}
        stamps = [opened(plan.stamps.track)] if plan.stamps else []
        self._times = RowTimes(stamps[0], plan.stamps, start, zone) if plan.stamps else None
        problems = plan.problems if start == 0 else ()
        self._log = ProblemLog(problems, _message, SINGLE, by_end=True)
        self._sample = start
        self._last_row: int | None = None
        self._last_time = 0
        sources = chain(self._accel, *self._channels.values(), stamps)
        self._sources = [*sources]
        self.row_bytes = sum(source.row_bytes for source in self._sources)

    def refuse_unbounded(self, path: Path) -> None:
        """Raise UnreadableError for chunks that would take too much memory together."""
        kept = sum(source.kept_bytes for source in self._sources)
        if kept > REFUSE_ABOVE_BYTES:
            raise UnreadableError(
                f"its datasets are packed in chunks of {kept >> 20} MB together, too large to unpack at once",
                path=path,
                hint="repack it with `h5repack -l CHUNK=65536x3` (`CHUNK=65536` for one axis)",
            )

    def piece(self, start: int, stop: int, last: bool) -> Chunk:
        """The usable ones among rows start..stop-1 of the datasets."""
        selection = RowSelection(start, stop, self.row_bytes)
        counts = self._plan.accel.values(self._accel, selection)
        channels = self._channel_values(selection)
        times = None if self._times is None else self._times.next(selection)
        rows = selection.rows()
        clock = self._clock(times, rows, selection)
        breaks, clock_jumps = self._breaks(times, rows, selection)
        for event in selection.events(self._log, self._sample):
            self._log.add(event)
        chunk = Chunk(
            first_sample=self._sample,
            counts=selection.kept(counts),
            clock=clock,
            end_byte=self._plan.recording.total_bytes * stop // self._plan.rows,
            breaks=breaks,
            clock_jumps=clock_jumps,
            problems=self._log.take(None if last else stop) + self._end(last, len(rows)),
            used_bytes=len(rows) * self.row_bytes,
            **{name: selection.kept(values) for name, values in channels.items()},
        )
        self._sample += len(rows)
        return chunk

    def _end(self, last: bool, rows: int) -> tuple[Problem, ...]:
        """With the last rows: that the file was cut short."""
        missing, total = self._plan.missing_bytes, self._plan.recording.total_bytes
        if not missing or not last:
            return ()
        what = f"the file is cut short: its last {missing} bytes are missing"
        return (Problem("truncated", what, total, self._sample + rows, missing),)

    def _channel_values(self, selection: RowSelection) -> Channels:
        """All rows of each channel."""
        channels: Channels = {
            name: channel.values(self._channels[name], selection, self._before.get(name))
            for name, channel in self._plan.channels.items()
        }
        self._before = recording.cut_channels(channels, [-1])
        return channels

    def _clock(
        self, times: NDArray[np.int64] | None, rows: NDArray[np.int64], selection: RowSelection
    ) -> Clock:
        """The times of the kept rows: their own, or by their place in the dataset."""
        if times is not None:
            return StampClock(selection.kept(times))
        even = UniformClock(self._plan.recording.start_us or 0, selection.start, self._rate)
        if len(rows) == len(selection.keep):
            return even
        return StampClock(selection.kept(even.times(0, len(selection.keep))))

    def _breaks(
        self, times: NDArray[np.int64] | None, rows: NDArray[np.int64], selection: RowSelection
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Where the kept rows do not follow on the ones before them, in place or time; where only in time."""
        if not len(rows):
            return recording.NO_BREAKS, recording.NO_BREAKS
        before = self._last_row
        every = len(rows) == len(selection.keep)
        jumps = np.zeros(len(rows), np.bool_) if every else np.diff(rows, prepend=rows[0]) != 1
        jumps[0] = before is not None and int(rows[0]) + selection.start != before + 1
        in_time = np.zeros(len(rows), np.bool_)
        if times is not None:
            in_time = self._time_jumps(times[rows], rows, jumps, selection)
        self._last_row = int(rows[-1]) + selection.start
        return np.flatnonzero(jumps | in_time), np.flatnonzero(in_time & ~jumps)

    def _time_jumps(
        self,
        times: NDArray[np.int64],
        rows: NDArray[np.int64],
        explained: NDArray[np.bool_],
        selection: RowSelection,
    ) -> NDArray[np.bool_]:
        """Where the times jump; a problem unless lost rows explain it."""
        longest = GAP_PERIODS * MICROSECONDS / self._plan.recording.rate_hz
        steps = np.diff(times, prepend=times[0] if self._last_row is None else self._last_time)
        self._last_time = int(times[-1])
        selection.note(AHEAD, rows[(steps > longest) & ~explained])
        selection.note(BACK, rows[steps < 0])
        return (steps > longest) | (steps < 0)
