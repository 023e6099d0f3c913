"""The forms of an export, which options go with each, and files that are never replaced unasked."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import OutputError, UsageError, did_you_mean, printable
from accelcal_cli.output.files import exists
from accelcal_cli.pipeline.jobs import PARQUET_SUFFIX, REPORT_SUFFIX, refuse_nameless, refuse_overwriting

COEFFICIENTS = ("ggir", "biobank", "omconvert", "json")
DATA = ("csv", "npz", "mhealth", "bids", "parquet")
FOLDERS = ("ggir", "biobank", "actipy", "skdh", "csv", "npz", "mhealth", "parquet")
"""Forms of which a folder of recordings can be made."""

FORMS = tuple(dict.fromkeys((*COEFFICIENTS, "actipy", "skdh", *DATA)))


def check_form(form: str, options: Mapping[str, Any], *, folder: bool) -> None:
    """Raise UsageError if there is no such form, or an option does not go with it.

    Args:
        options: those that were given, by name; others are None or False.
        folder: a folder of recordings is wanted.
    """
    if form not in FORMS:
        meant = did_you_mean(form, FORMS)
        raise UsageError(f"there is no form {form!r}", hint=meant or f"choose one of {', '.join(FORMS)}")
    if folder:
        if form not in FOLDERS:
            hint = f"choose one of {', '.join(FOLDERS)}, or a file with -o"
            raise UsageError(f"--to {form} writes no folder of recordings", hint=hint)
        return
    for name, value in options.items():
        if value is None or value is False:
            continue
        if name in ("gzip", "jobs"):
            hint = "name one with -d, or omit it"
            raise UsageError(f"--{name} is for a folder of recordings", hint=hint)
        if form in COEFFICIENTS:
            option = f"--{name.replace('_', '-')}"
            raise UsageError(f"{option} is for data (--to {', '.join(DATA)})", hint="omit it")


def refuse_other_kind(path: Path, form: str) -> None:
    """Raise UsageError for data where a report is needed, or the other way round, naming the other file."""
    kinds = [(PARQUET_SUFFIX, "calibrated data"), (REPORT_SUFFIX, "a report")]
    (suffix, needed), (given, _) = kinds[::-1] if form in COEFFICIENTS else kinds
    if path.name.endswith(given):
        other = shlex.quote(printable(path.with_name(path.name.removesuffix(given) + suffix)))
        raise UsageError(f"--to {form} needs {needed}", path=path, hint=f"give {other} instead")


def refuse_outputs(outputs: Iterable[Path], inputs: Sequence[Path], *, force: bool) -> None:
    """Raise UsageError for an output that is an input, OutputError for one that is there already."""
    for path in outputs:
        refuse_nameless(path)
        refuse_overwriting((path,), inputs)
        if not force:
            refuse_existing([path])


def refuse_existing(outputs: Iterable[Path]) -> None:
    """Raise OutputError for an output that is there already."""
    for path in outputs:
        if exists(path):
            raise OutputError("is there already", path=path, hint="use --force to replace it")
