"""Reads a table: decides what to read and how (`plan_of`), and streams its rows as chunks (`TableReader`).

All formats of named columns share this. The names that are understood are listed in docs/tables.md and
docs/tables.md.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core import recording as recordings
from accelcal_cli.core.clock import MICROSECONDS, Clock, StampClock, UniformClock, rate_fraction, utc_offset_s
from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.local_time import FOLLOWED
from accelcal_cli.core.recording import Channels, Chunk, Device, Problem, Reader, Recording
from accelcal_cli.core.vocabulary import COUNTS, PER_G, TABLES, normalized
from accelcal_cli.formats._gravity import guess_unit, likely_counts, usual_length
from accelcal_cli.formats._problems import ProblemLog, Run
from accelcal_cli.formats._stamps import GAP_PERIODS, LOST
from accelcal_cli.formats._tables.channels import (
    LARGEST_G,
    Axes,
    Channel,
    CountScale,
    count_scale,
    dps_per_lsb,
    find_channels,
    physical_scale,
)
from accelcal_cli.formats._tables.divided import (
    ChosenRows,
    Divided,
    SensorRowsTable,
    chosen_rows,
    dividing_tracks,
)
from accelcal_cli.formats._tables.sensors import device_of
from accelcal_cli.formats._tables.table import (
    BLOCK_ROWS,
    REFUSE_ABOVE_BYTES,
    Attributes,
    Group,
    RowSelection,
    SensorTable,
    TableSource,
    Track,
    chosen_axes,
    find_accel,
    good_rows,
    is_in_group,
    readable,
    split_unit,
)
from accelcal_cli.formats._tables.times import (
    RowTimes,
    Stamps,
    TableTimeline,
    checked_rate,
    find_timeline,
    stored_stamps,
)
from accelcal_cli.formats._unsigned import FOUND_ZERO, are_unsigned, refuse_other_zero, zero_of

LEAST_LSB = 1e-9
"""Smallest believable number of counts in one g."""

LSB_NAMES = ("lsb_per_g", "counts_per_g", "count_per_g", "lsbs_per_g", "sensitivity_lsb_per_g")
RANGE_NAMES = ("range_g", "accel_range_g", "full_scale_g", "dynamic_range_g")
SERIAL_NAMES = ("serial", "serial_number", "device_serial", "device_id", "sensor_id")
MODEL_NAMES = ("model", "device_model", "device", "device_type", "sensor_model")
FIRMWARE_NAMES = ("firmware", "firmware_version", "device_firmware")
ZONE_NAMES = ("timezone", "time_zone", "tz")
LARGEST_RANGE_G = 1000.0
"""A stated range above this is not believed."""

SINGLE = 100
"""Problems of one kind that are given one by one; more are summed up."""

PIECE_BYTES = 16 << 20
"""Bytes of values that are read at a time, however many samples are wanted: wide numbers take memory."""

PLACES, PLACE_ROWS = 5, 1024
"""Places of a file that are looked at for its unit, and rows at each."""

AHEAD = ("clock_gap", "jumps forward of the times")
BACK = ("clock_back", "jumps back of the times")


@dataclass(frozen=True, slots=True)
class ReadingPlan:
    """The tracks that are read and how, found out when the recording was opened.

    Attributes:
        problems: go with the first rows.
        missing_bytes: of a file cut short; its problem goes with the last rows.
        chosen: the rows of the sensor that is read, None for all.
        divided: tracks that may separate several sensors.
    """

    recording: Recording
    rows: int
    accel: Axes
    stamps: Stamps | None = None
    channels: dict[str, Channel] = field(default_factory=dict)
    problems: tuple[Problem, ...] = ()
    missing_bytes: int = 0
    chosen: ChosenRows | None = None
    divided: Divided = field(default_factory=Divided)

    @property
    def tracks(self) -> tuple[Track, ...]:
        """All tracks that are read."""
        groups = (self.accel.tracks, *(channel.tracks for channel in self.channels.values()))
        stamps = () if self.stamps is None else (self.stamps.track,)
        return (*(track for group in groups for track in group), *stamps)

    def of_sensor(self, table: SensorTable) -> SensorTable:
        """Return the table with the rows that are read."""
        return table if self.chosen is None else SensorRowsTable(table, self.chosen)


def source_of(
    table: SensorTable, tracks: tuple[Track, ...], options: ReadOptions, damaged: int = 0
) -> TableSource:
    """Find the acceleration of a table, and what is stated of it.

    Raises:
        UnreadableError: nothing is known as acceleration, or several things are.
        UsageError: an option names nothing.
    """
    group = _group_of(table, tracks, options)
    if (sensor := options.one_sensor) is not None and not _is_group(sensor, tracks):
        dividing = dividing_tracks(table, tracks, group[0], group)
        if not dividing:
            find_accel(tracks, table, sensor)
        elif (chosen := chosen_rows(table, dividing, sensor)) is not None:
            long = tuple(track for track in tracks if track.rows == group[0].rows)
            table = SensorRowsTable(table, chosen)
            tracks = table.shortened(long)
            group = _group_of(table, tracks, options)
    return TableSource(table, options, tracks, group, table.stated(group[0].path), damaged)


def _group_of(table: SensorTable, tracks: tuple[Track, ...], options: ReadOptions) -> Group:
    """Return the tracks of the acceleration."""
    if options.columns is not None:
        return chosen_axes(tracks, options.columns, table)
    sensor = options.one_sensor
    return find_accel(tracks, table, sensor if sensor is not None and _is_group(sensor, tracks) else None)


def _is_group(sensor: str, tracks: tuple[Track, ...]) -> bool:
    """Return True if --sensor names a group of the file."""
    return any(is_in_group(track, sensor) for track in tracks)


def plan_of(source: TableSource, format_name: str) -> ReadingPlan:
    """Decide what to read of a table, and how.

    Raises:
        UnreadableError: its times make no sense, or no unit, rate or scale fits or is stated.
        UsageError: an option names nothing.
    """
    timeline = find_timeline(source)
    rate = checked_rate(timeline.rate_hz, source.path)
    scale, scale_notes = _scale(source)
    accel = Axes(source.group, scale)
    channels, notes = find_channels(source.table, source.tracks, source.accel, source.options)
    chosen = source.table.chosen if isinstance(source.table, SensorRowsTable) else None
    about = () if chosen is None else (chosen.note,)
    recording = _recording(source, format_name, _begun(source, timeline, rate), rate, accel, channels)
    plan = ReadingPlan(
        recording=replace(
            recording,
            device=device_of(recording.device, None if chosen is None else chosen.note),
            notes=about + timeline.notes + scale_notes + notes + recording.notes,
        ),
        rows=source.accel.rows,
        accel=accel,
        stamps=timeline.stamps,
        channels=channels,
        problems=timeline.problems + header_problems(source.attributes, source.damaged),
        missing_bytes=source.table.missing_bytes(),
        chosen=chosen,
    )
    return replace(plan, divided=_divided(source, plan))


def _divided(source: TableSource, plan: ReadingPlan) -> Divided:
    """Return the tracks that separate several sensors, but not in the first rows; raise UnreadableError if
    these do."""
    wanted, stamps = source.options.sensor, plan.stamps
    if source.options.one_sensor is not None and plan.chosen is None:
        return Divided()
    tracks = dividing_tracks(source.table, source.tracks, source.accel, plan.tracks)
    divided = Divided(tracks, stamps is not None and plan.recording.start_us is not None, wanted)
    if (watch := divided.watch(source.table)) is None:
        return divided
    rows, times = min(source.accel.rows, BLOCK_ROWS), None
    if stamps is not None:
        times = stored_stamps(source.table.rows(stamps.track), stamps.scale, 0, rows)
    watch.see(0, rows, times)
    return watch.worth_watching()


def _recording(
    source: TableSource,
    name: str,
    timeline: TableTimeline,
    rate: float,
    accel: Axes,
    channels: dict[str, Channel],
) -> Recording:
    attributes = source.attributes
    rows = source.accel.rows
    zone, zone_notes = _zone(source, timeline)
    range_g = attributes.number(*RANGE_NAMES)
    axes = [item for item in (accel, *channels.values()) if isinstance(item, Axes)]
    known = timeline.stamps is None and all(item.scale.exact is not None for item in axes)
    return Recording(
        path=source.path,
        format=name,
        rate_hz=rate,
        lsb_per_g=accel.scale.lsb,
        total_bytes=source.path.stat().st_size,
        device=Device(
            attributes.text(*MODEL_NAMES), attributes.text(*SERIAL_NAMES), attributes.text(*FIRMWARE_NAMES)
        ),
        range_g=range_g if range_g is not None and 0 < range_g <= LARGEST_RANGE_G else None,
        start_us=timeline.start_us,
        timezone=zone,
        has_offsets=timeline.has_offsets,
        stamped=timeline.stamps is not None and not timeline.stamps.scale.base_us,
        samples=rows if known else None,
        duration_s=rows / rate if timeline.duration_s is None else timeline.duration_s,
        has_temperature="temperature_mc" in channels,
        gyro_dps_per_lsb=dps_per_lsb(channels),
        notes=zone_notes,
    )


def _zone(source: TableSource, timeline: TableTimeline) -> tuple[str | None, tuple[str, ...]]:
    """Return the zone that the file states; times that are UTC for certain outweigh any name."""
    name = source.attributes.text(*ZONE_NAMES)
    zone = known_zone(name)
    if timeline.is_utc:
        place = name if zone is None else zone
        return "UTC", () if place in (None, "UTC") else (
            f"its times are UTC; it names the time zone {place}",
        )
    return zone, () if name is None or zone else (f"its time zone {name!r} is not known and was not used",)


def _scale(source: TableSource) -> tuple[CountScale, tuple[str, ...]]:
    """Return the scale, and a note if gravity decided the unit; the user's unit outweighs the rest."""
    unit, lsb = _unit_and_lsb(source)
    notes: tuple[str, ...] = ()
    zero = source.options.zero
    if zero is None and (unit is None or (unit == COUNTS and lsb is None)):
        refuse_other_zero(_more_values(source), source.path)
    if unit is None:
        unit = guess_unit(_some_values(source), source.path)
        notes = (f"unit: {unit} (judged by the length of gravity)",)
    dtype = np.result_type(*(item.dtype for item in source.group))
    if unit != COUNTS:
        return physical_scale(unit, dtype), notes
    lsb = _checked_lsb(lsb, source)
    if zero is None and (zero := zero_of(_more_values(source), lsb, source.path)) is not None:
        notes = (*notes, FOUND_ZERO.format(zero))
    return _scale_of_counts(source, lsb, dtype, zero or 0), notes


