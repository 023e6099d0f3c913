"""Writes GENEActiv recordings: text with a header and pages of 300 samples in hexadecimal digits.

Source: Activinsights, GENEActiv instructions, "Understanding .bin files". Gains and offsets are such that
g = (raw * 100 - offset) / gain gives counts / counts per g. A page is stamped with the time of its first
sample [ms]; its temperature is the mean of its samples [0.1 C]. Pages are always full and follow each other:
a recording with a break is refused.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import ceil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import OutputError
from accelcal_cli.core.formats import Encoder, Sampling
from accelcal_cli.core.recording import Chunk, Recording
from accelcal_cli.formats import _writing

SAMPLES = 300
PAGE_DIGITS = 12 * SAMPLES
BITS = 12
RATES = [600 / halves for halves in range(6, 61)]
"""Rates [Hz] from 100 to 10, at which a page lasts a whole number of half seconds."""

RATE_ROUNDING_HZ = 0.0501
"""Most by which a rate [Hz] is rounded to one decimal: 66.7 for 200/3, 18.8 for 18.75."""

LSB_PER_G, RANGE_G = 256.0, 8.0
EARLIEST_US, LATEST_US = 946_684_800_000_000, 4_102_444_800_000_000
"""The years 2000 to 2099."""

HEADER = """\
Device Identity
Device Unique Serial Code:{serial:06d}
Device Type:GENEActiv
Device Model:1.1
Device Firmware Version:Ver4.08a date14Jul14
Calibration Date:{start}

Device Capabilities
Accelerometer Range:-8 to 8
Accelerometer Resolution:0.0039
Accelerometer Units:g
Light Meter Range:0 to 5000
Light Meter Resolution:5
Light Meter Units:lux
Temperature Sensor Range:0 to 70
Temperature Sensor Resolution:0.1
Temperature Sensor Units:deg. C

Configuration Info
Measurement Frequency:{rate:.1f} Hz
Measurement Period:{hours:<6} Hours
Start Time:{start}
Time Zone:{zone}

Trial Info
Study Centre:
Study Code:
Investigator ID:
Exercise Type:
Config Operator ID:
Config Time:{start}
Config Notes:{remark}
Extract Operator ID:
Extract Time:{start}
Extract Notes:

Subject Info
Device Location Code:
Subject Code:
Date of Birth:1900-1-1
Sex:
Height:
Weight:
Handedness Code:
Subject Notes:

Calibration Data
x gain:{gain}
x offset:0
y gain:{gain}
y offset:0
z gain:{gain}
z offset:0
Volts:300
Lux:800

Memory Status
Number of Pages:{pages:<10}

"""
PAGE = """\
Recorded Data
Device Unique Serial Code:{serial:06d}
Sequence Number:{sequence}
Page Time:{time}
Unassigned:
Temperature:{temperature}
Battery voltage:4.1000
Device Status:Recording
Measurement Frequency:{rate:.1f}
{digits}
"""


def sampling(recording: Recording) -> Sampling:
    """Return a sampling of whole pages with a rate and scale of a GENEActiv, or raise UsageError."""
    rate_hz = _writing.known_rate(recording, RATES, "a GENEActiv", RATE_ROUNDING_HZ)
    _writing.known_scale(recording, [(LSB_PER_G, RANGE_G)], "a GENEActiv")
    return Sampling(rate_hz, SAMPLES)


def write(path: Path, recording: Recording, chunks: Iterable[Chunk]) -> None:
    """Write all chunks to `path`; the header, which announces the number of pages, last."""
    sampling(recording)
    with _writing.new_file(path) as file:
        file.write(header(path, recording, 0))
        sequence = 0
        for rows in _writing.full_pages(path, chunks, SAMPLES):
            file.write(data_pages(path, rows, recording, sequence))
            sequence += len(rows) // SAMPLES
        file.seek(0)
        file.write(header(path, recording, sequence))


def header(path: Path, recording: Recording, pages: int) -> bytes:
    """Return the text before the first page, of the same length for any number of pages."""
    device, offset = recording.device, _writing.fixed_offset(recording.timezone)
    text = HEADER.format(
        serial=_writing.number_of(device),
        start=stamps(path, np.array([_writing.start_us(path, recording)]))[0],
        rate=recording.rate_hz,
        hours=ceil(pages * SAMPLES / recording.rate_hz / 3600),
        zone=f"GMT {offset}" if offset else "",
        remark=_writing.remark(device),
        gain=round(100 * recording.lsb_per_g),
        pages=pages,
    )
    return lines(text)


def data_pages(path: Path, rows: Chunk, recording: Recording, sequence: int) -> bytes:
    """Return whole pages, numbered from `sequence`."""
    _writing.check_bits(path, rows, BITS)
    # twelve hexadecimal digits for each sample: 12 bits each of x, y, z; light and button are 0
    x, y, z = (rows.counts.astype(np.uint16) & 0xFFF).T
    words = np.stack((x << 4 | y >> 8, y << 8 | z >> 4, z << 12), axis=1)
    digits = words.astype(">u2").tobytes().hex().upper()
    constants = {"serial": _writing.number_of(recording.device), "rate": recording.rate_hz}
    times, means = stamps(path, rows.time_us[::SAMPLES]), temperatures(rows)
    pages = [
        PAGE.format(
            sequence=sequence + number,
            time=time,
            temperature=mean,
            digits=digits[number * PAGE_DIGITS : (number + 1) * PAGE_DIGITS],
            **constants,
        )
        for number, (time, mean) in enumerate(zip(times, means, strict=True))
    ]
    return lines("".join(pages))


def lines(text: str) -> bytes:
    """Return text as the device's software writes it, with lines that end in CR LF."""
    return text.replace("\n", "\r\n").encode("ascii")


def stamps(path: Path, time_us: NDArray[np.int64]) -> list[str]:
    """Return times from 2000 to 2099 to the nearest millisecond, such as 2024-03-04 00:00:00:000."""
    if len(time_us) and not (time_us.min() >= EARLIEST_US and time_us.max() < LATEST_US):
        raise OutputError("a time lies before 2000 or after 2099", path=path, hint=_writing.OTHER_FORMAT)
    texts = np.datetime_as_string(((time_us + 500) // 1000).astype("M8[ms]"))
    return [text.replace("T", " ").replace(".", ":") for text in texts.tolist()]


def temperatures(rows: Chunk) -> list[str]:
    """Return the mean temperature of each page, empty if none was measured."""
    means_mc = _writing.page_means_mc(rows, SAMPLES)
    if means_mc is None:
        return [""] * (len(rows) // SAMPLES)
    return [f"{mean / 1000:.1f}" for mean in means_mc.tolist()]


ENCODER = Encoder("geneactiv", ".bin", write, sampling=sampling)
