"""What a calibration changes: the activity that the same rows show raw, calibrated without misalignment, and
calibrated, measured side by side in one pass."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

from accelcal_cli.core.calibration import Calibration, Transform
from accelcal_cli.core.recording import Chunk, Recording, Validity
from accelcal_cli.core.results import Judgement
from accelcal_cli.output.report import ReportInput
from accelcal_cli.pipeline.activity import Activity, Measuring, Table

RAW, SIMPLER, CALIBRATED, TRUE = "raw", "without_misalignment", "calibrated", "true"
LEFT_OUT = {"filled": Validity.FILLED, "clipped": Validity.CLIPPED, "recovered": Validity.RECOVERED}
"""Rows that are no measurements, or not whole ones, by what they are called."""

EPOCH_S = 5
"""Length of an epoch where none is asked for, as in GGIR and in most of the sources."""
DIGITS = 4


@dataclass(frozen=True, slots=True)
class Version:
    """One way to read the counts of a recording.

    Attributes:
        name: what it is called in reports.
        model: name of its model; None where nothing was fitted.
    """

    name: str
    model: str | None
    transform: Transform


def versions(
    recording: Recording,
    calibration: Calibration | None,
    simpler: Calibration | None,
    precision_mg: float | None = None,
) -> list[Version]:
    """Raw, and what calibrations make of it; the full one comes last."""
    scale = recording.lsb_per_g
    made = [
        Version(name, one.model, Transform.of(one, scale, precision_mg))
        for name, one in ((SIMPLER, simpler), (CALIBRATED, calibration))
        if one is not None
    ]
    return [Version(RAW, None, Transform.of(None, scale)), *made]


def versions_of(data: ReportInput) -> list[Version]:
    """The versions of a result."""
    verdict: Judgement = data.judgement
    simpler = verdict.without_misalignment
    made = None if simpler is None else simpler.calibration
    return versions(data.recording, verdict.calibration, made, data.settings.precision_mg)


class Effect:
    """Measures versions of a recording as its chunks pass."""

    def __init__(self, made: list[Version], recording: Recording, epoch_s: int) -> None:
        self.versions = made
        self._measuring = Measuring(len(made), epoch_s, recording.rate_hz)
        self._left_out = dict.fromkeys(LEFT_OUT, 0)

    def see(self, chunk: Chunk) -> list[Table]:
        """Take a chunk in; the epochs that it completes."""
        if not len(chunk):
            return []
        xyz, times = [one.transform.apply(chunk) for one in self.versions], chunk.time_us
        if chunk.validity is not None and chunk.validity.any():
            for name, value in LEFT_OUT.items():
                self._left_out[name] += int((chunk.validity == value).sum())
            kept = chunk.validity == Validity.MEASURED
            xyz, times = [[axis[kept] for axis in one] for one in xyz], times[kept]
        return self._measuring.feed(times, xyz)

    def watch(self, chunks: Iterable[Chunk]) -> Iterator[Chunk]:
        """The same chunks, which are taken in as they pass."""
        for chunk in chunks:
            self.see(chunk)
            yield chunk

    def finish(self) -> list[Table]:
        """The end of the recording: the epochs that it completes."""
        return self._measuring.finish()

    def result(self) -> dict[str, Any]:
        """The report's `effect` object, after `finish`."""
        found = self._measuring
        pairs = zip(self.versions, found.result(), strict=True)
        return {
            "epoch_s": found.epoch_s,
            "epochs": found.epochs,
            "short_epochs": found.short,
            "left_out": dict(self._left_out),
            "versions": {one.name: {"model": one.model, **_rounded(activity)} for one, activity in pairs},
        }


def _rounded(activity: Activity) -> dict[str, float | None]:
    return {name: None if value is None else round(value, DIGITS) for name, value in asdict(activity).items()}
