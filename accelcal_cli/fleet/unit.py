"""One device as it is shown."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from accelcal_cli.fleet.records import Device
from accelcal_cli.fleet.trends import Trend
from accelcal_cli.fleet.use import Use


class Verdict(StrEnum):
    """What to do with a device."""

    SERVICE = "service"
    WATCH = "watch"
    UNKNOWN = "unknown"
    GOOD = "good"


@dataclass(frozen=True, slots=True)
class Reason:
    """Why a device is to be serviced, or watched if that is not certain."""

    rule: str
    text: str
    certain: bool


@dataclass(frozen=True, slots=True)
class Unit:
    """A device.

    Attributes:
        rows: its recordings, in `Records`.
        firmware: all that its recordings name.
        counts: how many recordings had which use.
        damaged: recordings that lost bytes to damage.
        begin, end: starts of the first and the last recording that has a date.
        held_out_mg: median held-out error of its own calibrations; None where it has none.
        reference_c: temperature of its offsets; None where no recording has slopes.
        worst_lost_percent: the most that one of its recordings lost.
    """

    device: Device
    rows: range
    firmware: tuple[str, ...]
    counts: dict[Use, int]
    damaged: int
    begin: str | None
    end: str | None
    held_out_mg: float | None
    reference_c: float | None
    worst_lost_percent: float
    trends: tuple[Trend, ...]
    reasons: tuple[Reason, ...] = field(default=())

    def counted(self, *wanted: Use) -> int:
        """How many recordings had one of these uses."""
        return sum(self.counts.get(use, 0) for use in wanted)

    @property
    def recordings(self) -> int:
        """Its recordings, copies counted once."""
        return sum(self.counts.values()) - self.counted(Use.COPY)

    @property
    def refused(self) -> int:
        """Recordings that could not be calibrated by themselves."""
        return self.counted(Use.REFUSED, Use.BORROWED)

    @property
    def verdict(self) -> Verdict:
        """The worst that the reasons say."""
        if self.reasons:
            return Verdict.SERVICE if any(one.certain for one in self.reasons) else Verdict.WATCH
        told = bool(self.trends) or self.counted(Use.GOOD) > 0
        return Verdict.GOOD if told else Verdict.UNKNOWN
