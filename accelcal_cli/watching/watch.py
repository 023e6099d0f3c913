"""`accelcal watch`: a recording is calibrated while it grows, in one pass (F: on the device itself).

Bytes are taken in steps of equal length. Whenever enough is new, a copy of the state is treated
as if the recording ended there, and is judged, while the original continues. So the coefficients are those
that `calibrate` finds in the same bytes, bit for bit.
"""

from __future__ import annotations

import copy
import tempfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.declared import as_json, json_or_null
from accelcal_cli.core.errors import (
    AccelcalError,
    OutputError,
    UnreadableError,
    is_environment_error,
    output_error,
)
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.paths import is_file
from accelcal_cli.core.points import Windows
from accelcal_cli.core.recording import Chunk, Intake, Reader, Recording
from accelcal_cli.core.results import Judgement
from accelcal_cli.core.settings import Settings
from accelcal_cli.core.system import temporary_folder
from accelcal_cli.core.unpacking import GZIP_MAGIC, packing_of
from accelcal_cli.formats.raw import folder_layout, named_layout
from accelcal_cli.judge.change import change_reason
from accelcal_cli.judge.quality import check
from accelcal_cli.output import report as reports
from accelcal_cli.output.files import looking_at
from accelcal_cli.output.sentences import explained, sentence
from accelcal_cli.pipeline import procedures, survey
from accelcal_cli.pipeline.apply import compared_along_time
from accelcal_cli.pipeline.calibrate import OwnCalibration, summarise_first_pass, with_collection_time
from accelcal_cli.pipeline.facts import FactsObserver

STEP_BYTES = 1 << 13
"""Length of a step, in which bytes are taken in: where events can happen does not depend on the input."""

HEAD_BYTES = 1 << 20
"""Bytes that show how a recording is read; no format looks further."""

OPENING_STEPS = 8
"""Steps after which all that has come is read again, as long as it is less than HEAD_BYTES."""

LOOK_S = 60
"""Length [s] of recording between two looks at what is new."""

CHECK_H = 6
"""Length [h] of recording after which the coefficients in use are checked again."""

GROWTH = 10
"""A fit is tried again when a GROWTH-th more orientations are known."""

BETTER = 0.9
"""Largest error over all directions of new coefficients, as a fraction of that of the ones in use."""

KEPT_H = 24
"""Length [h] of the stretch that profile `paper` checks its coefficients against."""

GZIP_WINDOW = zlib.MAX_WBITS | 16
"""Tells zlib to expect the header and the checksum of gzip."""

UNPACKED_BYTES = 1 << 20
"""Most bytes that a gzip file gives at a time: damaged ones unpack to a thousand times their size."""

Event = dict[str, Any]


@dataclass(frozen=True, slots=True)
class ActiveCoefficients:
    """The coefficients in use.

    Attributes:
        worst_mg: their largest error over the sphere.
    """

    calibration: Calibration
    worst_mg: float


@dataclass(frozen=True, slots=True, eq=False)
class RowsToCalibrate:
    """Rows, and the coefficients that apply to them."""

    recording: Recording
    chunk: Chunk
    calibration: Calibration


@dataclass(slots=True)
class StepResult:
    """Events and rows that some bytes led to."""

    events: list[Event] = field(default_factory=list)
    rows: list[RowsToCalibrate] = field(default_factory=list)


class Unpacker:
    """Unpacks gzip as it comes, member after member; passes any other bytes on as they are.

    Args:
        source: what errors call the recording.
    """

    def __init__(self, source: Path) -> None:
        self._source = source
        self._first = b""
        self._plain: bool | None = None
        self._stream = zlib.decompressobj(GZIP_WINDOW)

    def take(self, data: bytes) -> Iterator[bytes]:
        """Unpack the next bytes, in pieces of at most UNPACKED_BYTES.

        Raises:
            UnreadableError: they are damaged.
        """
        data, self._first = self._first + data, b""
        if self._plain is None and data != GZIP_MAGIC[:1]:
            self._plain = not data.startswith(GZIP_MAGIC)
        if self._plain is None:
            self._first = data
        elif self._plain:
            yield data
        else:
            yield from self._unpacked(data)

    def _unpacked(self, packed: bytes) -> Iterator[bytes]:
        piece = b""
        while packed or len(piece) == UNPACKED_BYTES:
            if self._stream.eof:
                packed = packed.lstrip(b"\0")  # zeros may fill up a file behind its members
                if not packed:
                    return
                self._stream = zlib.decompressobj(GZIP_WINDOW)
            try:
                piece = self._stream.decompress(packed, UNPACKED_BYTES)
            except zlib.error as error:
                what, hint = f"damaged gzip data ({error})", "copy it again from its source"
                raise UnreadableError(what, path=self._source, hint=hint) from error
            packed = self._stream.unused_data if self._stream.eof else self._stream.unconsumed_tail
            if piece:
                yield piece


