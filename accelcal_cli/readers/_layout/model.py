"""What a layout file says, checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

AXES = ("x", "y", "z")
GYRO = ("gx", "gy", "gz")
FIELD_NAMES = (*AXES, "temperature", *GYRO)
FIELD_TYPES = {"int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int24": 3, "int32": 4, "float32": 4}
SEQUENCE_TYPES = {"uint8": 1, "uint16": 2, "uint32": 4}
TIME_TYPES = {"uint32": 4}
CHECKSUM_BYTES = {"crc32": 4, "crc16-ccitt": 2}

STREAM_FRAMES = 256
"""An unbroken stream is taken in pages of so many frames."""


@dataclass(frozen=True, slots=True)
class Field:
    """A value within a frame: `raw * scale + zero`, or for x, y, z `raw - zero` counts."""

    offset: int
    type: str
    per_unit: float | None = None
    zero: float = 0.0

    @property
    def end(self) -> int:
        """Offset of the byte after it."""
        return self.offset + FIELD_TYPES[self.type]

    @property
    def scale(self) -> float:
        """Degrees C, or deg/s, in one raw unit."""
        return 1.0 if self.per_unit is None else self.per_unit


@dataclass(frozen=True, slots=True)
class Sequence:
    """The page's number, at `offset` within the page."""

    offset: int
    type: str

    @property
    def bits(self) -> int:
        """Width, after which the numbers start from 0 again."""
        return 8 * SEQUENCE_TYPES[self.type]


@dataclass(frozen=True, slots=True)
class Stamp:
    """The time of the page's first sample: units of `per_unit` seconds since 1970."""

    offset: int
    type: str
    per_unit: float


@dataclass(frozen=True, slots=True)
class Checksum:
    """Checksum of the page's bytes start..stop-1."""

    offset: int
    type: str
    start: int
    stop: int


@dataclass(frozen=True, slots=True)
class StartTime:
    """Time of the first sample [us since 1970]; `timezone` is UTC if the layout gave an offset."""

    start_us: int
    timezone: str | None


@dataclass(frozen=True, slots=True)
class Layout:
    """A raw dump's description; sizes in bytes. `page_bytes` 0 is an unbroken stream of frames."""

    rate_hz: float
    lsb_per_g: float
    frame_bytes: int
    fields: Mapping[str, Field]
    range_g: float | None = None
    start: StartTime | None = None
    serial: str | None = None
    model: str | None = None
    firmware: str | None = None
    endian: str = "little"
    header_bytes: int = 0
    page_bytes: int = 0
    page_header_bytes: int = 0
    page_trailer_bytes: int = 0
    sequence: Sequence | None = None
    stamp: Stamp | None = None
    checksum: Checksum | None = None

    @property
    def page_frames(self) -> int:
        """Samples in a full page."""
        if not self.page_bytes:
            return STREAM_FRAMES
        return (self.page_bytes - self.page_header_bytes - self.page_trailer_bytes) // self.frame_bytes

    @property
    def block_bytes(self) -> int:
        """Bytes of a page, or of what is taken for one in an unbroken stream."""
        return self.page_bytes or STREAM_FRAMES * self.frame_bytes
