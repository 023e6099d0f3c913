"""Writes Unisens folders from the schema of Unisens 2.0, with struct and plain text."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.formats.expected import Expected

START = "2008-07-04T13:27:57.250"
START_US = 1_215_178_077_250_000
SERIAL = "01234"


def signal(
    name: str,
    kind: str,
    *,
    channels: tuple[str, ...] = ("accX", "accY", "accZ"),
    data_type: str = "int16",
    order: str = "LITTLE",
    **said: object,
) -> str:
    known = {"unit": "g", "sampleRate": 64, "lsbValue": 0.00048828125, "adcResolution": 16} | said
    attributes = " ".join(f'{key}="{value}"' for key, value in known.items() if value is not None)
    return (
        f'<signalEntry {attributes} contentClass="{kind}" dataType="{data_type}" id="{name}">\n'
        f'  <binFileFormat endianess="{order}"/>\n'
        + "".join(f'  <channel name="{channel}"/>\n' for channel in channels)
        + "</signalEntry>\n"
    )


def description(*signals: str, start: str = START, own: str = "", before: str = "") -> str:
    return (
        f'{before}<?xml version="1.0" encoding="UTF-8"?>\n'
        '<unisens xmlns="http://www.unisens.org/unisens2.0" measurementId="#1"'
        f' timestampStart="{start}" version="2.0">\n'
        f'<customAttributes><customAttribute key="sensorSerialNumber" value="{SERIAL}"/>'
        f'<customAttribute key="sensorType" value="Move4"/>{own}</customAttributes>\n'
        + "".join(signals)
        + '<eventEntry contentClass="TRIGGER" id="trigger.csv" sampleRate="200"/>\n</unisens>\n'
    )


def folder(path: Path, text: str, **files: bytes) -> Path:
    path.mkdir(exist_ok=True)
    (path / "unisens.xml").write_text(text, encoding="utf-8")
    for name, data in files.items():
        (path / f"{name}.bin").write_bytes(data)
    return path / "unisens.xml"


def make(path: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    text = description(signal("acc.bin", "acc", sampleRate=rate_hz, lsbValue=1 / lsb_per_g))
    xml = folder(path, text, acc=counts.astype("<i2").tobytes(), ecg=bytes(50))
    times = START_US + np.rint(np.arange(len(counts)) * 1e6 / rate_hz).astype(np.int64)
    return Expected(xml, counts / lsb_per_g, rate_hz, times, serial=SERIAL)
