"""The chunks before the samples of a sound file by omconvert: form, device, channels, scales and the time.

Its metadata are lines of `key: value` in the chunks of a LIST of kind INFO: IART tells the device, ICMT the
first sample's time and the channels, and ICRD that time again.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from datetime import datetime, timedelta

from accelcal_cli.core.recording import Device

FORM = struct.Struct("<HHIIHH")
PCM, EXTENSIBLE = 1, 0xFFFE
USUAL_START = 1024
"""omconvert fills up what is before the samples to this length."""

CHUNK = struct.Struct("<4sI")
_PAIR = re.compile(r"([^:\n]{1,64}):([^\n]*)")
_EPOCH = datetime(1970, 1, 1)


@dataclass(frozen=True, slots=True)
class Header:
    """What is known before the samples; None or empty where it is not told.

    Attributes:
        data_start: where the samples begin, bytes.
        data_bytes: how many there are by the header.
        channels: of each sample, as the form says.
        rate_hz, bits, tag: the same, None without a form.
        labels: what each channel holds, by its number from 0, such as `Accel-X`.
        scales: by the same numbers: what 32768 stands for.
        start_us: time of the first sample [us].
        damage: what is wrong with the chunks, in plain words.
    """

    data_start: int
    data_bytes: int
    channels: int
    rate_hz: int
    bits: int
    tag: int
    labels: dict[int, str]
    scales: dict[int, float]
    start_us: int | None
    device: Device
    damage: str | None


def parse_header(head: bytes) -> Header | None:
    """Read the chunks; None without the form of the samples, or without the samples.

    Args:
        head: the file's first bytes.
    """
    chunks, start, size = _chunks(head)
    damage = None
    usual = head[USUAL_START - CHUNK.size : USUAL_START]
    if start is None and len(usual) == CHUNK.size and usual.startswith(b"data"):
        start, size = USUAL_START, CHUNK.unpack(usual)[1]
        damage = "the chunks before the samples are damaged"
    form = chunks.get(b"fmt ", b"")
    if start is None or len(form) < FORM.size:
        return None
    tag, channels, rate_hz, _, _, bits = FORM.unpack_from(form)
    said = _pairs(chunks.get(b"ICMT", b""))
    names = _pairs(chunks.get(b"IART", b""))
    device = Device(names.get("Device"), names.get("Id"), names.get("Firmware"))
    texts = (said.get("Time"), _text(chunks.get(b"ICRD", b"")))
    times = [time for time in map(_time, texts) if time is not None]
    return Header(
        data_start=start,
        data_bytes=size,
        channels=channels,
        rate_hz=rate_hz,
        bits=bits,
        tag=tag,
        labels=_numbered(said, "Channel-"),
        scales={k: value for k, text in _numbered(said, "Scale-").items() if (value := _positive(text))},
        start_us=times[0] if times else None,
        device=device,
        damage=damage,
    )


def _chunks(head: bytes) -> tuple[dict[bytes, bytes], int | None, int]:
    """The chunks by name, those of lists too, and where the samples begin and how many bytes they have."""
    found: dict[bytes, bytes] = {}
    at, end = 12, len(head)
    while at + CHUNK.size <= end:
        name, size = CHUNK.unpack_from(head, at)
        at += CHUNK.size
        if name == b"data":
            return found, at, size
        if name == b"LIST":
            at += 4
            continue
        found.setdefault(name, head[at : at + size])
        at += size + size % 2
    return found, None, 0


def _text(data: bytes) -> str:
    return data.split(b"\0")[0].decode("ascii", "replace")


def _pairs(data: bytes) -> dict[str, str]:
    """Lines of `key: value`."""
    return {match[1].strip(): match[2].strip() for match in _PAIR.finditer(_text(data))}


def _numbered(pairs: dict[str, str], prefix: str) -> dict[int, str]:
    """The values of keys such as `Channel-1`, by their numbers from 0."""
    keys = {key: key.removeprefix(prefix) for key in pairs if key.startswith(prefix)}
    return {int(number) - 1: pairs[key] for key, number in keys.items() if re.fullmatch(r"\d{1,2}", number)}


def _positive(text: str) -> float | None:
    """A number above 0."""
    return float(text) if re.fullmatch(r"\d{1,6}(\.\d{1,6})?", text) and float(text) > 0 else None


def _time(text: str | None) -> int | None:
    """Microseconds since 1970 of a time such as 2014-08-01 10:00:00.000."""
    try:
        moment = datetime.fromisoformat((text or "").strip())
    except ValueError:
        return None
    return None if moment.tzinfo else (moment - _EPOCH) // timedelta(microseconds=1)