def _more_values(source: TableSource) -> NDArray[np.float64]:
    """Return values (n, 3) of several places, and many of the beginning if they may be of a converter."""
    values = _some_values(source)
    return np.concatenate([_first_values(source)[1], values]) if are_unsigned(values) else values


def _some_values(source: TableSource) -> NDArray[np.float64]:
    with np.errstate(over="ignore", invalid="ignore"):
        parts = [spread_rows(source.table, item).astype(np.float64) for item in source.group]
    rows = min(map(len, parts))
    values = np.concatenate([part[:rows] for part in parts], axis=1)
    return _first_values(source)[1] if np.isnan(values).any(axis=1).all() else values


def _first_values(source: TableSource) -> tuple[int, NDArray[np.float64]]:
    """Return the first row with values, and the rest of its block (n, 3); row 0 if none has any."""
    sources, values = [*map(source.table.rows, source.group)], np.empty((0, 3))
    for start in range(0, source.accel.rows, BLOCK_ROWS):
        parts = [one.read(start, min(start + BLOCK_ROWS, source.accel.rows))[0] for one in sources]
        with np.errstate(over="ignore", invalid="ignore"):
            values = np.concatenate(parts, axis=1).astype(np.float64)
        known = ~np.isnan(values).any(axis=1)
        if known.any():
            row = int(np.argmax(known))
            return start + row, values[row:]
    return 0, values


