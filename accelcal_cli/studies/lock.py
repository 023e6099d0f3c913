"""One run at a time in an output folder: a file that names the run that holds it, and how another takes over.

Nothing is asked of a disk but that a name is linked to one file (open(2) says why link(2), and not O_EXCL, is
to be used on NFS), and that a file that is opened shows what was last written. Who takes over claims the lock
of the run that ended, by a file whose name comes from what that lock says, so that of several only one can;
then it puts its own name into the lock. The holder is who stands at the end of the lock and the claims on it.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import LockedError, OutputError, output_error, printable
from accelcal_cli.core.system import host, lives
from accelcal_cli.output.files import beside, discard, open_plain, parsed
from accelcal_cli.studies.heartbeat import BEAT_S, Lease, one_that_lives

UNFINISHED_S = 60.0
"""A lock without all its content is one whose writer is about to write it, or died before it could."""

BEGINNING = '{"host": '
LONGEST = 4096
"""How the content of a lock begins, and more bytes than it has."""

CLAIM = ".claim"
MOST_CLAIMS = 100
"""On each other; each but the last is of a run that died while it took over."""


@dataclass(frozen=True, slots=True)
class Holder:
    """Who holds a lock.

    Attributes:
        file: where that stands: the lock, or a claim whose run had no time to put its name into the lock.
        text: what the file says.
    """

    file: Path
    text: str

    @property
    def says(self) -> dict[str, Any]:
        """The run; empty where it does not say yet."""
        try:
            found = parsed(self.text)
        except ValueError:
            return {}
        return found if isinstance(found, dict) and isinstance(found.get("pid"), int) else {}


@dataclass(frozen=True, slots=True)
class Patience:
    """How long runs of other hosts may be silent before they are taken to have ended.

    Attributes:
        notify: is told what is waited for.
    """

    silence_s: float
    notify: Callable[[str], None]


@contextlib.contextmanager
def held(
    path: Path, others: Callable[[], Iterable[Path]] = tuple, patience: Patience | None = None
) -> Iterator[Lease]:
    """Hold a lock file while the block runs.

    Args:
        others: returns, once ours is held, the locks that no living run may hold meanwhile. Of two that
            exclude each other, at least one sees the other.
        patience: None: only a run of this host is found to have ended.

    Raises:
        LockedError: a living process holds one of them, or one on another host that cannot be asked.
        OutputError: the lock cannot be written, or another one not be read.
    """
    me = this_run()
    lease = Lease(path, lambda: _loss(path, me))
    try:
        _note_lost(lease, path, _take(path, me, patience))
    except OSError as error:
        raise output_error(error, path) from error
    try:
        with lease.kept_alive():
            for one, ended in _end_others([one for one in others() if one != path], me, patience).items():
                _note_lost(lease, one, ended.says)
            yield lease
    finally:
        release(path, me)


def _note_lost(lease: Lease, path: Path, says: Mapping[str, Any]) -> None:
    if (lost := says.get("host")) not in (None, host()):
        lease.lost[path] = str(lost)


def this_run() -> dict[str, Any]:
    """What a lock of this process holds, different each time."""
    process = {"host": host(), "pid": os.getpid(), "started": _started(os.getpid())}
    return {**process, "run": os.urandom(8).hex(), "beat_s": BEAT_S}


def holder(path: Path) -> Holder | None:
    """Who holds a lock; None if there is no lock.

    Raises:
        OSError: it cannot be read.
        OutputError: the file is not a lock of ours.
    """
    text = _text(path)
    if text is None:
        return None
    found = Holder(path, text)
    if not found.says and not text.startswith(BEGINNING[: len(text)]):
        hint = "move it away, or choose another folder with -d"
        raise OutputError("was not written by accelcal", path=path, hint=hint)
    for _ in range(MOST_CLAIMS):
        claim = _claim(path, found.text)
        if not (text := _text(claim)):
            break
        found = Holder(claim, text)
    return found


def take_over(path: Path, ended: Holder, me: dict[str, Any]) -> bool:
    """Put our name into the lock of a run that has ended; False if another was faster, or it is gone.

    Raises:
        OSError, OutputError: that cannot be written.
    """
    claim, temporary = _claim(path, ended.text), beside(path)
    try:
        temporary.write_bytes(json.dumps(me).encode())
        if not _link(temporary, claim, me):
            return False
        if (now := holder(path)) is None or now.says != me:
            discard(claim)
            return False
        temporary.replace(path)
    finally:
        discard(temporary)
    return True


def release(path: Path, me: dict[str, Any]) -> None:
    """Remove our lock, unless another run has taken it over.

    We claim it ourselves first: from then on nobody else can.
    """
    with contextlib.suppress(OSError, OutputError):
        found = holder(path)
        if found is None or found.says != me:
            return
        claims = [*path.parent.glob(f".{path.name}.*{CLAIM}")]
        own = _claim(path, found.text)
        with contextlib.suppress(OSError, OutputError):
            if not _create(path, {**me, "leaving": True}, own):
                return
        path.unlink(missing_ok=True)
        for claim in (*claims, own):
            discard(claim)


def _take(path: Path, me: dict[str, Any], patience: Patience | None) -> dict[str, Any]:
    """Make the lock ours; returns what that of a run said that had ended, nothing if there was none."""
    while not _create(path, me):
        if (found := holder(path)) is None:
            continue
        _require_ended({path: found}, patience)
        if take_over(path, found, me):
            return found.says
        if (faster := holder(path)) is not None:
            raise _refusal(path, faster.says)
    return {}


def _end_others(paths: list[Path], me: dict[str, Any], patience: Patience | None) -> dict[Path, Holder]:
    """Take locks of runs that have ended out of the way; raises LockedError where one has not."""
    found: dict[Path, Holder] = {}
    for path in paths:
        try:
            if (one := holder(path)) is not None:
                found[path] = one
        except OSError as error:
            raise output_error(error, path) from error
    _require_ended(found, patience)
    for path, ended in found.items():
        try:
            if take_over(path, ended, me):
                release(path, me)
            elif (faster := holder(path)) is not None:
                raise _refusal(path, faster.says)
        except OSError as error:
            raise output_error(error, path) from error
    return found


def _require_ended(found: Mapping[Path, Holder], patience: Patience | None) -> None:
    """Return once it is known that the runs that hold these locks have ended.

    Raises:
        LockedError: one has not, or that cannot be found out.
    """
    unknown = {path: one for path, one in found.items() if not _ended(path, one)}
    for path, one in unknown.items():
        if patience is None or one.says.get("host") in (None, host()) or "beat_s" not in one.says:
            raise _refusal(path, one.says)
    if patience is None or not unknown:
        return
    for path, one in unknown.items():
        what = f"{printable(path)} is taken over from {_named(one.says)}"
        patience.notify(f"{what} after {patience.silence_s / 60:g} minutes without a sign of life")
    if (alive := one_that_lives(lambda: _signs(unknown), patience.silence_s)) is not None:
        raise _refusal(alive, unknown[alive].says, seen=True)


def _signs(paths: Iterable[Path]) -> dict[Path, object]:
    """What can be seen of the runs that hold locks; the files are opened, so that NFS asks the server."""
    seen: dict[Path, object] = {}
    for path in paths:
        with contextlib.suppress(FileNotFoundError), open_plain(path, "rb") as file:
            now = holder(path)
            seen[path] = now, os.fstat(file.fileno()).st_mtime_ns
    return seen


def _create(path: Path, me: dict[str, Any], claim: Path | None = None) -> bool:
    """Make a lock, or a claim on it, with its content at once; False if there is one already.

    The temporary is the lock's in both cases, so that the next run finds what a killed one left.
    """
    temporary = beside(path)
    try:
        temporary.write_bytes(json.dumps(me).encode())
        return _link(temporary, claim or path, me)
    finally:
        discard(temporary)


def _link(temporary: Path, path: Path, me: dict[str, Any]) -> bool:
    """Give a file its name, if no other has it.

    Where the answer of a server was lost, there is an error although the link was made: what it says counts.
    """
    try:
        os.link(temporary, path)
    except OSError as error:
        if _says(path) == me:
            return True
        return not isinstance(error, FileExistsError) and _create_exclusively(path, me)
    return True


def _create_exclusively(path: Path, me: dict[str, Any]) -> bool:
    """For disks without links."""
    try:
        with path.open("xb") as file:
            file.write(json.dumps(me).encode())
    except FileExistsError:
        return False
    return _says(path) == me


def _says(path: Path) -> dict[str, Any]:
    try:
        return Holder(path, _text(path) or "").says
    except (OSError, OutputError):
        return {}


def _claim(path: Path, text: str) -> Path:
    """The file by which a lock, or a claim, that says this is claimed."""
    digest = hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()[:16]
    return path.with_name(f".{path.name}.{digest}{CLAIM}")


def _text(path: Path) -> str | None:
    """What a lock says; None if there is none."""
    try:
        with open_plain(path, "rb") as file:
            return str(file.read(LONGEST).decode(errors="replace"))
    except FileNotFoundError:
        return None


def _ended(path: Path, found: Holder) -> bool:
    """Whether the run that holds a lock is known to have ended; of another host's that is not known."""
    says = found.says
    if not says:
        return _age_s(path) > UNFINISHED_S
    if says.get("host") != host():
        return False
    return not lives(says["pid"]) or _started(says["pid"]) != says.get("started")


