"""Several recordings of one device as one: their points together, one fit and one judgement for all of them.

`pool` makes the pool's report; `apply_pool` applies its coefficients to one of its recordings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import product
from operator import add
from typing import Any

from accelcal_cli.collect.cells import CellCollector
from accelcal_cli.core.declared import from_json
from accelcal_cli.core.errors import Reason, UsageError, printable
from accelcal_cli.core.formats import unused_note, without
from accelcal_cli.core.points import WindowCounts
from accelcal_cli.core.recording import Recording
from accelcal_cli.core.results import Judgement, Outcome
from accelcal_cli.core.settings import Settings
from accelcal_cli.judge.model_ladder import held_out
from accelcal_cli.judge.verdict import SEEN, reason_pool_does_not_fit
from accelcal_cli.output.coefficients import calibration_of
from accelcal_cli.output.report import TAKEN, Member, PoolInput, build_pool, of_member
from accelcal_cli.output.report_reading import Document, check_sections
from accelcal_cli.output.sections import PoolSection, WindowUse
from accelcal_cli.pipeline import procedures
from accelcal_cli.pipeline.apply import errors_here
from accelcal_cli.pipeline.calibrate import Judge, RecordingRun, Survey, Verdict, open_run
from accelcal_cli.pipeline.jobs import FileStamp, Job, ProgressMaker, Request, Result, no_progress
from accelcal_cli.pipeline.outputs import prepare

FEWEST = 2
"""Fewest recordings of a pool."""


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """One recording's contribution to a pool."""

    member: Member
    recording: Recording
    samples: int
    collector: CellCollector
    counts: WindowCounts
    unused: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """Recordings that were fitted together, and the judgement of the fit."""

    parts: tuple[_Part, ...]
    verdict: Judgement
    windows: WindowUse


def pool(
    members: Sequence[Member],
    request: Request,
    progress: ProgressMaker = no_progress,
    copies: Sequence[Member] = (),
) -> dict[str, Any]:
    """Fit and judge the points of several recordings as `calibrate` does those of one.

    Their cells are added up as integers: neither their order nor how they are read makes a difference.
    Temperature is used if all have it. A recording that its pool makes worse was hardly recorded by the same
    device: it is left out, and the others are fitted again.

    Args:
        members: recordings of one device with the same counts per g and range, at least one.
        copies: recordings with the same content as a member; the report names them, and they are not read.

    Returns:
        The pool's report without `provenance`.

    Raises:
        UsageError: they differ, or the profile keeps no cells.
        UnreadableError: one cannot be read.
    """
    parts = [_part(member, request, progress) for member in members]
    first = parts[0].recording
    for part, name in product(parts[1:], ("lsb_per_g", "range_g")):
        if getattr(part.recording, name) != getattr(first, name):
            what = f"cannot be pooled with {first.path}: its {name} differs"
            raise UsageError(what, path=part.recording.path)
    settings = request.recording_settings
    fitted = _fitted(parts, settings)
    left_out: dict[_Part, Reason] = {}
    while misfits := _misfits(fitted, settings):
        left_out |= misfits
        rest = [part for part in fitted.parts if part not in misfits]
        if len(rest) < FEWEST:
            one = min(misfits, key=lambda part: str(part.member.path))
            why = Reason.of("recordings_contradict", path=printable(one.member.path), why=misfits[one])
            verdict = Judgement(Outcome.REFUSED, why, fitted.verdict.coverage, fitted.verdict.trials)
            fitted = replace(fitted, verdict=verdict)
            break
        fitted = _fitted(rest, settings)
    return build_pool(replace(_input(fitted, left_out, request), copies=copies))


def _fitted(parts: Sequence[_Part], settings: Settings) -> _Fitted:
    """Fit and judge the cells of several recordings as one."""
    temperature = all(part.collector.temperature for part in parts)
    lsb_per_g = procedures.local_lsb_per_g(parts[0].recording, settings)
    merged = CellCollector(lsb_per_g, settings, temperature=temperature)
    for part in parts:
        merged.merge(part.collector)
    procedure = procedures.CellProcedure(merged)
    windows = procedure.window_use(reduce(add, (part.counts for part in parts)))
    return _Fitted(tuple(parts), procedure.judge(procedures.fitting(settings)), windows)