def _begun(source: TableSource, timeline: TableTimeline, rate: float) -> TableTimeline:
    """Return the timeline with the time of the first row that has values as its start."""
    if timeline.start_us is None or all(item.dtype.kind != "f" for item in source.group):
        return timeline
    with source.table.guard(f"{source.table.word}s"):
        row = _first_values(source)[0]
    stamps, start_us = timeline.stamps, timeline.start_us + round(row * MICROSECONDS / rate)
    if stamps is not None and row:
        start_us = int(stored_stamps(source.table.rows(stamps.track), stamps.scale, row, row + 1)[0])
    return replace(timeline, start_us=start_us) if row and start_us > LOST else timeline


def _unit_and_lsb(source: TableSource) -> tuple[str | None, float | None]:
    """Return the unit (None: gravity has to tell) and counts per g."""
    options = source.options
    file_unit, file_lsb = _shared_unit_and_lsb(source)
    lsb = file_lsb if options.lsb_per_g is None else options.lsb_per_g
    if options.unit not in (None, COUNTS) and options.zero is not None:
        raise UsageError(f"--zero is for counts, not for values in {options.unit}", hint="omit --zero")
    if options.unit is not None or options.zero is not None:
        return options.unit or COUNTS, lsb
    whole = all(item.dtype.kind in "iu" for item in source.group)
    if lsb is not None and (whole or file_unit is None):
        return "counts", lsb
    if file_unit is None:
        return "counts" if whole else None, lsb
    if (unit := TABLES.accelerations.get(normalized(file_unit))) is not None:
        return unit, lsb
    raise UnreadableError(
        f"the unit {file_unit!r} of {readable(source.accel.path)} is not known",
        path=source.path,
        hint=f"give --unit {'|'.join(PER_G)}|counts",
    )