class LastDay(procedures.TimedCellProcedure):
    """Keeps the windows of the last KEPT_H hours, for a procedure that keeps nothing along time itself.

    Blocks of time and samples count from the first block that is kept, so that memory does not grow.
    """

    def __init__(self, recording: Recording, settings: Settings) -> None:
        super().__init__(recording, settings)
        self._first_sample = 0

    def see(self, chunk: Chunk) -> None:
        """Note when hours begin, and forget the first block where there are too many."""
        super().see(replace(chunk, first_sample=chunk.first_sample - self._first_sample))
        hours = self.collector.block_samples // self.hour_samples
        while len(self._begun_us) >= KEPT_H + hours:
            self.collector.forget_first_block()
            del self._begun_us[:hours]
            self._first_sample += self.collector.block_samples
            self._means = None

    def see_still(self, windows: Windows) -> None:
        """Take windows in; those that were decided on late may lie before what is kept."""
        kept = windows.select(windows.first_sample >= self._first_sample)
        self.collector.add(replace(kept, first_sample=kept.first_sample - self._first_sample))
        self._means = None


class LivePass:
    """One pass over a recording that grows, by its bytes; `Watch` ends copies of it, and judges these."""

    def __init__(self, recording: Recording, intake: Intake, settings: Settings) -> None:
        self.recording, self._intake = recording, intake
        self.method = procedures.make_method(recording, settings)
        self._facts = FactsObserver(recording, self.method.rest_lsb, self.method.segmenter.gaps)
        own, timed = self.method.procedure, procedures.TimedCellProcedure
        self.along_time = own if isinstance(own, timed) else LastDay(recording, settings)
        """The procedure that coefficients are checked against."""
        paper, counter = procedures.PaperProcedure, procedures.SubsetCounter
        collecting = own if isinstance(own, paper) else counter(recording, settings)
        self._subsets = collecting.collector
        observers: list[survey.Observer] = [self._facts, own, self.along_time, collecting]
        self._observers = [*dict.fromkeys(observers)]

    @property
    def samples(self) -> int:
        """Number of rows that have come."""
        return self._facts.samples

    @property
    def hours(self) -> float:
        """Length [h] of these rows."""
        return self.samples / self.recording.rate_hz / 3600

    def take(self, data: bytes, *, last: bool = False) -> list[Chunk]:
        """Take the next bytes in, and return the rows that they settle.

        Raises:
            UnreadableError: the recording cannot be read on.
        """
        try:
            chunks = list(self._intake.take(data, last=last))
        except UnreadableError as error:
            error.path = self.recording.path  # not the temporary file that the head was read from
            raise
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
        """Return the judgement of `calibrate`; call after the last bytes."""
        facts = self.method.completed(self._facts.result())
        found, _ = summarise_first_pass(self.recording, facts, self.method, settings)
        judgement = OwnCalibration(settings).verdict(None, found).judgement
        return with_collection_time(judgement, self._subsets, self.recording)

    def event(self, name: str, taken: int) -> Event:
        """Return an event, which says how far the pass has come."""
        facts = self._facts.result()
        dated = all(problem.code != "no_start_time" for problem in facts.problems)
        return {
            "event": name,
            "bytes": taken,
            "samples": self.samples,
            "hours": round(self.hours, 6),
            "time": iso_time(facts.last_us, facts.utc_offset_s) if dated else None,
        }

    def subsets(self) -> list[list[int]]:
        """Return the points in each of F's nine subsets, rows n, 0, p and columns x, y, z."""
        return self._subsets.fit.filled()


