"""What one pass over a recording finds out: length, gaps, problems, measured rate."""

from __future__ import annotations

from dataclasses import dataclass

from accelcal_cli.core.recording import Problem
from accelcal_cli.core.zones import ZoneChange


@dataclass(frozen=True, slots=True)
class Gap:
    """Time that is missing between two consecutive rows.

    Attributes:
        sample: number of the first sample after the gap.
        start_us: time of the last sample before it.
        seconds: from that sample to the next one.
    """

    sample: int
    start_us: int
    seconds: float


@dataclass(frozen=True, slots=True)
class Jumps:
    """Where the times of consecutive rows do not go on.

    Attributes:
        gaps: how many times time is missing, and how much in all [us].
        back: how many times a stamp repeats the one before or goes back.
    """

    gaps: int = 0
    gap_us: int = 0
    back: int = 0


@dataclass(frozen=True, slots=True)
class Facts:
    """A recording as it was found.

    Attributes:
        first_us, last_us: times of the first and last sample; None without samples.
        rate_hz: measured: samples over time within unbroken stretches; None if unknown.
        gaps_omitted: gaps beyond those that are listed.
        still_error_mg: mean | |v| - 1 g | of the raw means of all plausible still windows; None
            without any.
        utc_offset_s: seconds that the device's clock is ahead of UTC; None where its zone, or the
            time of the start, is not known.
        lost_bytes, used_bytes: of the (uncompressed) file: damaged ones, and those that the samples
            were made of.
        zone_change: the zone changed its offset from UTC during the recording; None if not, or unknown.
    """

    samples: int
    first_us: int | None
    last_us: int | None
    rate_hz: float | None
    gaps: tuple[Gap, ...]
    gaps_omitted: int
    problems: tuple[Problem, ...]
    filled: int
    clipped: int
    has_temperature: bool
    has_gyroscope: bool
    still_error_mg: float | None = None
    utc_offset_s: int | None = None
    lost_bytes: int = 0
    used_bytes: int = 0
    jumps: Jumps = Jumps()
    zone_change: ZoneChange | None = None

    def lost_percent(self) -> float:
        """Share of the recording's bytes that damage has taken."""
        return 100 * self.lost_bytes / max(1, self.lost_bytes + self.used_bytes)
