"""One pass over a recording that grows, by its bytes; what `watch` ends a copy of, and judges."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.points import Windows
from accelcal_cli.core.recording import Chunk, Intake, Recording
from accelcal_cli.core.results import Judgement
from accelcal_cli.core.settings import Settings
from accelcal_cli.pipeline import survey
from accelcal_cli.pipeline.calibrate import OwnCalibration, surveyed
from accelcal_cli.pipeline.facts import FactsObserver
from accelcal_cli.pipeline.last_day import LastDay

Event = dict[str, Any]
Timed = survey.TimedCellProcedure


class Stage:
    """One pass over a recording that grows."""

    def __init__(self, recording: Recording, intake: Intake, settings: Settings) -> None:
        self.recording, self._intake = recording, intake
        self.method = survey.make_method(recording, settings)
        self._facts = FactsObserver(recording, self.method.rest_lsb, self.method.segmenter.gaps)
        own = self.method.procedure
        self.along_time = own if isinstance(own, Timed) else LastDay(recording, settings)
        """What coefficients are held against."""
        self._observers: tuple[survey.Observer, ...] = (
            (self._facts, own) if own is self.along_time else (self._facts, own, self.along_time)
        )

    @property
    def samples(self) -> int:
        """How many rows have come."""
        return self._facts.samples

    @property
    def hours(self) -> float:
        """How long these took."""
        return self.samples / self.recording.rate_hz / 3600

    def take(self, data: bytes, *, last: bool = False) -> list[Chunk]:
        """Take the next bytes in; gives the rows that they settle.

        Raises:
            UnreadableError: they cannot be read on.
        """
        chunks = list(self._intake.take(data, last=last))
        for chunk in chunks:
            for observer in self._observers:
                observer.see(chunk)
            self._see_still(self.method.segmenter.feed(chunk))
        if last:
            self._see_still(self.method.segmenter.finish())
        return chunks

    def _see_still(self, found: Iterable[Windows]) -> None:
        for windows in found:
            for observer in self._observers:
                observer.see_still(windows)

    def judged(self, settings: Settings) -> Judgement:
        """The judgement of `calibrate`; call after the last bytes."""
        facts = self.method.completed(self._facts.result())
        found, _ = surveyed(self.recording, facts, self.method, settings)
        return OwnCalibration(settings).judged(found).judgement

    def place(self) -> Event:
        """Where the pass is, for an event."""
        facts = self._facts.result()
        dated = all(problem.code != "no_start_time" for problem in facts.problems)
        return {
            "samples": self.samples,
            "hours": round(self.hours, 6),
            "time": iso_time(facts.last_us, facts.utc_offset_s) if dated else None,
        }

    def subsets(self) -> list[list[int]]:
        """Points of F's nine subsets, rows n, 0, p and columns x, y, z."""
        own = self.method.procedure
        held = own.collector if isinstance(own, survey.PaperProcedure) else self.along_time.subsets
        return held.fit.filled()
