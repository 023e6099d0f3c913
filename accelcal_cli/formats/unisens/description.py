"""What `unisens.xml` says of a recording and its signals: rates, types of numbers, scales, units, channels.

A value is (number - baseline) * lsbValue, in the signal's unit. `adcZero`, the middle of the converter's
range, plays no part in that.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import Device
from accelcal_cli.formats.unisens import MOST_BYTES

TYPES = {
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float": "f4",
    "double": "f8",
}
RATES_HZ = (1e-3, 100_000.0)
LARGEST_BASELINE = 1 << 31
COPY_AGAIN = "copy the whole folder again"


@dataclass(frozen=True, slots=True)
class Signal:
    """One signal of even rate.

    Attributes:
        name: of its file.
        kind: its content class, in small letters.
        number: how numpy writes the type of its numbers; None if it is no binary file or of another type.
        lsb: the unit's value of one step.
        bits: of the converter, None if not told.
        channels: names.
    """

    name: str
    kind: str
    number: str | None
    rate_hz: float
    lsb: float
    baseline: int
    bits: int | None
    unit: str
    channels: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Description:
    """A recording's description.

    Attributes:
        start_us: of all signals [us], None if not told.
        is_utc: whether that was given with an offset from UTC.
    """

    signals: tuple[Signal, ...]
    start_us: int | None
    is_utc: bool
    device: Device

    def of_kind(self, *kinds: str) -> Signal | None:
        """The first binary signal of one of these content classes."""
        return next((one for one in self.signals if one.kind in kinds and one.number is not None), None)


def load_description(path: Path) -> Description:
    """Read `unisens.xml`.

    Raises:
        UnreadableError: it cannot be read, or is no XML of Unisens.
    """
    try:
        with path.open("rb") as file:
            text = file.read(MOST_BYTES)
        if b"<!" in text.replace(b"<!--", b""):
            raise UnreadableError("has declarations, which Unisens does not use", path=path, hint=COPY_AGAIN)
        root = ElementTree.fromstring(text)
    except OSError as error:
        what = f"cannot be read ({error.strerror or error})"
        raise UnreadableError(what, path=path, hint=COPY_AGAIN) from error
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise UnreadableError(f"is damaged ({error})", path=path, hint=COPY_AGAIN) from error
    if _tag(root) != "unisens":
        raise UnreadableError("is not a description of Unisens", path=path, hint=COPY_AGAIN)
    moment = _moment(root.get("timestampStart", ""))
    return Description(
        signals=tuple(_signal(item) for item in _children(root, "signalEntry")),
        start_us=None if moment is None else moment[0],
        is_utc=moment is not None and moment[1],
        device=_device(root),
    )


def _tag(item: ElementTree.Element) -> str:
    return item.tag.rpartition("}")[2] if isinstance(item.tag, str) else ""


def _children(item: ElementTree.Element, tag: str) -> Iterator[ElementTree.Element]:
    return (child for child in item if _tag(child) == tag)


def _signal(item: ElementTree.Element) -> Signal:
    binary = next(_children(item, "binFileFormat"), None)
    order = "<" if binary is None or binary.get("endianess", "LITTLE").upper() == "LITTLE" else ">"
    code = TYPES.get(item.get("dataType", "").lower())
    bits = round(_number(item.get("adcResolution"), 0.0))
    return Signal(
        name=item.get("id", ""),
        kind=item.get("contentClass", "").lower(),
        number=None if binary is None or code is None else order + code,
        rate_hz=_number(item.get("sampleRate"), 0.0),
        lsb=_number(item.get("lsbValue"), 1.0),
        baseline=round(max(-LARGEST_BASELINE, min(LARGEST_BASELINE, _number(item.get("baseline"), 0.0)))),
        bits=bits if 1 < bits <= 32 else None,
        unit=item.get("unit", "").strip(),
        channels=tuple(channel.get("name", "") for channel in _children(item, "channel")),
    )


def _number(text: str | None, default: float) -> float:
    """A finite number; `default` where there is none."""
    try:
        value = float(text or "")
    except ValueError:
        return default
    return value if math.isfinite(value) else default


def _moment(text: str) -> tuple[int, bool] | None:
    """Microseconds since 1970, and whether they count from 1970 in UTC; None if the text is no time."""
    try:
        moment = datetime.fromisoformat(text.strip())
        known = moment.tzinfo is not None
        since = moment.astimezone(UTC) if known else moment.replace(tzinfo=UTC)
    except (ValueError, OverflowError):
        return None
    return (since - datetime(1970, 1, 1, tzinfo=UTC)) // datetime.resolution, known


def _device(root: ElementTree.Element) -> Device:
    """What the recording's own attributes tell."""
    pairs = (item for group in _children(root, "customAttributes") for item in group)
    said = {item.get("key", ""): (item.get("value") or "").strip() for item in pairs}
    model, serial = said.get("sensorType") or None, said.get("sensorSerialNumber") or None
    return Device(model, serial, said.get("sensorFirmwareVersion") or None)
