"""Writes EDF, EDF+ and BDF files byte by byte from www.edfplus.info/specs, with struct alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from tests.formats.expected import Expected

START_US = 1_709_510_400_000_000
DATE, TIME = "04.03.24", "00.00.00"
EQUIPMENT = "Wrist_Logger"
RECORDING = f"Startdate 04-MAR-2024 X X {EQUIPMENT}"


@dataclass(frozen=True)
class Signal:
    """values: (records, samples) digital. limits: physical and digital minimum and maximum."""

    label: str
    unit: str
    limits: tuple[str, str, int, int]
    values: np.ndarray


def fixed(text: object, width: int) -> bytes:
    data = str(text).encode("latin-1")
    assert len(data) <= width
    return data.ljust(width)


def annotations(texts: Sequence[str], size: int = 16) -> np.ndarray:
    """Texts such as `+0`, one a record, as the samples of the signal of annotations."""
    data = b"".join((text.encode() + b"\x14\x14\0").ljust(2 * size, b"\0") for text in texts)
    return np.frombuffer(data, "<i2").reshape(len(texts), size)


def onsets(texts: Sequence[str]) -> Signal:
    return Signal("EDF Annotations", "", ("-1", "1", -32768, 32767), annotations(texts))


def header(
    signals: Sequence[Signal],
    seconds: str = "1",
    *,
    reserved: str = "",
    records: int | None = None,
    start: tuple[str, str] = (DATE, TIME),
    recording: str = RECORDING,
    bdf: bool = False,
) -> bytes:
    count = len(signals[0].values) if records is None else records
    data = b"\xffBIOSEMI" if bdf else fixed("0", 8)
    data += fixed("X X X X", 80) + fixed(recording, 80) + fixed(start[0], 8) + fixed(start[1], 8)
    data += fixed(256 * (1 + len(signals)), 8) + fixed(reserved, 44) + fixed(count, 8)
    data += fixed(seconds, 8) + fixed(len(signals), 4)
    data += b"".join(fixed(one.label, 16) for one in signals)
    data += b"".join(fixed("", 80) for _ in signals)
    data += b"".join(fixed(one.unit, 8) for one in signals)
    for place in range(4):
        data += b"".join(fixed(one.limits[place], 8) for one in signals)
    data += b"".join(fixed("", 80) for _ in signals)
    data += b"".join(fixed(one.values.shape[1], 8) for one in signals)
    return data + b"".join(fixed("", 32) for _ in signals)


def digits(values: np.ndarray, bdf: bool = False) -> bytes:
    data = values.astype("<i4" if bdf else "<i2").tobytes()
    return b"".join(data[at : at + 3] for at in range(0, len(data), 4)) if bdf else data


def records(signals: Sequence[Signal], bdf: bool = False) -> list[bytes]:
    """One piece of bytes for each record."""
    number = len(signals[0].values)
    return [b"".join(digits(one.values[record], bdf) for one in signals) for record in range(number)]


def written(signals: Sequence[Signal], seconds: str = "1", *, bdf: bool = False, **kinds: object) -> bytes:
    return header(signals, seconds, bdf=bdf, **kinds) + b"".join(records(signals, bdf))  # type: ignore[arg-type]


def xyz(counts: np.ndarray, samples: int, lsb_per_g: float = 256.0, names: str = "Acc {}") -> list[Signal]:
    """Three signals in g, whose physical limits are exactly their digital ones."""
    limit = str(Fraction(2048) / Fraction(lsb_per_g))
    limits = (f"-{limit}", limit, -2048, 2048)
    return [
        Signal(names.format(axis), "g", limits, column.reshape(-1, samples))
        for axis, column in zip("XYZ", counts.T, strict=True)
    ]


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    path = folder / "made.edf"
    samples = round(rate_hz)
    signals = xyz(counts, samples, lsb_per_g)
    texts = [f"+{number}" for number in range(len(counts) // samples)]
    path.write_bytes(written([*signals, onsets(texts)], reserved="EDF+C"))
    times = START_US + np.arange(len(counts)) * 1_000_000 // samples
    return Expected(path, counts / lsb_per_g, rate_hz, times)
