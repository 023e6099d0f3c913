"""Several recordings of one device as one: their points together, one fit, one judgement, for all of them.

A pool's coefficients onto one of its recordings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Any

from accelcal_cli.collect.cells import CellCollector
from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.core.points import Calibration, WindowCounts
from accelcal_cli.core.recording import Recording
from accelcal_cli.core.results import Coverage, Holdout, Judgement, Outcome
from accelcal_cli.core.settings import Settings
from accelcal_cli.formats import open_recording
from accelcal_cli.judge.errors import coverage
from accelcal_cli.judge.verdict import SEEN, damage_verdict, held_out, worse
from accelcal_cli.optimize import named_optimizer
from accelcal_cli.output.report import ReportInput, WindowUse
from accelcal_cli.output.report_kinds import TAKEN, Member, PoolInput, build_pool, of_member
from accelcal_cli.output.report_reading import Document, calibration_of, check_sections
from accelcal_cli.pipeline.calibrate import Passes
from accelcal_cli.pipeline.jobs import FileStamp, Job, ProgressMaker, Request, Result, hashing, no_progress
from accelcal_cli.pipeline.method import CellProcedure, fitting, local_lsb_per_g, optimizer_json
from accelcal_cli.pipeline.outputs import prepare

FEWEST = 2


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """What one recording gives to a pool."""

    member: Member
    recording: Recording
    samples: int
    collector: CellCollector
    counts: WindowCounts


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """Recordings and what they are together."""

    parts: tuple[_Part, ...]
    verdict: Judgement
    windows: WindowUse


def pool(
    members: Sequence[Member], request: Request, progress: ProgressMaker = no_progress
) -> dict[str, Any]:
    """Fit and judge the points of several recordings as `calibrate` does those of one.

    Their cells are added up as integers: neither their order nor how they are read makes a difference.
    Temperature counts if all have it. A recording that its pool makes worse was hardly recorded by the same
    device: it is left out, and the others are fitted again.

    Args:
        members: recordings of one device with the same counts per g and range, at least one.

    Returns:
        the pool's report without `provenance`.

    Raises:
        UsageError: they differ, or the profile keeps no cells.
        UnreadableError: one cannot be read.
    """
    parts = [_part(member, request, progress) for member in members]
    for part in parts[1:]:
        _refuse_other(parts[0].recording, part.recording)
    settings, found = request.settings, _fitted(parts, request.settings)
    left_out: dict[_Part, str] = {}
    while odd := {part: why for part in found.parts if (why := _odd(part, found.verdict, settings))}:
        left_out |= odd
        rest = [part for part in found.parts if part not in odd]
        if len(rest) < FEWEST:
            found = replace(found, verdict=_contradictory(found.verdict, odd))
            break
        found = _fitted(rest, settings)
    return build_pool(_input(found, left_out, request))


def _fitted(parts: Sequence[_Part], settings: Settings) -> _Fitted:
    """One fit and one judgement of the cells of several recordings."""
    warm = all(part.collector.temperature for part in parts)
    merged = CellCollector(local_lsb_per_g(parts[0].recording, settings), settings, temperature=warm)
    for part in parts:
        merged.merge(part.collector)
    procedure = CellProcedure(merged)
    windows = procedure.window_use(reduce(add, (part.counts for part in parts)))
    return _Fitted(tuple(parts), procedure.judge(fitting(settings)), windows)


def _odd(part: _Part, verdict: Judgement, settings: Settings) -> str | None:
    """What speaks against a recording being one of the pool's device, or None."""
    if verdict.calibration is None or verdict.holdout is None:
        return None
    points, degrees = part.collector.points(), settings.posture_degrees
    held = held_out(points, verdict.calibration, settings.gravity, degrees, SEEN)
    return None if held is None else worse(held, verdict.holdout.after.median, settings.max_error_mg)


def _contradictory(verdict: Judgement, odd: Mapping[_Part, str]) -> Judgement:
    which = next(iter(sorted(f"{part.member.path}: {why}" for part, why in odd.items())))
    text = printable(f"its recordings contradict each other ({which})")
    return Judgement(Outcome.REFUSED, text, verdict.coverage, verdict.trials)


