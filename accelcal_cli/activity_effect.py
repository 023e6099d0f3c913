"""`accelcal effect`: measures of activity of one recording, raw and calibrated, epoch by epoch and together.

For a simulated recording, measures with its true parameters are compared too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli.core.calibration import Transform
from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.output.coefficients import without_misalignment
from accelcal_cli.output.files import csv_text, open_plain, refuse_foreign, replacing
from accelcal_cli.output.words import explained
from accelcal_cli.pipeline.activity import (
    DIGITS,
    TRUE,
    EffectMeter,
    EpochTable,
    Version,
    drawn_of,
    versions,
    versions_of,
)
from accelcal_cli.pipeline.apply import at_reference
from accelcal_cli.pipeline.calibrate import FirstPass, RecordingRun, open_run
from accelcal_cli.pipeline.epochs import MG, EpochMeasures
from accelcal_cli.pipeline.jobs import (
    Job,
    ProgressMaker,
    Request,
    no_progress,
    refuse_nameless,
    refuse_overwriting,
)
from accelcal_cli.pipeline.quality import judged_by
from accelcal_cli.pipeline.simulate import true_parameters

HEAD = ("time", "samples")
MEASURES = ("enmo_mg", "mad_mg", "pim_mg_s", "zcm")
"""Columns of the table of epochs, repeated for every version, and for both ends of the interval."""
ENDS = ("low", "high")


@dataclass(frozen=True, slots=True)
class MeasuredEffect:
    """The effect of a calibration on one recording.

    Attributes:
        outcome, message: outcome of the calibration, and its message.
        effect: measures of activity, as in a report; empty if it failed.
    """

    path: Path
    outcome: str
    message: str
    effect: dict[str, Any]


Write = Callable[[list[EpochTable]], None]


def effect(
    path: Path,
    request: Request,
    epoch_s: int,
    table: Path | None = None,
    progress: ProgressMaker = no_progress,
    source: Path | None = None,
) -> MeasuredEffect:
    """Measure a recording raw and calibrated, by its own calibration or the request's coefficients.

    Args:
        epoch_s: length of an epoch, whole seconds.
        table: a CSV file for the epochs; None: none is written.
        source: where the recording's bytes are, if not at its path.

    Raises:
        AccelcalError: it cannot be read, the coefficients cannot be applied to it (see `apply`), or the
            table cannot be written.
    """
    with open_run(Job(path, path, path), request, progress, source) as run:
        ready, judge = judged_by(run)
        found = ready.result(judge)
        made = _versions(path, ready, found)
        observer = EffectMeter(made, found.data.recording, epoch_s, drawn_of(found.data))
        shown = progress("measuring", found.data.recording.total_bytes)
        with _epochs(table, path, observer, epoch_s, found.data.facts.utc_offset_s) as write:
            for chunk in ready.reader.chunks(request.chunk_samples):
                write(observer.see(chunk))
                shown(chunk.end_byte)
            write(observer.finish())
    judgement = found.data.judgement
    return MeasuredEffect(
        path, str(judgement.outcome), explained(judgement.reason, judgement.notes), observer.result()
    )


def _versions(path: Path, run: RecordingRun, found: FirstPass) -> list[Version]:
    """Return the versions of the result, or of applied coefficients, and the true one if it is known."""
    data, donor = found.data, run.request.coefficients
    made = versions_of(data)
    if donor is not None and data.judgement.calibration is not None:
        simpler = without_misalignment(donor)
        settings = run.request.recording_settings
        used = None if simpler is None else at_reference(simpler, settings)
        made = versions(data.recording, data.judgement.calibration, used, settings.precision_mg)
    truth = true_parameters(path)
    if truth is None:
        return made
    parameters = (truth.gain, truth.offset_g, truth.slope_g_per_c, truth.reference_c)
    return [*made, Version(TRUE, None, Transform(*parameters, data.recording.lsb_per_g))]


@contextmanager
def _epochs(
    table: Path | None, source: Path, meter: EffectMeter, epoch_s: int, offset_s: int | None
) -> Iterator[Write]:
    """Open the table and yield a function that appends epochs to it, a row each."""
    if table is None:
        yield lambda _tables: None
        return
    refuse_overwriting((table,), (source,))
    head = [*HEAD, *(f"{name}_{one.name}" for one in meter.versions for name in MEASURES)]
    if meter.has_intervals:
        head += [f"{name}_{end}" for name in MEASURES for end in ENDS]
    with replacing(table) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:

        def write(tables: list[EpochTable]) -> None:
            for part in tables:
                lines = csv_text(head, list(_lines(part, epoch_s, offset_s)))
                file.write(lines[lines.index("\n") + 1 :])

        file.write(csv_text(head, ()))
        yield write


def _lines(part: EpochTable, epoch_s: int, offset_s: int | None) -> Iterator[list[object]]:
    """Yield time, number of samples, and the measures of each version, epoch by epoch."""
    columns: list[list[object]] = [[iso_time(one, offset_s) for one in part.start_us.tolist()]]
    columns.append(part.rows.tolist())
    for epochs in part.epochs:
        columns += _measures(epochs, epoch_s)
    if len(part.drawn.enmo):
        lowest, highest = (_measures(one, epoch_s) for one in part.drawn.ends())
        columns += [column for pair in zip(lowest, highest, strict=True) for column in pair]
    for line in zip(*columns, strict=True):
        yield list(line)


def _measures(epochs: EpochMeasures, epoch_s: int) -> list[list[object]]:
    """Return the columns of MEASURES."""
    scaled = ((epochs.enmo, MG), (epochs.mad, MG), (epochs.pim, MG * epoch_s))
    columns = [[round(value * unit, DIGITS) for value in values.tolist()] for values, unit in scaled]
    return [*columns, epochs.zcm.tolist()]


def as_json(found: MeasuredEffect) -> dict[str, Any]:
    """Return the effect as a JSON object."""
    return {
        "recording": printable(found.path),
        "outcome": found.outcome,
        "message": found.message,
        "effect": found.effect or None,
    }


def check_table(table: Path, *, force: bool) -> None:
    """Refuse to write epochs over another file.

    Raises:
        UsageError: its name is that of another kind of file.
        OutputError: there is a file that was not written as such a table.
    """
    refuse_nameless(table)
    if table.suffix.lower() != ".csv":
        raise UsageError(f"{printable(table)} would be a CSV table", hint="give a name that ends in .csv")
    if not force:
        refuse_foreign(table, known=_is_ours(table))


def _is_ours(table: Path) -> bool:
    """Return True if a file begins as a table of epochs does."""
    head = ",".join((*HEAD, MEASURES[0])).encode()
    try:
        with open_plain(table, "rb") as file:
            return bool(file.read(len(head)) == head)
    except OSError:
        return False
