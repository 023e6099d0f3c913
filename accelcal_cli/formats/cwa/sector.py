"""Decodes the header and the 512-byte data sectors of an Axivity .cwa file.

Sources: the vendor's format document `Docs/ax3/cwa.h` and the notes next to it,
`Docs/ax3/ax3-technical.md` and `ax3-auxiliary.md` (github.com/digitalinteraction/openmovement).
All numbers are little-endian. Where header and data disagree, the data take precedence.

Time: the device notes the time, to 1/32768 s, and the number of samples in its buffer at that moment: an
anchor, that is a sample number and its time. For old software it stores the number as if the time were the
whole second before, so that the two must be put together again (`ax3-technical.md`).

Temperature: the low ten bits of a sector's word stand for 3 V. Which sensor the hardware carries:

- `Docs/ax3/cwa.h` and `ax3-auxiliary.md` give raw * 75 / 256 - 50, an MCP9700 (500 mV at 0 C, 10 mV
  per degree). It holds for units that declare no hardware version (0x00, 0xff) and for the AX6
  (0x64): a recording of such a unit on the body gives 24-35 C, the other formula 17-23 C.
- The firmware's profiles of AX3 hardware 1.6 to 1.8 (`Firmware/Flux.AX3/include/Hardware/
  HardwareProfile-CWA1.7.h`) define an MCP9701 (400 mV at 0 C, 19.5 mV per degree): raw * 0.15 - 20.5,
  the formula of the vendor's omconvert. Such units declare themselves as 0x16 to 0x18.

Light and battery (`ax3-auxiliary.md`): light is the low ten bits of its word, on a logarithmic scale that
differs between devices and cases, so that the vendor advises to use it as it is. The battery's voltage is
(byte + 512) of ten bits that stand for 6 V, and unknown for 0 (the vendor's OmReader, OM_VALUE_BATTERY_MV;
`ax3-auxiliary.md` doubles the byte, which would make a full cell of 4.2 V one of 5.4 V).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.recording import Channels, Device, OtherColumn, Others, no_others
from accelcal_cli.formats._pages.pages import CHECKSUM, ERASED, FOREIGN, GOOD, NONSENSE, RATE, PageBlock
from accelcal_cli.formats._rows import MISSING
from accelcal_cli.formats.cwa import HEADER_BYTES, HEADER_MAGIC, SECTOR_BYTES, SECTOR_MAGIC

SAMPLE_BYTES = 480
MAGIC = int.from_bytes(SECTOR_MAGIC, "little")

BEFORE_DATA = [
    *(("magic", "<u4"), ("fraction", "<u2"), ("session", "<u4"), ("sequence", "<u4"), ("stamp", "<u4")),
    *(("light", "<u2"), ("temperature", "<u2"), ("events", "u1"), ("battery", "u1"), ("rate", "u1")),
    *(("axes", "u1"), ("offset", "<i2"), ("count", "<u2")),
]
HEAD = np.dtype(BEFORE_DATA)
SECTOR = np.dtype([*BEFORE_DATA, ("data", "u1", (SAMPLE_BYTES,)), ("checksum", "<u2")])
HEADER = struct.Struct("<4sBHIHIIIBB8sBBIBh20s448s512s")
"""Fields of the file's header in the order of `cwa.h`: magic and length, hardware type, device number (low
half), session, device number (high half), start and end of logging, and so on; field 12 is rate and range,
field 14 the revision of the firmware."""

FIELDS = np.dtype([(name, "<u2") for name in ("low", "high")])
"""The two halves of a packed sample of 32 bits."""

Sectors = NDArray[Any]
"""(n,) of SECTOR, or of HEAD where the data do not matter."""

PACKED = 0x30
AXES_3X16, AXES_6X16 = 0x32, 0x62
FULL_ROWS = {PACKED: 120, AXES_3X16: 80, AXES_6X16: 40, 0x92: 26}
"""Samples in a full sector, by the byte for axes and packing: packed x y z; 16-bit x y z; gyroscope and
accelerometer; gyroscope, accelerometer and magnetometer."""

OVERFLOW_EVENTS = np.uint8(0x30)
"""Bits 4 and 5: the buffer of the sensor or of the firmware ran over, and samples were lost."""

HIGHEST_RATE = 3200

NO_DEVICE = Device()
AX3, AX6 = "AX3", "AX6"
MODELS = {0x00: AX3, 0x16: AX3, 0x17: AX3, 0x18: AX3, 0xFF: AX3, 0x64: AX6}
UNSET_WORD, UNSET_BYTE = 0xFFFF, 0xFF
HAS_FRACTION = 0x8000

OTHERS = OtherColumn("light", "counts"), OtherColumn("battery", "V")
LIGHT_MASK, VOLTS_PER_COUNT = 0x3FF, 6 / 1024

EMPTY, OTHER, SETTINGS = ERASED, 50, 51
"""Kinds of sectors in addition to those of pages: nothing written, a kind without acceleration (FOREIGN is
not a sector at all), or recorded with other settings."""

KINDS_WITHOUT_SAMPLES = [int.from_bytes(name, "little") for name in (b"UB", b"SI", b"GY", b"GX")]

TEMPERATURE_MASK = 0x3FF
NO_SENSOR = (0, TEMPERATURE_MASK)
"""Readings at either end of the converter, which measure nothing; in the first sector: there is no sensor."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings with which a sector was recorded.

    The byte for rate and range is 0 in the oldest files, which give the rate in `old_rate_hz` and have no
    checksum; that for axes is a key of FULL_ROWS. The bits of the scale are the unit of the accelerometer
    (upper three) and the range of the gyroscope. The thermometer is that of the temperature words, None if
    nothing was measured.
    """

    rate_code: int
    axes_code: int
    scale_bits: int
    old_rate_hz: int = 0
    thermometer: Thermometer | None = None

    @property
    def rate(self) -> Fraction:
        """Nominal samples per second."""
        return Fraction(self.old_rate_hz) if self.is_old else rate_of(self.rate_code)

    @property
    def is_old(self) -> bool:
        """Return True for the oldest format, without checksums and fractions of seconds."""
        return self.rate_code == 0

    @property
    def range_g(self) -> float:
        """The accelerometer clips at +- this."""
        return float(16 >> (self.rate_code >> 6))

    @property
    def rows(self) -> int:
        """Samples in a full sector."""
        return FULL_ROWS[self.axes_code]

    @property
    def width(self) -> int:
        """Number of 16-bit numbers in one sample: 3, 6 or 9; 3 for packed samples too."""
        return self.axes_code >> 4

    @property
    def lsb_per_g(self) -> float:
        """Counts in one g; packed samples are always of 1/256 g."""
        return 256.0 if self.axes_code == PACKED else float(256 << (self.scale_bits >> 3))

    @property
    def gyro_dps_per_lsb(self) -> float | None:
        """deg/s in one count, None without a gyroscope or where its range is unknown."""
        gyro_bits = self.scale_bits & 7
        return 8000 / (1 << gyro_bits) / 32768 if self.width > 3 and gyro_bits else None


def rate_of(code: int) -> Fraction:
    """Return the rate [Hz] of a rate code: 3200 Hz for 15, half of it for each one less."""
    return Fraction(HIGHEST_RATE, 1 << (15 - (code & 15)))


def settings_of(sector: Any, hardware: int | None) -> Settings:
    """Return the settings of one sector (a scalar of SECTOR) of a type of hardware (None: unknown)."""
    code, axes = int(sector["rate"]), int(sector["axes"])
    old_rate = int(sector["offset"]) & 0xFFFF if code == 0 else 0
    sensor = None if int(sector["temperature"]) & TEMPERATURE_MASK in NO_SENSOR else thermometer(hardware)
    return Settings(code, axes, scale_mask(axes) & (int(sector["light"]) >> 10), old_rate, sensor)


def scale_mask(axes_code: int) -> int:
    """Return a mask of the scale bits that matter; those of the gyroscope do only if there is one."""
    return 0x38 if axes_code >> 4 == 3 else 0x3F


def as_sectors(pages: NDArray[np.uint8]) -> Sectors:
    """Return the fields of sectors (n, 512), as a view."""
    return pages.reshape(-1).view(SECTOR)


def checksums(pages: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Return the sum of the 256 16-bit words of each sector (n, 512), modulo 65536; 0 if it is intact."""
    return np.asarray(pages.view("<u2").sum(axis=1, dtype=np.uint16))


