"""Xsens: text exports of MT Manager, and of the Movella DOT, behind lines such as `// Update Rate: 100.0Hz`.

Both have columns `PacketCounter` and `SampleTimeFine`, a counter of 32 bits: of 0.1 ms in MT Manager, of
us in the DOT (their user manuals), whose head has `DeviceTag:`, `OutputRate:` and `StartTime:` in the zone of
the phone. `FreeAcc_X` is acceleration without gravity. `Gyr_X` is in rad/s in MT Manager, in deg/s in DOT.
"""

from __future__ import annotations

import re

from accelcal_cli.core.recording import Device
from accelcal_cli.core.written_times import written_start
from accelcal_cli.formats.tables.clock import TICK_US, rate_above
from accelcal_cli.formats.tables.vendors import Head, Start, Stated, Vendor

NAMES = ("sampletimefine", "packetcounter")
KEY = re.compile(r"\W*([A-Za-z][A-Za-z ]*?)\s*:[\s,;\t]*(.*?)[\s,;\t]*$")
FREE = "FreeAcc_X, FreeAcc_Y and FreeAcc_Z are acceleration without gravity, and are not read"


def recognise(head: Head) -> bool:
    """Return True if a column has one of these names."""
    return any(name in head.plain for name in NAMES)


def describe(head: Head) -> Stated:
    """Return what the lines above the columns say."""
    found = [KEY.match(line) for line in head.lines]
    about = {match[1].lower().replace(" ", ""): match[2] for match in found if match}
    if not about:
        return Stated(title="Xsens", notes=_notes(head.plain))
    dot = "devicetag" in about or "outputrate" in about
    start = written_start(re.sub(r"(:\d\d)_(\d{1,6})\b", r"\1.\2", about.get("starttime", "")))
    model = "Movella DOT" if dot else "Xsens"
    return Stated(
        title=model if dot else "Xsens MT Manager",
        device=Device(model, about.get("devicetag") or about.get("deviceid"), about.get("firmwareversion")),
        rate_hz=rate_above("\n".join(head.lines)),
        start=None if start is None else Start(start.start_us),
        timezone=None if start is None else start.timezone,
        time_unit_us=1.0 if dot else TICK_US,
        counts_from_start=True,
        gyro_unit="deg/s" if dot else "rad/s",
        notes=_notes(head.plain),
    )


def _notes(names: tuple[str, ...]) -> tuple[str, ...]:
    return (FREE,) if any("freeacc" in name for name in names) else ()


VENDOR = Vendor("xsens", recognise, describe, by_names=True)
