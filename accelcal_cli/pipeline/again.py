"""What a report was made of and with, found again; or why it cannot be."""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.errors import UsageError
from accelcal_cli.output.coefficients import Coefficients, read_coefficients
from accelcal_cli.output.document import Document, check_sections
from accelcal_cli.pipeline.identity import sha256
from accelcal_cli.pipeline.rebuild import NamedFile, Rebuilt


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
    """Raise UsageError for a report that does not say how its recording was read."""
    used = document.report.get("settings")
    if isinstance(used, dict) and "input" not in used:
        raise UsageError(
            "does not say how its recording was read, and cannot be made again",
            path=document.path,
            hint="name a report of calibrate, apply, fit or six-pose",
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
    return named if held.layout is None else _unchanged(held.layout, recording, named, "layout")


def poses_of(held: Rebuilt, recording: Path, named: Path | None) -> Path | None:
    """The list of poses that the report was made with; raises UsageError where it is not there."""
    return None if held.poses is None else _unchanged(held.poses, recording, named, "poses")


def _unchanged(then: NamedFile, recording: Path, named: Path | None, what: str) -> Path:
    """A file that lies beside the recording, or where the user says."""
    path = named or recording.with_name(then.name)
    if not path.is_file() or sha256(path) != then.sha256:
        raise UsageError(
            f"is not the {what} {then.name} that the report was made with",
            path=path,
            hint=f"name it with --{what}",
        )
    return path
