"""Faults of devices that their makers have published, as data: which recordings may have them.

`known_faults.json` has an object for each: `name` as the maker calls it, `model` of the device (or null),
`serial` with which serial numbers begin (or nothing), versions of `firmware` (empty: all), dates between
which the devices were `shipped` (or null), the `fault` in words, and its public `source`. Only what is
published stands there.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources

from accelcal_cli.core.reasons import Reason
from accelcal_cli.core.recording import Device


@dataclass(frozen=True, slots=True)
class KnownFault:
    """A published fault; see the module."""

    name: str
    model: str | None
    serial: str
    firmware: Sequence[str]
    shipped: Sequence[str] | None
    fault: str
    source: str

    def concerns(self, device: Device) -> bool:
        """Return True if a device may have the fault, by its model, serial number and firmware."""
        of_model = self.model in (None, device.model) and (device.serial or "").startswith(self.serial)
        return of_model and (not self.firmware or device.firmware in self.firmware)

    def caution(self) -> Reason:
        """Return the caution of a recording that may have the fault."""
        begun, ended = self.shipped or (None, None)
        when = {"shipped_from": begun, "shipped_to": ended}
        return Reason.of("known_fault", name=self.name, fault=self.fault, **when, source=self.source)


def of_device(device: Device) -> list[Reason]:
    """Return the cautions of the published faults that a device may have."""
    return [one.caution() for one in known_faults() if one.concerns(device)]


@cache
def known_faults() -> tuple[KnownFault, ...]:
    """Return all published faults."""
    text = resources.files("accelcal_cli.output").joinpath("known_faults.json").read_text("utf-8")
    return tuple(KnownFault(**one) for one in json.loads(text))
