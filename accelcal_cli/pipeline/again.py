"""What a report was made of and with, found again; or why it cannot be."""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.errors import UsageError
from accelcal_cli.output.coefficients import FULL_GAIN, Coefficients, read_coefficients
from accelcal_cli.output.document import Document, check_sections
from accelcal_cli.pipeline.identity import sha256
from accelcal_cli.pipeline.rebuild import Rebuilt


def donor_of(document: Document, named: Path | None) -> Coefficients | None:
    """The coefficients that a report of `apply` used; None for any other report.

    Args:
        named: where the user says their file is; else it is looked for where it was, and beside the
            report.

    Raises:
        UsageError: it is not there.
        UnreadableError: it cannot be used.
    """
    if "coefficients" not in document.report:
        return None
    check_sections(document, ("coefficients",))
    used = document.report["coefficients"]
    then = Path(used["path"])
    beside = document.path.with_name(then.name)
    places = (named,) if named is not None else (then, beside)
    there = [path for path in places if path.is_file()]
    unchanged = [path for path in there if sha256(path) == used["sha256"]]
    for path in unchanged or [path for path in there if path is not beside]:
        return read_coefficients(path)
    raise UsageError(
        f"was made with the coefficients of {named or then}, which is not there",
        path=document.path,
        hint="name the file with --coefficients",
    )


def refuse_kind(document: Document) -> None:
    """Raise UsageError for a report that was made of something else than one recording's stillness."""
    report = document.report
    found, used = report.get("calibration"), report.get("settings")
    full = isinstance(found, dict) and found.get("model") == FULL_GAIN and "coefficients" not in report
    if full or (isinstance(used, dict) and "input" not in used):
        raise UsageError(
            "was not made of the stillness of a recording",
            path=document.path,
            hint="only reports of calibrate, apply and fit can be verified",
        )


def refuse_other(document: Document, recording: Path) -> None:
    """Raise UsageError for a recording that is not the report's, byte for byte."""
    if sha256(recording) != document.report["recording"]["sha256"]:
        raise UsageError(
            f"is not the recording of {document.path}, or was changed since: its SHA-256 is another",
            path=recording,
            hint=f"that report is of {document.report['recording']['path']}",
        )


def layout_of(held: Rebuilt, recording: Path, named: Path | None) -> Path | None:
    """The layout file that the report was made with; raises UsageError where it is not there."""
    if held.layout is None:
        return named
    path = named or recording.with_name(held.layout)
    if not path.is_file() or sha256(path) != held.layout_sha256:
        raise UsageError(
            f"is not the layout {held.layout} that the report was made with",
            path=path,
            hint="name it with --layout",
        )
    return path