def plausible(pages: NDArray[np.uint8]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Mark sensible sectors that a checksum proves, and those of the oldest format without, (n,)."""
    sectors = as_sectors(pages)
    full, count = np.zeros(256, np.int64), sectors["count"]
    full[list(FULL_ROWS)] = list(FULL_ROWS.values())
    usable = (sectors["magic"] == MAGIC) & (count > 0) & (count <= full[sectors["axes"]])
    old, old_rate = sectors["rate"] == 0, sectors["offset"].view("<u2")
    proved = usable & ~old & (checksums(pages) == 0)
    return proved, usable & old & (old_rate > 0) & (old_rate <= HIGHEST_RATE)


@dataclass(frozen=True, slots=True)
class Header:
    """The header of a file, if it is `intact`; data begin in its second half if it is `halved`."""

    data_start: int
    intact: bool
    device: Device = NO_DEVICE
    rate: Fraction | None = None
    hardware: int | None = None
    halved: bool = False


def parse_header(head: bytes) -> Header:
    """Read the header; if it is missing or incomplete, the data may begin earlier."""
    if not head.startswith(HEADER_MAGIC) or len(head) < HEADER_BYTES:
        starts = (start for start in (0, SECTOR_BYTES) if head.startswith(SECTOR_MAGIC, start))
        return Header(next(starts, HEADER_BYTES), False)
    _, hardware, low, _, high, *fields = HEADER.unpack(head[:HEADER_BYTES])
    rate, firmware = fields[7], fields[9]
    number = low | (0 if high == UNSET_WORD else high << 16)
    device = Device(
        model=MODELS.get(hardware),
        serial=None if number in (0, UNSET_WORD) else str(number),
        firmware=None if firmware == UNSET_BYTE else str(firmware),
    )
    halved = head.startswith(SECTOR_MAGIC, SECTOR_BYTES)
    start = SECTOR_BYTES if halved else HEADER_BYTES
    configured = None if rate in (0, UNSET_BYTE) else rate_of(rate)
    return Header(start, True, device, configured, hardware, halved)


def device_of_sector(settings: Settings, fraction: int) -> Device:
    """Return what a data sector says of its device, if its word of fractions is the device's number."""
    model = AX6 if settings.scale_bits >> 3 or settings.width > 3 else AX3
    numbered = fraction and not fraction & HAS_FRACTION
    return Device(model, str(fraction) if numbered else None)


@dataclass(frozen=True, slots=True, eq=False)
class Anchors:
    """One anchor for each sector, (n,) each.

    Attributes:
        row: int64, number of a sample, counted from the sector's first one; it may lie outside the sector.
        time_us: int64, its time [us since 1970, device clock].
        known: bool, the sector has a valid time.
    """

    row: NDArray[np.int64]
    time_us: NDArray[np.int64]
    known: NDArray[np.bool_]


def anchors(sectors: Sectors, settings: Settings) -> Anchors:
    """Return the anchors of sectors recorded with these settings."""
    seconds, known = packed_seconds(sectors["stamp"].copy())
    if settings.is_old:
        return Anchors(np.zeros(len(sectors), np.int64), seconds * MICROSECONDS, known)
    word = sectors["fraction"].copy()
    ticks = (word & np.uint16(HAS_FRACTION - 1)).astype(np.int64)
    ticks *= word >= HAS_FRACTION
    row = sectors["offset"] + ((ticks * int(settings.rate)) >> 15)
    return Anchors(row, seconds * MICROSECONDS + ((ticks * MICROSECONDS + (1 << 14)) >> 15), known)


def packed_seconds(stamp: NDArray[np.uint32]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the seconds since 1970 of packed times, and which of them are valid.

    From the top: years since 2000 (6 bits), month (4), day (5), hour (5), minute (6), second (6).
    """
    midnights = day_table()[stamp >> np.uint32(17)]
    hour, minute, second = ((stamp >> np.uint32(shift)) & np.uint32(63) for shift in (12, 6, 0))
    hour &= np.uint32(31)
    known = (midnights >= 0) & (hour < 24) & (minute < 60) & (second < 60)
    return midnights + (hour * np.uint32(3600) + minute * np.uint32(60) + second), known


@cache
def day_table() -> NDArray[np.int64]:
    """Return the seconds since 1970 of each packed date of 15 bits, -1 for an impossible one."""
    packed = np.arange(1 << 15, dtype=np.int64)
    year, month, day = packed >> 9, packed >> 5 & 15, packed & 31
    months = ((year + 30) * 12 + month - 1).astype("M8[M]")
    days = months.astype("M8[D]").astype(np.int64) + day - 1
    return np.where((month >= 1) & (month <= 12) & (day >= 1), days * 86_400, -1)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SectorBlock(PageBlock):
    """Good sectors in file order, (p,); before or in those of an `overflow` the device lost samples."""

    sequence: NDArray[np.int64]
    session: NDArray[np.int64]
    overflow: NDArray[np.bool_]
    anchors: Anchors


def decode(
    pages: NDArray[np.uint8], first_position: int, settings: Settings, *, with_others: bool = False
) -> tuple[SectorBlock, NDArray[np.uint8]]:
    """Decode a block of sectors (n, 512): return the good ones, and the kind of every sector, (n,)."""
    # copied together, since scattered fields would be read slowly
    heads = np.ascontiguousarray(pages[:, : HEAD.itemsize]).reshape(-1).view(HEAD)
    good = fitting(heads, settings)
    if not settings.is_old:
        good &= checksums(pages) == 0
    status = np.full(len(pages), GOOD, np.uint8)
    position = np.arange(first_position, first_position + len(pages))
    if good.all():
        return unpack(heads, pages, position, settings, with_others=with_others), status
    status[~good] = classify(pages[~good], settings)
    sound = heads[good], pages[good], position[good]
    return unpack(*sound, settings, with_others=with_others), status


def fitting(heads: Sectors, settings: Settings) -> NDArray[np.bool_]:
    """Mark the sectors that claim to hold samples recorded with these settings, (n,)."""
    fits = heads["magic"] == MAGIC
    fits &= (heads["rate"] == settings.rate_code) & (heads["axes"] == settings.axes_code)
    scale = scale_mask(settings.axes_code) << 10
    fits &= (heads["light"] & np.uint16(scale)) == settings.scale_bits << 10
    fits &= (heads["count"] - np.uint16(1)) < settings.rows
    if settings.is_old:
        fits &= heads["offset"].view("<u2") == settings.old_rate_hz
    return np.asarray(fits)


def classify(pages: NDArray[np.uint8], settings: Settings) -> NDArray[np.uint8]:
    """Return why sectors (n, 512) are not good: their kinds, (n,)."""
    sectors = as_sectors(pages)
    known = np.isin(sectors["axes"], list(FULL_ROWS)) & (sectors["count"] > 0)
    same = (sectors["axes"] == settings.axes_code) & (sectors["count"] > settings.rows)
    status = np.full(len(pages), SETTINGS, np.uint8)
    status[rates(sectors) != float(settings.rate)] = RATE
    status[~known | same] = NONSENSE
    if not settings.is_old:
        status[checksums(pages) != 0] = CHECKSUM
    status[sectors["magic"] != MAGIC] = FOREIGN
    status[np.isin(sectors["magic"] & np.uint32(0xFFFF), KINDS_WITHOUT_SAMPLES)] = OTHER
    status[(pages == pages[:, :1]).all(axis=1) & np.isin(pages[:, 0], (0, 0xFF))] = EMPTY
    return status


def rates(sectors: Sectors) -> NDArray[np.float64]:
    """Return the rates of sectors [Hz], (n,)."""
    coded = np.array([float(rate_of(code)) for code in range(16)])[sectors["rate"] & 15]
    return np.where(sectors["rate"] == 0, sectors["offset"].view("<u2"), coded)


def unpack(
    heads: Sectors,
    pages: NDArray[np.uint8],
    position: NDArray[np.int64],
    settings: Settings,
    *,
    with_others: bool = False,
) -> SectorBlock:
    """Unpack the samples of good sectors, (p,) of HEAD and (p, 512)."""
    rows = heads["count"].astype(np.int64)
    used = rows if bool((rows < settings.rows).any()) else None
    accel, gyro = _samples(pages, settings)
    each = settings.rows if used is None else rows
    channels: Channels = {name: _repeated(values, each) for name, values in _measured(heads, settings)}
    if gyro is not None and settings.gyro_dps_per_lsb:
        channels["gyro_counts"] = _joined(gyro, used)
    if with_others:
        channels["others"] = light_and_battery(heads, rows)
    return SectorBlock(
        position=position,
        rows=rows,
        sequence=heads["sequence"].astype(np.int64),
        session=heads["session"].astype(np.int64),
        overflow=(heads["events"] & OVERFLOW_EVENTS) != 0,
        anchors=anchors(heads, settings),
        counts=_joined(accel, used),
        channels=channels,
    )


def light_and_battery(sectors: Sectors, rows: NDArray[np.int64]) -> Others:
    """Return the values of OTHERS at the first of the rows of each sector, (n, 2)."""
    others, first = no_others(int(rows.sum()), len(OTHERS)), np.cumsum(rows) - rows
    others[first, 0] = sectors["light"] & LIGHT_MASK
    volts = (512 + sectors["battery"].astype(np.int64)) * VOLTS_PER_COUNT
    others[first, 1] = np.where(sectors["battery"] == 0, np.nan, volts)
    return others


def first_values(sector: Any, settings: Settings) -> dict[str, int | None]:
    """Return the values of one sector (a scalar of SECTOR) for channels that later sectors may lack."""
    return {name: int(values[0]) for name, values in _measured(np.atleast_1d(sector), settings)}


def _measured(sectors: Sectors, settings: Settings) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the channels of which a sector has one value, by name, (p,) each."""
    if settings.thermometer is not None:
        yield "temperature_mc", settings.thermometer.temperature_mc(sectors["temperature"])


def _samples(
    pages: NDArray[np.uint8], settings: Settings
) -> tuple[NDArray[np.int16], NDArray[np.int16] | None]:
    """Return acceleration and rotation, (p, rows, 3) each, as views where they are not packed."""
    sectors = as_sectors(pages)
    if settings.axes_code == PACKED:
        return unpacked(sectors), None
    used = sectors["data"][:, : 2 * settings.rows * settings.width].view("<i2")
    values = used.reshape(len(sectors), settings.rows, settings.width)
    if settings.width == 3:
        return values, None
    return values[:, :, 3:6], values[:, :, :3]


def _repeated(values: NDArray[np.int32], rows: int | NDArray[np.int64]) -> NDArray[np.int32]:
    """Repeat the value of each sector in all of its rows: a number of rows for all, or one for each."""
    if isinstance(rows, int):  # np.repeat keeps other threads waiting
        return np.broadcast_to(values[:, np.newaxis], (len(values), rows)).copy().reshape(-1)
    return np.repeat(values, rows)


def _joined(values: NDArray[np.int16], rows: NDArray[np.int64] | None) -> NDArray[np.int16]:
    """Copy the samples of sectors (p, rows, 3) one after the other, (n, 3), each axis contiguous in memory.

    Only some `rows` of each sector may be used; None: all are.
    """
    if rows is not None:
        return np.asfortranarray(values[np.arange(values.shape[1]) < rows[:, None]])
    axes = np.empty((3, *values.shape[:2]), np.int16)
    axes[:] = values.transpose(2, 0, 1)
    return axes.reshape(3, -1).T


def unpacked(sectors: Sectors) -> NDArray[np.int16]:
    """Return packed samples (10 bits for each axis, and a common exponent) as counts of 1/256 g, (p, 120, 3).

    A word of 32 bits is, from the top, the exponent (2 bits), z, y and x. Each number is moved to
    the top of a 16-bit integer, and its sign with it, before it is shifted down again.
    """
    halves = sectors["data"].copy().view(FIELDS)
    low, high = halves["low"], halves["high"]
    factor = (np.int16(1) << (high >> np.uint16(14)).astype(np.int16)).astype(np.int16)
    counts = np.empty((3, len(sectors), FULL_ROWS[PACKED]), np.int16)
    y = (high << np.uint16(12)) | ((low >> np.uint16(4)) & np.uint16(0x0FC0))
    for axis, top in enumerate((low << np.uint16(6), y, high << np.uint16(2))):
        np.multiply(top.view(np.int16) >> 6, factor, out=counts[axis])
    return counts.transpose(1, 2, 0)


@dataclass(frozen=True, slots=True)
class Thermometer:
    """A temperature sensor: thousandths of a degree C = raw * slope / divisor - zero."""

    part: str
    slope: int
    divisor: int
    zero: int
    formula: str

    def temperature_mc(self, raw: NDArray[np.uint16]) -> NDArray[np.int32]:
        """Return the temperatures of words [thousandths of a degree C], MISSING at either end."""
        word = raw & TEMPERATURE_MASK
        scaled = word.astype(np.int32) * self.slope
        measured = (scaled + self.divisor // 2) // self.divisor - np.int32(self.zero)
        ends = (word == NO_SENSOR[0]) | (word == NO_SENSOR[1])
        return np.where(ends, np.int32(MISSING), measured) if ends.any() else measured

    @property
    def note(self) -> str:
        """Note on the formula, for the report."""
        return f"temperature = {self.formula} degrees C ({self.part})"


MCP9700 = Thermometer("MCP9700", 75_000, 256, 50_000, "raw * 75 / 256 - 50")
MCP9701 = Thermometer("MCP9701", 150, 1, 20_500, "raw * 0.15 - 20.5")


def thermometer(hardware: int | None) -> Thermometer:
    """Return the sensor of a type of hardware (header byte 4); MCP9700 if it is unknown."""
    return MCP9701 if hardware in (0x16, 0x17, 0x18) else MCP9700
