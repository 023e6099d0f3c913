"""An open GENEActiv .bin file: what is known of the recording, and its rows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate, probe_file
from accelcal_cli.core.recording import Chunk, Problem, Reader, Recording
from accelcal_cli.core.zones import iso_time
from accelcal_cli.readers._geneactiv.decode import Settings
from accelcal_cli.readers._geneactiv.first import FirstPages, look_inside, true_rate
from accelcal_cli.readers._geneactiv.header import RESET_DATE, Header, parse_header
from accelcal_cli.readers._geneactiv.page import SAMPLES, USUAL_BYTES
from accelcal_cli.readers._geneactiv.scale import RAW_LIMIT, Scale, factory_scale, raw_scale
from accelcal_cli.readers._geneactiv.signature import HEADER_MAGIC
from accelcal_cli.readers._geneactiv.stream import Scheme
from accelcal_cli.readers._geneactiv.text import TextFile
from accelcal_cli.readers._pages.pages import NO_TEMPERATURE
from accelcal_cli.readers._pages.timeline import Spacing

START_SAMPLES = 8192
TAIL_BYTES = 1 << 16
USUAL_RANGE_G = 8.0
COPY_AGAIN = "copy it again from the device"
NO_START = "the device's clock was reset by an empty battery: its dates are not those of the recording"
HEADER_RESET = "the header's times are those of a device that was reset; the times are those of the pages"


class GeneactivReader(Reader):
    """Streams the pages; each call of `chunks` reads the file from its beginning."""

    def __init__(self, recording: Recording, scheme: Scheme) -> None:
        self.recording = recording
        self._scheme = scheme

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, whole pages, at least one."""
        return self._scheme.stream(chunk_samples)

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Enter the file at evenly spread bytes, each time up to the next page.

        A gzip file gives its first chunks.
        """
        file = self._scheme.file
        if file.compressed:
            yield from super().preview(chunk_samples, pieces)
            return
        spread = max(USUAL_BYTES, (file.size - file.start) // max(1, pieces))
        length = min(spread, max(1, chunk_samples // SAMPLES) * USUAL_BYTES)
        for piece in range(pieces):
            chunk = self._scheme.piece(file.start + piece * spread, length)
            if len(chunk) or chunk.problems:
                yield chunk


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording.

    Raises:
        UnreadableError: no page is intact, or the factory's calibration is lost and `lsb_per_g` not given.
        UsageError: the user's rate contradicts that of the pages.
    """
    probe = probe_file(path, options)
    header = parse_header(probe.head)
    file = TextFile(path, header.data_start, probe.size, probe.compressed)
    first = look_inside(file)
    if first is None:
        known = probe.head.startswith(HEADER_MAGIC)
        what = "holds no intact page of samples" if known else "is not a GENEActiv .bin recording"
        raise UnreadableError(what, path=path, byte_offset=header.data_start, hint=COPY_AGAIN)
    scheme = Scheme(
        file,
        Settings(first.serial, first.rate, scale_of(header, options, path)),
        Spacing(true_rate(first.rate), SAMPLES),
        first,
        header.pages,
    )
    start_us = first_time(scheme)
    dated = not (iso_time(start_us, None) or "").startswith(RESET_DATE)
    scheme = replace(scheme, problems=problems_of(header, first, dated=dated))
    return GeneactivReader(describe(scheme, header, options, start_us if dated else None), scheme)


def problems_of(header: Header, first: FirstPages, *, dated: bool) -> tuple[Problem, ...]:
    """What is wrong before any page is read."""
    problems, start = [], header.data_start
    if header.missing:
        text = f"the header does not tell the device's {', '.join(header.missing)}"
        problems.append(Problem("damaged_header", text, 0, 0))
    if not dated:
        problems.append(Problem("no_start_time", NO_START, start, 0))
    if first.missing:
        text = f"pages missing before the first one by its sequence number: {first.missing}"
        problems.append(Problem("sequence_gap", text, start, 0, first.missing))
    return tuple(problems)


def scale_of(header: Header, options: ReadOptions, path: Path) -> Scale:
    """The user's counts per g for the raw values, else the factory's calibration.

    Raises:
        UnreadableError: there is neither.
    """
    if options.lsb_per_g is not None:
        return raw_scale(options.lsb_per_g)
    if header.factory is None:
        usual = RAW_LIMIT / (header.range_g or USUAL_RANGE_G)
        raise UnreadableError(
            "the factory's calibration (gain and offset of x, y and z) is missing in the header, or damaged",
            path=path,
            byte_offset=0,
            hint=f"give --lsb-per-g to read the raw values (about {usual:g} by the sensor's range)",
        )
    return factory_scale(header.factory)


def describe(scheme: Scheme, header: Header, options: ReadOptions, start_us: int | None) -> Recording:
    """What is known of the recording."""
    first, file = scheme.first, scheme.file
    serial = first.serial.decode("ascii", "replace").strip()
    return Recording(
        path=file.path,
        format="geneactiv",
        rate_hz=agreed_rate(options, float(first.rate), file.path),
        lsb_per_g=scheme.settings.scale.lsb_per_g,
        total_bytes=file.size,
        device=replace(header.device, serial=serial or header.device.serial),
        range_g=header.range_g,
        start_us=start_us,
        timezone=options.timezone or header.timezone,
        duration_s=duration_s(scheme, start_us),
        has_temperature=first.temperature_mc != NO_TEMPERATURE,
        notes=notes(scheme, header, options),
    )


def notes(scheme: Scheme, header: Header, options: ReadOptions) -> tuple[str, ...]:
    """What a user should know of how the file was understood."""
    first, found = scheme.first, []
    serial = first.serial.decode("ascii", "replace").strip()
    if header.rate is not None and header.rate != first.rate:
        found.append(f"the header says {float(header.rate):g} Hz, the pages {float(first.rate):g} Hz")
    if header.device.serial not in (None, serial):
        found.append(f"the header names device {header.device.serial}, the pages {serial}")
    if options.lsb_per_g is not None:
        found.append("--lsb-per-g was given: the factory's gain and offset were not applied")
    if header.reset:
        found.append(HEADER_RESET)
    if header.drift_s is not None:
        found.append(f"the header notes a clock drift of {header.drift_s} s; the times are the device's own")
    return tuple(found)


def first_time(scheme: Scheme) -> int:
    """Time of the first sample [us], as `chunks` gives it."""
    with closing(scheme.stream(START_SAMPLES)) as chunks:
        return int(next(chunk for chunk in chunks if len(chunk)).clock.times(0, 1)[0])


def duration_s(scheme: Scheme, start_us: int | None) -> float | None:
    """From the first sample to the end of the last page [s], None where that is not found."""
    file = scheme.file
    if file.compressed or start_us is None:
        return None
    last = scheme.block(file.piece(max(file.start, file.size - TAIL_BYTES), TAIL_BYTES))
    if not len(last) or last.time_us is None:
        return None
    lasted_us = int(last.time_us[-1]) - start_us + float(scheme.spacing.rows_us(last.rows[-1]))
    return lasted_us / MICROSECONDS if lasted_us > 0 else None