class Watch:
    """Calibrates a recording while it grows.

    Args:
        source: what errors call the recording; files next to it may say how it is read.
    """

    def __init__(self, source: Path, options: ReadOptions, settings: Settings) -> None:
        procedures.fitting(settings)
        self._source, self._options, self._settings = source, options, settings
        self._waiting = b""
        """Bytes that make no whole step."""
        self._head = b""
        """Steps that came before the pass began."""
        self._pass: LivePass | None = None
        self._taken = 0
        """Bytes that the pass has taken in."""
        self._active: ActiveCoefficients | None = None
        self._drifted = False
        """The coefficients in use were found not to hold."""
        self._first_row = 0
        """Number of the first row that can be calibrated."""
        self._looked_at = 0
        """Samples at the last look."""
        self._orientations = 0
        """Orientations at the last fit."""
        self._checked_h = 0
        """Hours at the last fit or check."""
        self._subset_points = 0
        """Points in the subsets when progress was last reported."""

    def take(self, data: bytes) -> StepResult:
        """Take the next bytes in.

        Raises:
            AccelcalError: they cannot be read.
        """
        result, data = StepResult(), self._waiting + data
        whole = len(data) // STEP_BYTES * STEP_BYTES
        for start in range(0, whole, STEP_BYTES):
            self._step(data[start : start + STEP_BYTES], result)
        self._waiting = data[whole:]
        return result

    def end(self) -> StepResult:
        """Return what is known if nothing follows; more may follow nevertheless.

        Raises:
            AccelcalError: the recording cannot be read.
        """
        result, place = StepResult(), self._taken + len(self._head) + len(self._waiting)
        if self._pass is None:
            ended, chunks = self._whole(self._head + self._waiting)
        else:
            ended = copy.deepcopy(self._pass)
            chunks = ended.take(self._waiting, last=True)
        self._add_rows(ended, chunks, result)
        judgement = ended.judged(self._settings)
        result.events.append(ended.event("ended", place) | self._findings(judgement))
        return result

    def _whole(self, data: bytes) -> tuple[LivePass, list[Chunk]]:
        """Make a pass that has taken all of a recording in, and return it with its rows."""
        with self._opened(data) as reader:
            ended = self._new_pass(reader)
            return ended, ended.take(data, last=True)

    def _new_pass(self, reader: Reader) -> LivePass:
        recording = replace(reader.recording, path=self._source, total_bytes=0, samples=None, duration_s=None)
        return LivePass(recording, reader.intake(), self._settings)

    @contextmanager
    def _opened(self, head: bytes) -> Iterator[Reader]:
        """Open the first bytes, in a folder with copies of the layouts that lie next to the recording."""
        if not head:
            raise UnreadableError("nothing came", path=self._source)
        if (packing := packing_of(head)) is not None:
            hint = f"unpack it on the way: {packing.command} -c FILE | accelcal watch -"
            what = "is compressed twice" if packing.magic == GZIP_MAGIC else f"is packed with {packing.name}"
            raise UnreadableError(what, path=self._source, hint=hint)
        layouts = {}
        for layout in self._layouts():
            with looking_at(layout, UnreadableError), layout.open("rb") as file:
                layouts[layout.name] = file.read(HEAD_BYTES)  # one as long is refused
        with ExitStack() as stack:
            try:
                folder = stack.enter_context(temporary_folder())
                path = folder / (self._source.name.strip("-") or "stdin")
                path.write_bytes(head)
                for name, content in layouts.items():
                    (folder / name).write_bytes(content)
            except OSError as error:
                raise output_error(error, Path(tempfile.gettempdir())) from error
            try:
                with survey.open_marked(path, self._options) as reader:
                    yield reader
            except AccelcalError as error:
                originals = {path: self._source} | {folder / one.name: one for one in self._layouts()}
                error.path = None if error.path is None else originals.get(Path(error.path), error.path)
                raise

    def _layouts(self) -> list[Path]:
        """Return the files next to the recording that may say how it is read."""
        return [*filter(is_file, (named_layout(self._source), folder_layout(self._source)))]

    def _step(self, data: bytes, result: StepResult) -> None:
        if self._pass is None:
            self._head += data
            if len(self._head) >= HEAD_BYTES:
                self._begin(result)
            elif not len(self._head) // STEP_BYTES % OPENING_STEPS:
                self._look_ahead(result)
            return
        chunks = self._pass.take(data)
        self._taken += len(data)
        self._add_rows(self._pass, chunks, result)
        if self._pass.samples >= self._looked_at + LOOK_S * self._pass.recording.rate_hz:
            self._look(self._pass, self._taken, result)

    def _look_ahead(self, result: StepResult) -> None:
        """Look at all that has come, before the pass begins."""
        try:
            ended, _ = self._whole(self._head)
        except AccelcalError as error:  # what is missing may still come
            if isinstance(error, OutputError) or is_environment_error(error):
                raise
            return
        self._look(ended, len(self._head), result, ended=True)

    def _begin(self, result: StepResult) -> None:
        """Begin the pass, which takes each byte in once."""
        head, self._head = self._head, b""
        with self._opened(head) as reader:
            begun = self._new_pass(reader)
            chunks = [chunk for start in range(0, len(head), STEP_BYTES)
                      for chunk in begun.take(head[start : start + STEP_BYTES])]  # fmt: skip
        self._pass, self._taken = begun, len(head)
        self._add_rows(begun, chunks, result)
        self._look(begun, self._taken, result)

    def _add_rows(self, live: LivePass, chunks: list[Chunk], result: StepResult) -> None:
        if self._active is None:
            return
        for chunk in chunks:
            part = chunk.part(min(len(chunk), max(0, self._first_row - chunk.first_sample)), len(chunk))
            if len(part):
                result.rows.append(RowsToCalibrate(live.recording, part, self._active.calibration))

    def _look(self, live: LivePass, taken: int, result: StepResult, *, ended: bool = False) -> None:
        """Report progress, and fit where that is worth it.

        Args:
            ended: the pass knows that nothing follows.
        """
        self._looked_at = live.samples
        subsets, known = live.subsets(), live.method.procedure.orientations()
        if (points := sum(map(sum, subsets))) > self._subset_points:
            self._subset_points = points
            event = live.event("progress", taken)
            result.events.append(event | {"subsets": subsets, "orientations": known})
        hour = int(live.hours)
        grown = GROWTH * known >= (GROWTH + 1) * self._orientations and known > self._orientations
        due = self._active is not None and hour >= self._checked_h + CHECK_H
        if not grown and not due:
            return
        self._orientations, self._checked_h = max(known, self._orientations), hour
        if not ended:
            live = copy.deepcopy(live)
            live.take(b"", last=True)
        self._fit(live, taken, result, due=due)

    def _fit(self, ended: LivePass, taken: int, result: StepResult, *, due: bool) -> None:
        """Replace the coefficients in use if better ones are found; if a check is due, check them first."""
        judgement, active = ended.judged(self._settings), self._active
        if active is not None and due and not self._drifted:
            self._check(active, ended, taken, result)
        if judgement.calibration is None or (active and active.calibration == judgement.calibration):
            return
        sphere, worst_mg = judgement.sphere, judgement.coverage.worst_direction_mg
        worst_mg = worst_mg if sphere is None else sphere.worst_direction
        new = ActiveCoefficients(judgement.calibration, float("inf") if worst_mg is None else worst_mg)
        if active is not None and not self._drifted and new.worst_mg > BETTER * active.worst_mg:
            return
        name = "fitted" if active is None else "refitted"
        result.events.append(ended.event(name, taken) | self._findings(judgement))
        if active is None:
            self._first_row = (self._pass or ended).samples
        self._active, self._drifted = new, False

    def _check(self, active: ActiveCoefficients, ended: LivePass, taken: int, result: StepResult) -> None:
        """Compare the coefficients in use with all that came, and report it if they no longer hold."""
        along = compared_along_time(active.calibration, ended.along_time)
        if along.compared is None:
            return
        checked = check(along.compared, along.change, along.blocks, self._settings.max_error_mg)
        last = checked.periods[-1] if checked.periods else None
        if last is None or not last.degraded:
            return
        self._drifted = True
        errors = {"in_force_mg": round(last.given_mg, 4), "new_mg": round(last.unseen_mg, 4)}
        change = change_reason(along.change, None, followed=False)
        text = {"message": None if change is None else sentence(change)}
        result.events.append(ended.event("drifted", taken) | errors | text)

    def _findings(self, judgement: Judgement) -> Event:
        """Return the parts of the report that a judgement fills."""
        return {
            "outcome": str(judgement.outcome),
            "reason": judgement.reason.code,
            "values": dict(judgement.reason.values),
            "message": explained(judgement.reason, judgement.notes),
            "calibration": reports.calibration_json(judgement, procedures.optimizer_json(self._settings)),
            "calibration_error_mg": json_or_null(
                reports.calibration_error(judgement.sphere, judgement.sphere_before)
            ),
            "coverage": as_json(reports.coverage_section(judgement.coverage)),
        }