def _input(found: _Fitted, left_out: Mapping[_Part, str], request: Request) -> PoolInput:
    parts, settings = found.parts, request.settings
    return PoolInput(
        members=tuple(part.member for part in parts),
        left_out=tuple((part.member, why) for part, why in left_out.items() if part not in parts),
        example=parts[0].recording,
        bytes=sum(part.recording.total_bytes for part in parts),
        samples=sum(part.samples for part in parts),
        settings=request.effective_settings(request.options.layout),
        judgement=found.verdict,
        windows=found.windows,
        optimizer=optimizer_json(named_optimizer(settings.optimizer), settings),
    )


def _part(member: Member, request: Request, progress: ProgressMaker) -> _Part:
    path = member.path
    with open_recording(path, request.options, request.threads) as reader:
        passes = Passes(Job(path, path, path), request, progress, reader, path)
        method = passes.method()
        if not isinstance(method.procedure, CellProcedure):
            raise UsageError(f"profile {request.settings.profile} keeps no cells that could be pooled")
        facts = passes.survey(method)
        return _Part(
            member, reader.recording, facts.samples, method.procedure.collector, method.segmenter.counts
        )


def _refuse_other(one: Recording, other: Recording) -> None:
    for name in ("lsb_per_g", "range_g"):
        if getattr(one, name) != getattr(other, name):
            raise UsageError(f"cannot be pooled with {one.path}: its {name} is another", path=other.path)


def apply_pool(
    job: Job,
    request: Request,
    document: Document,
    progress: ProgressMaker = no_progress,
    before: FileStamp | None = None,
) -> Result | str:
    """Apply a pool's coefficients to one of its recordings.

    Args:
        before: how the recording was when the pool was made; None if that does not matter.

    Returns:
        the result, or why the recording keeps its own: they make it worse.

    Raises:
        AccelcalError: it or the pool's report cannot be read, or it changed; or the outputs cannot be
            written.
    """
    with open_recording(job.source, request.options, request.threads) as reader:
        prepare(job, force=request.force)
        passes = Passes(job, request, progress, reader, job.source, before)
        data, held = judged(passes, document)
        why = _why_not(data, document, held)
        return passes.write(data) if why is None else why


def judged(passes: Passes, document: Document) -> tuple[ReportInput, Holdout | None]:
    """First pass: survey the recording, and what the pool does to its stillness; nothing is written."""
    check_sections(document, (*TAKEN, "outcome", "message", "pool"))
    calibration = calibration_of(document.report["calibration"])
    method, settings = passes.method(), passes.request.settings
    with hashing(passes.bytes_at) as digest:
        facts = passes.survey(method)
        points = method.procedure.points()
        held = held_out(points, calibration, settings.gravity, settings.posture_degrees, SEEN)
        seen = coverage(points)
        spoiled = damage_verdict(facts, settings.max_damage_percent, seen)
        verdict = spoiled or _verdict(document, calibration, held, seen)
        data = passes.found(method, facts, verdict, digest.result())
    taken = {} if spoiled else of_member(document, passes.job.report, held)
    return replace(data, taken=taken), held


def _verdict(document: Document, calibration: Calibration, held: Holdout | None, seen: Coverage) -> Judgement:
    report = document.report
    said = report["pool"]
    about = f"pool of {len(said['recordings'])} recordings of device {said['serial']}: {report['message']}"
    own = "no two postures of stillness of its own"
    if held is not None:
        own = f"{held.before.mean:.1f} mg before, {held.after.mean:.2f} mg after on its own stillness"
    return Judgement(Outcome(report["outcome"]), printable(f"{about}; {own}"), seen, (), calibration)


def _why_not(data: ReportInput, document: Document, held: Holdout | None) -> str | None:
    """Why a recording keeps its own result, or None."""
    if data.judgement.outcome is Outcome.REFUSED:
        return data.judgement.message
    for one in document.report["pool"]["left_out"]:
        if one["sha256"] == data.sha256:
            return f"left out of the pool: {one['reason']}"
    usual_mg = document.report["holdout"]["after_mg"]["median"]
    return None if held is None else worse(held, usual_mg, data.settings["max_error_mg"])