def _age_s(path: Path) -> float:
    """How old a file is by the clock of its disk: how much newer one is that is made now."""
    with contextlib.suppress(OSError):
        temporary = beside(path)
        try:
            return temporary.stat().st_mtime - path.stat().st_mtime
        finally:
            discard(temporary)
    return 0.0


def _started(process: int) -> str | None:
    """When a process began, so that a number that was given again is not taken for it; None if not known.

    The 22nd field of `/proc/PID/stat` (proc(5)), counted from the last parenthesis, and the boot.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        fields = Path(f"/proc/{process}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()
        return f"{boot} {fields[19]}"
    except (OSError, IndexError):
        return None


def _loss(path: Path, me: dict[str, Any]) -> LockedError | None:
    """How this run lost its lock; None if it still holds it."""
    try:
        found = holder(path)
    except OutputError as error:
        return LockedError(f"the lock of this run was replaced ({error.message})", path=path)
    if found is not None and found.says == me:
        return None
    how = "was removed" if found is None else f"was taken over by {_named(found.says)}"
    hint = "what was done is kept, and the same command does the rest"
    return LockedError(f"the lock of this run {how}", path=path, hint=hint)


def _named(says: Mapping[str, Any]) -> str:
    return f"process {says['pid']} on {says.get('host')}" if says else "another process"


def _refusal(path: Path, says: Mapping[str, Any], *, seen: bool = False) -> LockedError:
    """Why a lock is not ours; `seen`: its run gave signs of life."""
    hint = "wait for it to end"
    if says and says.get("host") != host() and not seen:
        way = ", or give --takeover MINUTES" if "beat_s" in says else ""
        hint = f"if it is no longer running there, remove {path.name}{way}"
    return LockedError(f"{_named(says)} is working in this folder", path=path, hint=hint)
