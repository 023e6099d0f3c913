"""`accelcal watch`: a recording is calibrated while it grows, in one pass (F: on the device itself).

Bytes are taken in steps of equal length. Whenever enough is new, what has come so far is judged as if the
recording ended there: by a copy, which is told that nothing follows, while the original goes on. So the
coefficients are those that `calibrate` finds in the same bytes, bit for bit. The copy is made as the file of
the state is (`core/freeze.py`); what is forgotten there would show at once.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO

from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.errors import (
    AccelcalError,
    OutputError,
    UnreadableError,
    is_environment_error,
    output_error,
)
from accelcal_cli.core.formats import GZIP_MAGIC, ReadOptions
from accelcal_cli.core.freeze import frozen, thawed
from accelcal_cli.core.recording import Chunk, Reader, Recording
from accelcal_cli.core.results import Judgement
from accelcal_cli.core.settings import Settings
from accelcal_cli.core.system import temporary_folder
from accelcal_cli.formats.raw import folder_layout, is_file, named_layout
from accelcal_cli.judge.change import told
from accelcal_cli.judge.quality import check
from accelcal_cli.output import report as reports
from accelcal_cli.output.files import looking_at
from accelcal_cli.pipeline import survey
from accelcal_cli.pipeline.quality import held_against
from accelcal_cli.pipeline.stage import Event, Stage

STEP_BYTES = 1 << 13
HEAD_BYTES = 1 << 20
"""So much of a recording shows how it is read; no format looks further."""

OPENING_STEPS = 8
"""While less has come, all of it is read anew after so many steps."""

LOOK_S = 60
CHECK_BLOCKS = 6
"""Hours, after which coefficients are held against what came since."""

GROWTH = 10
"""With a tenth more orientations it is worth fitting again."""

BETTER = 0.9
"""Coefficients replace others whose largest error over the sphere is at least so many times theirs."""


@dataclass(frozen=True, slots=True)
class InForce:
    """Coefficients that are applied.

    Attributes:
        worst_mg: their largest error over the sphere.
    """

    calibration: Calibration
    worst_mg: float


@dataclass(slots=True)
class Standing:
    """Where a watch stands: all that it has to remember.

    Attributes:
        taken: bytes of the recording that are in the stage.
        stage: None until its head has come.
        head_sha256: of the head.
        force: None before the first fit.
        rows_from: number of the first row that can be calibrated.
        orientations: how many were known at the last fit; samples: how many rows had come at the last look.
        checked: hour of the last fit or check.
        subsets: points in them when they were last told.
        drifted: the coefficients in force were said not to hold.
    """

    taken: int = 0
    stage: Stage | None = None
    head_sha256: str = ""
    force: InForce | None = None
    rows_from: int | None = None
    orientations: int = 0
    samples: int = 0
    checked: int = 0
    subsets: int = 0
    drifted: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """Rows, and what applies to them."""

    recording: Recording
    chunk: Chunk
    calibration: Calibration


@dataclass(slots=True)
class Happened:
    """What came of some bytes."""

    events: list[Event] = field(default_factory=list)
    rows: list[Calibrated] = field(default_factory=list)


class Watch:
    """Calibrates a recording while it grows.

    Args:
        source: what errors call the recording; files beside it may say how it is read.
        standing: where an earlier watch stood; None to begin.
    """

    def __init__(
        self, source: Path, options: ReadOptions, settings: Settings, standing: Standing | None = None
    ) -> None:
        survey.fitting(settings)
        self._source, self._options, self._settings = source, options, settings
        self.standing = standing or Standing()
        self._waiting = b""
        self._head = b""

    def go_on_in(self, file: IO[bytes]) -> None:
        """Go to the byte of a file at which an earlier watch stopped.

        Raises:
            UnreadableError: it is not the recording that was watched.
            OSError: it cannot be read.
        """
        standing = self.standing
        if not standing.taken:
            return
        head = b""
        while len(head) < HEAD_BYTES and (more := file.read(HEAD_BYTES - len(head))):
            head += more
        if hashlib.sha256(head).hexdigest() != standing.head_sha256 or file.seek(0, 2) < standing.taken:
            what, hint = "is not the recording of the state", "give another file to --state, or remove it"
            raise UnreadableError(what, path=self._source, hint=hint)
        file.seek(standing.taken)

    def take(self, data: bytes) -> Happened:
        """Take the next bytes in.

        Raises:
            AccelcalError: they cannot be read.
        """
        happened, data = Happened(), self._waiting + data
        whole = len(data) // STEP_BYTES * STEP_BYTES
        for start in range(0, whole, STEP_BYTES):
            self._step(data[start : start + STEP_BYTES], happened)
        self._waiting = data[whole:]
        return happened

    def end(self, *, for_good: bool = True) -> Happened:
        """What is known when nothing follows; `standing` stays as it is, so that more may follow later.

        Args:
            for_good: the rows that only the end settles are given, too.

        Raises:
            AccelcalError: the recording cannot be read.
        """
        happened, place = Happened(), self.standing.taken + len(self._head) + len(self._waiting)
        stage, chunks = self._ended()
        if for_good:
            self._calibrated(stage, chunks, happened)
        judgement = stage.judged(self._settings)
        happened.events.append(self._event("ended", place, stage) | self._found(judgement))
        return happened

    def _ended(self) -> tuple[Stage, list[Chunk]]:
        if self.standing.stage is None:
            return self._whole(self._head + self._waiting)
        stage: Stage = thawed(frozen(self.standing.stage))
        return stage, stage.take(self._waiting, last=True)

    def _whole(self, data: bytes) -> tuple[Stage, list[Chunk]]:
        """A stage that has taken all of a recording in, and its rows."""
        with self._opened(data) as reader:
            stage = self._stage(reader)
            return stage, stage.take(data, last=True)

    def _stage(self, reader: Reader) -> Stage:
        recording = replace(reader.recording, path=self._source, total_bytes=0, samples=None, duration_s=None)
        return Stage(recording, reader.intake(), self._settings)

    @contextmanager
    def _opened(self, head: bytes) -> Iterator[Reader]:
        """A reader of the first bytes, beside what lies beside the recording."""
        if not head:
            raise UnreadableError("nothing came", path=self._source)
        if head.startswith(GZIP_MAGIC):
            hint = "unpack it on the way: gunzip -c FILE | accelcal watch -"
            raise UnreadableError("is compressed, and cannot be gone on with", path=self._source, hint=hint)
        layouts = {}
        for beside in self._layouts():
            with looking_at(beside, UnreadableError), beside.open("rb") as file:
                layouts[beside.name] = file.read(HEAD_BYTES)  # one as long is refused
        with ExitStack() as stack:
            try:
                folder = stack.enter_context(temporary_folder())
                path = folder / (self._source.name.strip("-") or "stdin")
                path.write_bytes(head)
                for name, held in layouts.items():
                    (folder / name).write_bytes(held)
            except OSError as error:
                raise output_error(error, Path(tempfile.gettempdir())) from error
            try:
                with survey.open_marked(path, self._options) as reader:
                    yield reader
            except AccelcalError as error:
                theirs = {path: self._source} | {folder / one.name: one for one in self._layouts()}
                error.path = error.path if error.path is None else theirs.get(Path(error.path), error.path)
                raise

    def _layouts(self) -> list[Path]:
        """Files beside the recording that may say how it is read."""
        return [*filter(is_file, (named_layout(self._source), folder_layout(self._source)))]

    def _step(self, data: bytes, happened: Happened) -> None:
        standing = self.standing
        if standing.stage is None:
            self._head += data
            self._open(happened)
            return
        chunks = standing.stage.take(data)
        standing.taken += len(data)
        self._calibrated(standing.stage, chunks, happened)
        if standing.stage.samples >= standing.samples + LOOK_S * standing.stage.recording.rate_hz:
            self._look(standing.stage, standing.taken, happened)

    def _open(self, happened: Happened) -> None:
        """Look at a recording of which not even the head has come."""
        if len(self._head) >= HEAD_BYTES:
            self._begin(happened)
            return
        if len(self._head) // STEP_BYTES % OPENING_STEPS:
            return
        try:
            stage, _ = self._whole(self._head)
        except AccelcalError as error:  # what is missing may still come
            if isinstance(error, OutputError) or is_environment_error(error):
                raise
            return
        self._look(stage, len(self._head), happened, ended=True)

    def _begin(self, happened: Happened) -> None:
        """The head has come: from now on bytes are taken in once."""
        standing, head = self.standing, self._head
        with self._opened(head) as reader:
            stage = self._stage(reader)
            chunks = [chunk for start in range(0, len(head), STEP_BYTES)
                      for chunk in stage.take(head[start : start + STEP_BYTES])]  # fmt: skip
        stage = thawed(frozen(stage))
        standing.stage, standing.taken = stage, len(head)
        standing.head_sha256, self._head = hashlib.sha256(head).hexdigest(), b""
        self._calibrated(stage, chunks, happened)
        self._look(stage, standing.taken, happened)

    def _calibrated(self, stage: Stage, chunks: list[Chunk], happened: Happened) -> None:
        force, first = self.standing.force, self.standing.rows_from
        if force is None or first is None:
            return
        for chunk in chunks:
            part = chunk.part(min(len(chunk), max(0, first - chunk.first_sample)), len(chunk))
            if len(part):
                happened.rows.append(Calibrated(stage.recording, part, force.calibration))

    def _look(self, stage: Stage, taken: int, happened: Happened, *, ended: bool = False) -> None:
        """See what is new, and fit where that is worth it.

        Args:
            ended: the stage was told that nothing follows.
        """
        standing = self.standing
        standing.samples = stage.samples
        subsets, known = stage.subsets(), stage.method.procedure.orientations()
        if (points := sum(map(sum, subsets))) > standing.subsets:
            standing.subsets = points
            event = self._event("progress", taken, stage)
            happened.events.append(event | {"subsets": subsets, "orientations": known})
        hour = int(stage.hours)
        grown = GROWTH * known >= (GROWTH + 1) * standing.orientations and known > standing.orientations
        old = standing.force is not None and hour >= standing.checked + CHECK_BLOCKS
        if not grown and not old:
            return
        standing.orientations, standing.checked = max(known, standing.orientations), hour
        if not ended:
            stage = thawed(frozen(stage))
            stage.take(b"", last=True)
        self._fit(stage, taken, happened, check_old=old)

    def _fit(self, stage: Stage, taken: int, happened: Happened, *, check_old: bool) -> None:
        standing, judgement = self.standing, stage.judged(self._settings)
        force = standing.force
        if force is not None and check_old and not standing.drifted:
            self._check(force, stage, taken, happened)
        if judgement.calibration is None or (force and force.calibration == judgement.calibration):
            return
        new = InForce(judgement.calibration, _worst_mg(judgement))
        if force is not None and not standing.drifted and new.worst_mg > BETTER * force.worst_mg:
            return
        name = "fitted" if force is None else "refitted"
        happened.events.append(self._event(name, taken, stage) | self._found(judgement))
        standing.force, standing.drifted = new, False
        if standing.rows_from is None:
            standing.rows_from = stage.samples if standing.stage is None else standing.stage.samples

    def _check(self, force: InForce, stage: Stage, taken: int, happened: Happened) -> None:
        """Hold the coefficients in force against all that came; says so if they no longer hold."""
        held = held_against(force.calibration, stage.along_time)
        if held.compared is None:
            return
        checked = check(held.compared, held.change, held.blocks, self._settings.max_error_mg)
        last = checked.periods[-1] if checked.periods else None
        if last is None or not last.degraded:
            return
        self.standing.drifted = True
        errors = {"in_force_mg": round(last.given_mg, 4), "new_mg": round(last.unseen_mg, 4)}
        text = told(held.change, None, followed=False)
        happened.events.append(self._event("drifted", taken, stage) | errors | {"message": text})

    def _event(self, name: str, taken: int, stage: Stage) -> Event:
        return {"event": name, "bytes": taken, **stage.place()}

    def _found(self, judgement: Judgement) -> Event:
        """What a judgement says, as in the report."""
        return {
            "outcome": str(judgement.outcome),
            "message": judgement.message,
            "calibration": reports.calibration_json(judgement, survey.optimizer_json(self._settings)),
            "sphere_mg": reports.sphere_json(judgement.sphere, judgement.sphere_before),
            "coverage": reports.coverage_json(judgement.coverage),
        }


def _worst_mg(judgement: Judgement) -> float:
    """The largest error over the sphere, as far as it is known."""
    if judgement.sphere is not None:
        return judgement.sphere.worst_direction
    worst = judgement.coverage.worst_direction_mg
    return float("inf") if worst is None else worst
