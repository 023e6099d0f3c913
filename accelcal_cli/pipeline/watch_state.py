"""The file in which a watch keeps where it stands: a line of JSON for people, then the state itself.

The line says at which byte of the recording to go on. The state is JSON, compressed with bzip2, whose output
does not depend on the machine: equal states are equal files.
"""

from __future__ import annotations

import bz2
import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import UnreadableError, UsageError, printable
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.freeze import ThawError, frozen, thawed
from accelcal_cli.core.settings import Settings
from accelcal_cli.core.version import __version__
from accelcal_cli.output.files import exists, replacing
from accelcal_cli.pipeline.jobs import sha256
from accelcal_cli.pipeline.watch import Standing

KIND = "accelcal watch"
LONGEST_LINE = 1 << 12
LARGEST_BYTES = 1 << 24
"""No state is as large, packed or unpacked: one that claims to be would take all memory."""

REMOVE = "remove it to begin anew, and send the recording from its first byte"


def options_sha256(options: ReadOptions, settings: Settings) -> str:
    """Of all that decides a result besides the recording; raises UnreadableError without its layout."""
    read = asdict(options) | {"layout": None}
    if options.layout is not None:
        read["layout"] = sha256(options.layout)
    return hashlib.sha256(_text([settings.as_json(), read])).hexdigest()


def save(path: Path, standing: Standing, options: str) -> None:
    """Write a state; an earlier one is replaced when the new one is complete.

    Args:
        options: of `options_sha256`.

    Raises:
        OutputError: it cannot be written.
    """
    packed = bz2.compress(_text(frozen(standing)))
    head = {
        "kind": KIND,
        "accelcal_version": __version__,
        "bytes": standing.taken,
        "samples": 0 if standing.stage is None else standing.stage.samples,
        "options_sha256": options,
    }
    line = _text(head | {"sha256": _sealed(head, packed)})
    with replacing(path) as temporary:
        temporary.write_bytes(line + b"\n" + packed)


def load(path: Path, options: str) -> Standing | None:
    """A state that was written before; None where there is no file.

    Raises:
        UnreadableError: it is damaged, no state, or that of another version.
        UsageError: it was written with other options.
    """
    if not exists(path):
        return None
    head, packed = _parts(path)
    version = head.get("accelcal_version")
    if version != __version__:
        text = f"is a state of accelcal {printable(str(version))[:20]}, and this is {__version__}"
        raise UnreadableError(text, path=path, hint=REMOVE)
    if head.pop("sha256", None) != _sealed(head, packed):
        raise UnreadableError("is a damaged state", path=path, hint=REMOVE)
    if head.get("options_sha256") != options:
        hint = f"give the same options again, or {REMOVE}"
        raise UsageError("is a state that was made with other options", path=path, hint=hint)
    try:
        unpacker = bz2.BZ2Decompressor()
        standing = thawed(json.loads(unpacker.decompress(packed, LARGEST_BYTES)))
    except (OSError, EOFError, ValueError, RecursionError, ThawError) as error:
        raise UnreadableError("is a damaged state", path=path, hint=REMOVE) from error
    if not isinstance(standing, Standing):
        raise UnreadableError("is a damaged state", path=path, hint=REMOVE)
    return standing


def _parts(path: Path) -> tuple[dict[str, Any], bytes]:
    """The line of a state, and what follows."""
    try:
        with path.open("rb") as file:
            line, packed = file.readline(LONGEST_LINE), file.read(LARGEST_BYTES)
    except OSError as error:
        raise UnreadableError(f"cannot be read ({error.strerror or error})", path=path) from error
    try:
        head = json.loads(line)
    except (ValueError, RecursionError):
        head = None
    if not isinstance(head, dict) or head.get("kind") != KIND:
        raise UnreadableError("is no state of accelcal watch", path=path, hint="give another file")
    return head, packed


def _sealed(head: dict[str, Any], packed: bytes) -> str:
    return hashlib.sha256(_text(head) + packed).hexdigest()


def _text(value: Any) -> bytes:
    return json.dumps(value, separators=(",", ":")).encode()