def _shared_unit_and_lsb(source: TableSource) -> tuple[str | None, float | None]:
    """Return unit and counts per g by the attributes of the axes, which must not contradict each other."""
    attributes = [source.table.stated(item.path) for item in source.group]
    stated = {found.text("units", "unit") for found in attributes} - {None}
    units = stated or {split_unit(item.name)[1] for item in source.group} - {None}
    scales = {found.number(*LSB_NAMES) for found in attributes} - {None}
    if len(units) > 1 or len(scales) > 1:
        raise UnreadableError(
            "the axes have different units or counts per g", path=source.path, hint="give them one scale"
        )
    return next(iter(units), None), next(iter(scales), None)


def _checked_lsb(lsb: float | None, source: TableSource) -> float:
    path = source.path
    if lsb is None:
        likely = likely_counts(usual_length(_some_values(source) - (source.options.zero or 0)))
        raise UnreadableError(
            "the file does not state the counts per g",
            path=path,
            hint=f"give --lsb-per-g N{likely}, or --unit if its whole numbers are in {'|'.join(PER_G)}",
        )
    if not LEAST_LSB <= lsb <= recordings.FLOAT_LSB_PER_G * LARGEST_G:
        raise UnreadableError(f"{lsb:g} counts per g cannot be right", path=path, hint="give --lsb-per-g N")
    return lsb


def _scale_of_counts(source: TableSource, lsb: float, dtype: np.dtype[Any], zero: int) -> CountScale:
    """Return the scale of counts; counts with decimal fractions (averages) go to the grid of fractions."""
    if dtype.kind == "f":
        for item in source.group:
            seen = spread_rows(source.table, item)
            seen = seen[np.isfinite(seen)]
            if np.any(seen != np.rint(seen)):
                return CountScale(recordings.FLOAT_LSB_PER_G, lsb, LARGEST_G, zero=zero)
    return count_scale(lsb, dtype, zero)


