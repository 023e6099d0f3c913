"""Reads EDF and BDF files: data records are pages, with their own times in EDF+D."""

from __future__ import annotations

import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, rate_fraction
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate
from accelcal_cli.core.recording import CUT_SHORT, Problem, Reader, Recording, first_row
from accelcal_cli.formats._pages import pages as paged
from accelcal_cli.formats._pages.files import PagedFile, RawBlock
from accelcal_cli.formats._pages.pages import Decoded, PageBlock
from accelcal_cli.formats._pages.reader import FixedPages, PageDecoder
from accelcal_cli.formats._pages.timeline import ExactTimeline, NominalTimeline, PageTimeline, Spacing
from accelcal_cli.formats._rows import MISSING
from accelcal_cli.formats.edf.header import (
    ANNOTATIONS,
    COPY_AGAIN,
    ChosenSignals,
    Header,
    Signal,
    choose,
    read_header,
)

ONSET = re.compile(rb"([+-])(\d{1,9})(?:\.(\d{0,9}))?\x14", re.ASCII)
"""First annotation of each record: seconds from the start at which the record begins."""

RATES_HZ = (0.001, 100_000.0)
NO_START = "the header has no date; times count from 1970-01-01"
MILLIKELVIN_ZERO, HOTTEST = -273_150, 1_000_000


class RecordDecoder(PageDecoder[RawBlock]):
    """Decodes blocks of data records; says at the end if they are not as many as the header claims."""

    def __init__(self, header: Header, chosen: ChosenSignals, start_us: int) -> None:
        self._header, self._chosen, self._start_us = header, chosen, start_us
        self._annotations = annotations_of(header)
        sensors = [axes for axes in (chosen.accel, chosen.gyro) if axes is not None]
        self._may_fail = any(axes.may_fail(header.sample_bytes) for axes in sensors)

    def decode(self, raw: RawBlock) -> Decoded:
        """Decode the records of a block; in EDF+D, only those whose time can be read."""
        pages, position = raw.pages, raw.first_position + np.arange(len(raw.pages))
        bad: list[paged.BadRun] = []
        stamps = None
        if self._header.plus == "D" and self._annotations is not None:
            onsets = [self.onset_us(page) for page in pages]
            status = np.array([paged.GOOD if onset is not None else paged.TEXT for onset in onsets], np.uint8)
            bad = paged.bad_runs(status, raw.first_position)
            pages, position = pages[status == paged.GOOD], position[status == paged.GOOD]
            stamps = np.array([self._start_us + onset for onset in onsets if onset is not None], np.int64)
        return Decoded(self._block(pages, position, stamps), bad, raw.tail)

    def ending(self, raw: RawBlock, sample: int) -> tuple[Problem, ...]:
        """See PageDecoder."""
        records, seen = self._header.records, raw.next_position
        if records is None or records == seen:
            return ()
        text = f"the header says {records} data records, and the file holds {seen}"
        if seen > records:
            return (Problem("wrong_count", text, raw.offset(seen), sample),)
        missing = (records - seen) * self._header.record_bytes - len(raw.tail)
        return (Problem(CUT_SHORT, text, raw.offset(seen), sample, missing_bytes=missing),)

    def onset_us(self, page: NDArray[np.uint8]) -> int | None:
        """Return the microseconds from the header's start to a record's; None if it does not say."""
        if self._annotations is None:
            return None
        match = ONSET.match(self._bytes(page[np.newaxis], self._annotations).tobytes())
        if match is None:
            return None
        fraction = int((match[3] or b"").ljust(9, b"0")) + 500
        onset = int(match[2]) * MICROSECONDS + fraction // 1000
        return -onset if match[1] == b"-" else onset

    def _block(
        self, pages: NDArray[np.uint8], position: NDArray[np.int64], stamps: NDArray[np.int64] | None
    ) -> PageBlock:
        chosen, rows = self._chosen, self._chosen.accel.signals[0].samples
        faulty = np.zeros(len(pages) * rows, np.bool_) if self._may_fail else None
        counts = chosen.accel.counts([self._digital(pages, one) for one in chosen.accel.signals], faulty)
        channels: dict[str, NDArray[Any]] = {}
        if chosen.gyro is not None:
            turning = [self._digital(pages, one) for one in chosen.gyro.signals]
            channels["gyro_counts"] = chosen.gyro.counts(turning, faulty)
        if chosen.temperature is not None:
            channels["temperature_mc"] = self._temperature(pages, rows)
        return PageBlock(
            position=position,
            rows=np.full(len(pages), rows, np.int64),
            counts=counts,
            time_us=stamps,
            faulty=faulty,
            channels=channels,
        )

    def _bytes(self, pages: NDArray[np.uint8], signal: Signal) -> NDArray[np.uint8]:
        size = self._header.sample_bytes
        start = signal.offset * size
        return np.ascontiguousarray(pages[:, start : start + signal.samples * size])

    def _digital(self, pages: NDArray[np.uint8], signal: Signal) -> NDArray[Any]:
        """Return a signal's digital values, (n,): int16, or int32 for BDF."""
        data = self._bytes(pages, signal)
        if self._header.sample_bytes == 2:
            return data.view("<i2").reshape(-1).astype(np.int16)
        low, middle, high = data.reshape(-1, 3).T.astype(np.int32)
        return np.asarray(low | middle << 8 | (high ^ 0x80) - 0x80 << 16)

    def _temperature(self, pages: NDArray[np.uint8], rows: int) -> NDArray[np.int32]:
        """Return for each row the last value before its end, (n,) thousandths of a degree C."""
        assert self._chosen.temperature is not None
        signal, gain, zero = self._chosen.temperature
        values = np.rint(self._digital(pages, signal) * gain + zero)
        measured = (values >= MILLIKELVIN_ZERO) & (values <= HOTTEST)
        milli = np.where(measured, values, MISSING).astype(np.int32)
        place = np.arange(rows) * signal.samples // rows
        return milli.reshape(len(pages), signal.samples)[:, place].reshape(-1)


