"""What a report was made of and with, found again; or why it cannot be."""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.errors import UsageError
from accelcal_cli.output.coefficients import Coefficients, read_coefficients
from accelcal_cli.output.document import Document, check_sections, read_document
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
    by_content = used.get("without_provenance", False)
    then = Path(used["path"])
    beside = document.path.with_name(then.name)
    told = document.path.parent / then if by_content else then
    places = (named,) if named is not None else (told, beside)
    there = [path for path in places if path.is_file()]
    unchanged = [path for path in there if _known_by(path, by_content=by_content) == used["sha256"]]
    for path in unchanged or [path for path in there if path is not beside]:
        return read_coefficients(path, by_content=by_content)
    raise UsageError(
        f"was made with the coefficients of {named or then}, which is not there",
        path=document.path,
        hint="name the file with --coefficients",
    )


def pool_of(document: Document) -> Document | None:
    """The report of the pool whose coefficients a report has; None for any other report.

    Raises:
        UsageError: it is not where it was, seen from the report.
        UnreadableError: it cannot be used.
    """
    if "pool" not in document.report:
        return None
    check_sections(document, ("pool",))
    used = document.report["pool"]
    path = document.path.parent / used.get("path", "")
    if not path.is_file():
        raise UsageError(f"was made with the pool {path}, which is not there", path=document.path)
    found = read_document(path)
    if found.content_sha256 != used.get("sha256"):
        raise UsageError(f"was made with the pool {path}, which was changed since", path=document.path)
    return found


def _known_by(path: Path, *, by_content: bool) -> str:
    return read_document(path).content_sha256 if by_content else sha256(path)


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
