"""Writes Axivity AX3 and, with a gyroscope, AX6 recordings: sectors of unpacked samples with checksums.

Sources: the vendor's format document `Docs/ax3/cwa.h` and the notes next to it, `ax3-technical.md`
and `ax3-auxiliary.md` (github.com/openmovementproject/openmovement). Each sector is stamped with the time
of the sample that lies nearest to a tick of the device's clock, 1/32768 s. A sector ends where it is full
and where the recording has a break; the first one after a break says that samples were lost.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any
from urllib.parse import quote_plus

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import OutputError, UsageError
from accelcal_cli.core.formats import Encoder, Sampling
from accelcal_cli.core.recording import Chunk, Recording
from accelcal_cli.formats import _writing
from accelcal_cli.formats.cwa import HEADER_MAGIC, sector

HARDWARE, GYRO_HARDWARE, FIRMWARE = 0x17, 0x64, 47
SESSION, FULL_BATTERY, SAMPLES_LOST = 1, 205, 0x20
TICKS_PER_S = 1 << 15
RATE_CODES = {float(sector.rate_of(code)): code for code in range(6, 16)}
RANGE_CODES = {16.0: 0x00, 8.0: 0x40, 4.0: 0x80, 2.0: 0xC0}
LSB_PER_G = 256.0
GYRO_BITS = {8000 / (1 << bits) / (1 << 15): bits for bits in range(2, 7)}
"""Bits for the range of a gyroscope (2000 to 125 deg/s) by deg/s in one count."""

NOT_MEASURED, WARMEST = 0, 0x3FE
ALWAYS, NEVER = 0, 0xFFFF_FFFF
UNSET = b"\xff"


def sampling(recording: Recording) -> Sampling:
    """Return a sampling with a rate, scale and range of an AX3 or AX6, or raise UsageError."""
    device = f"an Axivity {'AX6' if has_gyroscope(recording) else 'AX3'}"
    rate_hz = _writing.known_rate(recording, RATE_CODES, device)
    _writing.known_scale(recording, [(LSB_PER_G, range_g) for range_g in RANGE_CODES], device)
    turns = recording.gyro_dps_per_lsb
    if turns is not None and (turns[0] not in GYRO_BITS or len(set(turns)) > 1):
        raise UsageError(f"{device} has no gyroscope of such a scale", hint=_writing.OTHER_FORMAT)
    return Sampling(rate_hz)


def write(path: Path, recording: Recording, chunks: Iterable[Chunk]) -> None:
    """Write all chunks to `path`; raises OutputError for a count or a time that does not fit."""
    sampling(recording)
    with _writing.new_file(path) as file:
        file.write(header(path, recording))
        sequence = 0
        for rows in _writing.page_runs(chunks, sector.FULL_ROWS[axes_code(recording)]):
            sectors = data_sectors(path, rows, recording)
            sectors["sequence"] = sequence + np.arange(len(sectors))
            words = sectors.view("<u2").reshape(len(sectors), -1)
            words[:, -1] = 0 - words[:, :-1].sum(axis=1, dtype=np.uint16)  # the sum of all is zero
            file.write(sectors.data)
            sequence += len(sectors)


def header(path: Path, recording: Recording) -> bytes:
    """Return the first 1024 bytes of the file."""
    number = _writing.number_of(recording.device)
    second = np.array([_writing.start_us(path, recording) // 1_000_000])
    hardware = GYRO_HARDWARE if has_gyroscope(recording) else HARDWARE
    remark = f"_n={quote_plus(_writing.remark(recording.device))}".encode()[:448].ljust(448)
    first = (HEADER_MAGIC, hardware, number & 0xFFFF, SESSION, number >> 16, ALWAYS, NEVER, 0, 0xFF, 0)
    settings = (UNSET * 8, 0, rate_code(recording), int(packed_times(path, second)[0]), FIRMWARE, -1)
    return sector.HEADER.pack(*first, *settings, UNSET * 20, remark, UNSET * 512)


def has_gyroscope(recording: Recording) -> bool:
    """Return True for a recording of an AX6."""
    return recording.gyro_dps_per_lsb is not None


def axes_code(recording: Recording) -> int:
    """Return the byte for axes and packing."""
    return sector.AXES_6X16 if has_gyroscope(recording) else sector.AXES_3X16


def rate_code(recording: Recording) -> int:
    """Return the byte for rate and range."""
    return RATE_CODES[recording.rate_hz] | RANGE_CODES[recording.range_g or 0.0]


def data_sectors(path: Path, rows: Chunk, recording: Recording) -> NDArray[np.void]:
    """Return full sectors, or a single one that is not full; without number and checksum."""
    _writing.check_bits(path, rows, 16)
    axes = axes_code(recording)
    width = min(sector.FULL_ROWS[axes], len(rows))
    sectors = np.zeros(len(rows) // width, sector.SECTOR)
    sectors["magic"] = sector.MAGIC
    sectors["session"] = SESSION
    turns = recording.gyro_dps_per_lsb  # no light, and the unit 1/256 g (0)
    sectors["light"] = 0 if turns is None else GYRO_BITS[turns[0]] << 10
    sectors["temperature"] = temperature_words(rows, len(sectors), axes)
    sectors["events"][0] = SAMPLES_LOST * rows.is_fresh
    sectors["battery"] = FULL_BATTERY
    sectors["rate"], sectors["axes"] = rate_code(recording), axes
    sectors["count"] = width
    values = rows.counts
    if has_gyroscope(recording) and rows.gyro_counts is not None:
        values = np.concatenate([rows.gyro_counts, rows.counts], axis=1)
    numbers = values.shape[1] * width
    sectors["data"].view("<i2")[:, :numbers] = values.reshape(-1, numbers)
    stamp(path, sectors, rows.time_us.reshape(-1, width), int(recording.rate_hz))
    return sectors


def stamp(path: Path, sectors: Any, time_us: NDArray[np.int64], rate_hz: int) -> None:
    """Fill in the time of one sample of each sector, given the times (p, samples) of all.

    The device subtracts from the sample's number the samples in the fraction of the second (at its rate in
    whole Hz), so that software which knows only whole seconds is right too.
    """
    inside = time_us % 1_000_000 * TICKS_PER_S % 1_000_000
    sample = np.minimum(inside, 1_000_000 - inside).argmin(axis=1)
    second, rest_us = np.divmod(time_us[np.arange(len(sample)), sample], 1_000_000)
    ticks = (rest_us * TICKS_PER_S + 500_000) // 1_000_000
    second, ticks = second + ticks // TICKS_PER_S, ticks % TICKS_PER_S
    sectors["stamp"] = packed_times(path, second)
    sectors["fraction"] = sector.HAS_FRACTION | ticks
    sectors["offset"] = sample - ticks * rate_hz // TICKS_PER_S


def packed_times(path: Path, second: NDArray[np.int64]) -> NDArray[np.int64]:
    """Pack seconds since 1970, in 2000 to 2063: from the top, 6 bits of years, then month, day, and so on."""
    moment = second.astype("M8[s]")
    month, day = moment.astype("M8[M]"), moment.astype("M8[D]")
    months = month.astype(np.int64) - 30 * 12
    if len(months) and (months.min() < 0 or months.max() >= 64 * 12):
        raise OutputError("a time lies before 2000 or after 2063", path=path, hint=_writing.OTHER_FORMAT)
    of_month = (day - month.astype("M8[D]")).astype(np.int64) + 1
    of_day = second % 86_400
    date = (months // 12 << 9 | months % 12 + 1 << 5 | of_month) << 17
    return np.asarray(date | of_day // 3600 << 12 | of_day // 60 % 60 << 6 | of_day % 60)


def temperature_words(rows: Chunk, sectors: int, axes: int) -> NDArray[np.int64]:
    """Return the mean temperature of each sector as raw words of the hardware's sensor.

    An AX3 of hardware 1.7 measures C = raw * 0.15 - 20.5, an AX6 C = raw * 75 / 256 - 50.
    """
    means_mc = _writing.page_means_mc(rows, sector.FULL_ROWS[axes])
    if means_mc is None:
        return np.full(sectors, NOT_MEASURED)
    raw = (means_mc + 20_500) / 150 if axes == sector.AXES_3X16 else (means_mc + 50_000) * 256 / 75_000
    return np.clip(np.rint(raw), 1, WARMEST).astype(np.int64)


ENCODER = Encoder("cwa", ".cwa", write, sampling=sampling, gyroscope=True)
