"""A study's recordings, device by device, as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Device:
    """What recordings must share to be compared: values of one sensor, read in one way.

    Attributes:
        serial: as in the table.
        model, format: empty where the table has none.
    """

    serial: str
    model: str
    format: str

    @property
    def kind(self) -> tuple[str, str]:
        """Devices of one kind are compared with each other."""
        return self.model, self.format


@dataclass(frozen=True, slots=True, eq=False)
class Records:
    """The recordings of all devices that are known, n of them: by device, start and path.

    Attributes:
        devices: d of them; the recordings of device j are rows first[j] to first[j + 1].
        text: columns of text, by name.
        number: columns of numbers (n,), NaN for none.
        values, errors: (n, 12) parameters and their standard errors, in the table's units; NaN where
            the recording's model did not fit them.
        days: (n,) start of the recording [days since 1970]; NaN where it is not known.
        nameless: recordings that name no device; they are not among the n.
        failed: how many of these could not be read at all.
    """

    devices: tuple[Device, ...]
    first: Indices
    text: dict[str, list[str | None]]
    number: dict[str, Floats]
    values: Floats
    errors: Floats
    days: Floats
    nameless: int = 0
    failed: int = 0

    def __len__(self) -> int:
        return len(self.days)

    def rows(self, device: int) -> range:
        """The rows of a device."""
        return range(int(self.first[device]), int(self.first[device + 1]))

    def device_of(self) -> Indices:
        """The number of each row's device, (n,)."""
        return np.repeat(np.arange(len(self.devices)), np.diff(self.first))