def annotations_of(header: Header) -> Signal | None:
    """Return the signal whose first annotation is the time of a record."""
    return next((one for one in header.signals if one.label in ANNOTATIONS and one.samples), None)


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open an EDF or BDF file; `Format.open` says what is raised."""
    header = read_header(path)
    chosen = choose(header, options, path)
    rate_hz = float(chosen.accel.signals[0].samples / header.seconds)
    if not RATES_HZ[0] <= rate_hz <= RATES_HZ[1]:
        what = f"a sampling rate of {rate_hz:g} Hz is impossible"
        raise UnreadableError(what, path=path, byte_offset=244, hint=COPY_AGAIN)
    rate = rate_fraction(agreed_rate(options, rate_hz, path))
    file = PagedFile.at(path, header.header_bytes, header.record_bytes, proved=False)
    decoder = RecordDecoder(header, chosen, header.start_us or 0)
    spacing = Spacing(rate, chosen.accel.signals[0].samples)
    timed = header.plus == "D" and annotations_of(header) is not None
    start_us = header.start_us or 0
    if not timed:  # EDF+ may add a fraction of a second to the header's start
        first = next(file.blocks(file.amount(1))).pages[:1]
        onset = decoder.onset_us(first[0]) if len(first) else None
        start_us += onset if onset is not None and 0 <= onset < MICROSECONDS else 0

    def timeline() -> PageTimeline:
        return ExactTimeline(spacing) if timed else NominalTimeline(spacing, start_us)

    scheme = FixedPages(file, spacing, lambda: decoder, timeline)
    opening = scheme.look_inside()
    if opening is None:
        what = "has no usable data record" + (" whose time can be read" if timed else "")
        raise UnreadableError(what, path=path, byte_offset=header.header_bytes, hint=COPY_AGAIN)
    problems = () if header.start_us is not None else (Problem("no_start_time", NO_START, 168, 0),)
    about = recording(path, rate, file.size, header, chosen)
    return scheme.reader(opening, about, problems, dated=header.start_us is not None)


def recording(path: Path, rate: Fraction, size: int, header: Header, chosen: ChosenSignals) -> Recording:
    """Describe the file as far as the header does."""
    labels = ", ".join(f"{one.label} [{one.dimension}]" for one in chosen.accel.signals)
    notes = [f"x, y, z: {labels}"]
    if chosen.accel.on_grid:
        notes.append("x, y and z have scales without a common step; they were rounded to 0.06 micro-g")
    return Recording(
        path=path,
        format="edf",
        rate_hz=float(rate),
        lsb_per_g=chosen.accel.per_unit,
        total_bytes=size,
        device=header.device,
        range_g=chosen.range_g,
        gyro_dps_per_lsb=None if chosen.gyro is None else (float(chosen.gyro.step),) * 3,
        zero_counts=first_row(chosen.accel.counts([np.zeros(1, np.int16)] * 3, np.zeros(1, np.bool_))),
        notes=tuple(notes),
    )