def _misfits(fitted: _Fitted, settings: Settings) -> dict[_Part, Reason]:
    """Return the recordings that can hardly be of the pool's device, and why."""
    verdict, found = fitted.verdict, {}
    calibration = verdict.calibration or verdict.candidate
    if calibration is None or verdict.holdout is None:
        return {}
    for part in fitted.parts:
        points, degrees = part.collector.points(), settings.posture_degrees
        holdout = held_out(points, calibration, settings.gravity, degrees, SEEN)
        usual_mg = verdict.holdout.after.median
        if (
            holdout is not None
            and (why := reason_pool_does_not_fit(holdout, usual_mg, settings.max_error_mg)) is not None
        ):
            found[part] = why
    return found


def _input(fitted: _Fitted, left_out: Mapping[_Part, Reason], request: Request) -> PoolInput:
    parts, settings = fitted.parts, request.recording_settings
    unused = tuple(name for name in parts[0].unused if all(name in part.unused for part in parts))
    request = replace(request, options=without(request.options, unused), unused=unused)
    return PoolInput(
        members=tuple(part.member for part in parts),
        left_out=tuple((part.member, why) for part, why in left_out.items() if part not in parts),
        example=parts[0].recording,
        bytes=sum(part.recording.total_bytes for part in parts),
        samples=sum(part.samples for part in parts),
        settings=request.effective_settings(request.options.layout),
        judgement=fitted.verdict,
        windows=fitted.windows,
        notes=(unused_note(unused, parts[0].recording.format),) if unused else (),
        optimizer=procedures.optimizer_json(settings),
    )


def _part(member: Member, request: Request, progress: ProgressMaker) -> _Part:
    path, settings = member.path, request.recording_settings
    with open_run(Job(path, path, path), request, progress) as run:
        recording = run.reader.recording
        method = procedures.make_method(recording, settings)
        if not isinstance(method.procedure, procedures.CellProcedure):
            raise UsageError(f"profile {settings.profile} keeps no cells that could be pooled")
        facts = run.survey(method)
        counts, unused = method.segmenter.counts, run.request.unused
        return _Part(member, recording, facts.samples, method.procedure.collector, counts, unused)


def apply_pool(
    job: Job,
    request: Request,
    document: Document,
    progress: ProgressMaker = no_progress,
    before: FileStamp | None = None,
) -> Result | Reason:
    """Apply a pool's coefficients to one of its recordings.

    Args:
        before: the recording's stamp when the pool was made; None if that does not matter.

    Returns:
        The result, or why the recording keeps its own: the pool's coefficients make it worse.

    Raises:
        AccelcalError: it or the pool's report cannot be read, or it changed; or the outputs cannot be
            written.
    """
    with open_run(job, request, progress, before=before) as run:
        prepare(job, force=request.force)
        found = run.result(PoolCoefficients(request.recording_settings, document))
        judgement = found.data.judgement
        if judgement.outcome is Outcome.REFUSED:
            return judgement.reason
        for member in from_json(PoolSection, document.report["pool"]).left_out:
            if member.sha256 == found.data.sha256:
                return Reason.of("left_out_of_pool", why=Reason(member.reason, member.values))
        usual_mg = document.report["holdout"]["after_mg"]["median"]
        limit_mg = found.data.settings.method.max_error_mg
        why = (
            None
            if judgement.holdout is None
            else reason_pool_does_not_fit(judgement.holdout, usual_mg, limit_mg)
        )
        return why or run.write(found)


@dataclass(frozen=True)
class PoolCoefficients(Judge):
    """Gives a recording its pool's verdict, with the errors on the recording's own stillness."""

    document: Document

    def method(self, recording: Recording) -> procedures.Method:
        """Return the method; raises UnreadableError if the pool's report is damaged."""
        check_sections(self.document, (*TAKEN, "outcome", "reason", "values", "message", "pool"))
        return procedures.make_method(recording, self.settings)

    def verdict(self, run: RecordingRun, found: Survey) -> Verdict:
        """Return the pool's verdict; its hold-out is that of the recording's own points."""
        if found.damage is not None:
            return Verdict(found.damage)
        settings, calibration = self.settings, calibration_of(self.document.report["calibration"])
        holdout = held_out(found.points, calibration, settings.gravity, settings.posture_degrees, SEEN)
        report = self.document.report
        view = from_json(PoolSection, report["pool"])
        about = {"recordings": len(view.recordings), "serial": printable(view.serial)}
        its = Reason(report["reason"], report["values"])
        why = Reason.of("pooled", **about, pool=its, **errors_here(holdout))
        outcome = Outcome(report["outcome"])
        judgement = Judgement(outcome, why, found.coverage, (), calibration, holdout=holdout)
        return Verdict(judgement, of_member(self.document, run.job.report, holdout))