def spread_rows(table: SensorTable, track: Track) -> NDArray[Any]:
    """Return some rows from the beginning, the end and between, without lost ones."""
    rows = table.rows(track)
    last = max(0, track.rows - PLACE_ROWS)
    starts = sorted({place * last // (PLACES - 1) for place in range(PLACES)})
    return np.concatenate([good_rows(rows, start, min(start + PLACE_ROWS, track.rows)) for start in starts])


def known_zone(name: str | None) -> str | None:
    """Return the name or offset of a time zone if it is one, else None."""
    if name is None or name.upper() in ("UTC", "Z"):
        return name and "UTC"
    try:
        utc_offset_s(name, 0)
    except UsageError:
        return None
    return name


def header_problems(attributes: Attributes, damaged: int = 0) -> tuple[Problem, ...]:
    """Return a problem if attributes, datasets or groups could not be read."""
    count = len(attributes.damaged) + damaged
    if not count:
        return ()
    what = f"{count} attributes, datasets or groups cannot be read and count as absent"
    return (Problem("damaged_header", what, None, 0, count),)


class TableReader(Reader):
    """Streams the rows of a plan. The file is open only while a stream runs."""

    repack = "write it again in smaller parts"
    """Advice on a file whose parts are too large to unpack at once."""

    def __init__(self, plan: ReadingPlan) -> None:
        self.recording = plan.recording
        self.may_hold_several = bool(plan.divided.tracks)
        self._plan = plan

    def table(self) -> AbstractContextManager[SensorTable]:
        """Open the file again; raises UnreadableError where it cannot be opened."""
        raise NotImplementedError

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, from `chunk_samples` rows of the table at a time.

        Raises:
            UnreadableError: no row at all is usable, or the columns cannot be reached.
        """
        delivered = 0
        with closing(self._pieces(0, self._plan.rows, chunk_samples)) as pieces:
            for chunk in pieces:
                delivered += len(chunk)
                yield chunk
        if not delivered:
            with self.table() as table, table.explaining():
                track = readable(self._plan.accel.tracks[0].path)
                raise UnreadableError(
                    f"none of the {self._plan.rows} rows of {track} is usable",
                    path=self.recording.path,
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

    def _pieces(self, start: int, stop: int, chunk_samples: int) -> Generator[Chunk, None, None]:
        with self.table() as table:
            with table.explaining(), table.guard(f"{table.word}s"):
                # the zone that counts is known after the file was opened, and is not the plan's
                zone = self.recording.timezone if self.recording.stamped else None
                stream = _Stream(self._plan.of_sensor(table), self._plan, start, zone)
                self._refuse_unbounded(stream.kept_bytes, table.word)
            step = max(1, min(chunk_samples, PIECE_BYTES // stream.row_bytes))
            for row in range(start, stop, step):
                yield stream.piece(row, min(row + step, stop), last=row + step >= stop)

    def _refuse_unbounded(self, kept: int, word: str) -> None:
        """Raise UnreadableError for parts that would take too much memory together."""
        if kept > REFUSE_ABOVE_BYTES:
            raise UnreadableError(
                f"its {word}s are packed in parts of {kept >> 20} MB together, too large to unpack at once",
                path=self.recording.path,
                hint=self.repack,
            )


def _message(run: Run) -> str:
    return run.event.text if run.event.code == FOLLOWED else f"{run.count} {run.event.text}"


class _Stream:
    """One run through the rows, with what is carried from one chunk to the next."""

    def __init__(self, table: SensorTable, plan: ReadingPlan, start: int, zone: str | None) -> None:
        self._plan = plan
        self._rate = rate_fraction(plan.recording.rate_hz)
        self._accel = [*map(table.rows, plan.accel.tracks)]
        self._channels = {name: [*map(table.rows, channel.tracks)] for name, channel in plan.channels.items()}
        self._before: Channels = {}
        stamps = [table.rows(plan.stamps.track)] if plan.stamps else []
        self._times = RowTimes(stamps[0], plan.stamps, start, zone) if plan.stamps else None
        problems = plan.problems if start == 0 else ()
        self._log = ProblemLog(problems, _message, SINGLE, by_end=True)
        self._watch = plan.divided.watch(table) if start == 0 else None
        self._sample, self._lost_bytes = start, 0
        self._last_row: int | None = None
        self._last_time = 0
        sources = [*chain(self._accel, *self._channels.values(), stamps)]
        self.row_bytes = sum(source.row_bytes for source in sources)
        self.kept_bytes = sum(source.kept_bytes for source in sources)

    def piece(self, start: int, stop: int, last: bool) -> Chunk:
        """Return the usable ones among rows start..stop-1 of the table."""
        selection = RowSelection(start, stop, self.row_bytes)
        counts = self._plan.accel.values(self._accel, selection)
        channels = self._channel_values(selection)
        times = None if self._times is None else self._times.next(selection)
        if self._watch is not None:
            self._watch.see(start, stop, None if self._times is None else self._times.stamps)
        rows = selection.rows()
        clock = self._clock(times, rows, selection)
        breaks, clock_jumps = self._breaks(times, rows, selection)
        for event in selection.events(self._log, self._sample):
            self._log.add(event)
            self._lost_bytes += event.lost_bytes
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
        """Return, with the last rows, the problem that the file was cut short."""
        missing, total = self._plan.missing_bytes, self._plan.recording.total_bytes
        if not missing or not last:
            return ()
        end = f"last {missing} bytes are" if missing > 0 else "end is"
        what = f"the file is cut short: its {end} missing"
        more = max(0, missing - self._lost_bytes)  # rows that were announced are lost already
        return (Problem("truncated", what, total, self._sample + rows, max(1, missing), 0, more),)

    def _channel_values(self, selection: RowSelection) -> Channels:
        channels: Channels = {
            name: channel.values(self._channels[name], selection, self._before.get(name))
            for name, channel in self._plan.channels.items()
        }
        self._before = recordings.cut_channels(channels, [-1])
        return channels

    def _clock(
        self, times: NDArray[np.int64] | None, rows: NDArray[np.int64], selection: RowSelection
    ) -> Clock:
        """Return the times of the kept rows: their own, or by their place in the table."""
        if times is not None:
            return StampClock(selection.kept(times))
        even = UniformClock(self._plan.recording.start_us or 0, selection.start, self._rate)
        if len(rows) == len(selection.keep):
            return even
        return StampClock(selection.kept(even.times(0, len(selection.keep))))

    def _breaks(
        self, times: NDArray[np.int64] | None, rows: NDArray[np.int64], selection: RowSelection
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return rows that do not follow on the one before in place or time, and those only in time."""
        if not len(rows):
            return recordings.NO_BREAKS, recordings.NO_BREAKS
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
        """Return flags of rows before which the times jump; note jumps that lost rows do not explain."""
        longest = GAP_PERIODS * MICROSECONDS / self._plan.recording.rate_hz
        steps = np.diff(times, prepend=times[0] if self._last_row is None else self._last_time)
        self._last_time = int(times[-1])
        selection.note(AHEAD, rows[(steps > longest) & ~explained])
        selection.note(BACK, rows[steps < 0])
        return (steps > longest) | (steps < 0)
