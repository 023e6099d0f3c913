"""Records of a study: its files, what became of each, and the ledger of that.

The ledger keeps a line for each recording and round. It only saves work: without it, or where it does not
fit, a worker looks at the outputs and hashes the recording. Each line begins with its checksum: a line that
is damaged, cut short or of another version is not read.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import IO, Any

from accelcal_cli.core.errors import OutputError
from accelcal_cli.core.identity import LEDGER, can_be_read, identity
from accelcal_cli.output.files import open_plain, replacing
from accelcal_cli.pipeline.jobs import FileStamp, Job, file_stamp
from accelcal_cli.pipeline.options import StatedOption

FAILED = "failed"
"""Outcome in the summary of a recording that has no report."""

OWN = "own"
"""Name of the first round, which finds each recording's own result."""


@dataclass(frozen=True, slots=True)
class Item:
    """A file of the study.

    Attributes:
        name: path under OUT with its full file name and `/` between folders, which identifies it.
        stamps: its own stamp, and those of the files next to it that may describe it; None for a missing one.
            Then the stamp of the options that files state for it, where they state any.
        refusal: reason why it cannot be worked on, found before any work.
        aside: whether `--include` leaves it out, so that it is not started now.
        choices: options that files state for it.
        sensor: the value of --sensor that chooses it among the sensors of its file; None for all of the file.
    """

    name: str
    job: Job
    stamps: tuple[FileStamp | None, ...]
    refusal: str | None = None
    aside: bool = False
    choices: tuple[StatedOption, ...] = ()
    sensor: str | None = None

    @property
    def source(self) -> Path:
        """Path of the file."""
        return self.job.source

    @property
    def shown(self) -> Path:
        """The file as the user gave it; with the sensor, where it is one of several."""
        return self.source if self.sensor is None else self.source.with_name(self.name.rpartition("/")[2])

    @property
    def size(self) -> int:
        """Number of bytes; 0 if it cannot be read."""
        return 0 if self.stamps[0] is None else self.stamps[0][0]

    @property
    def changed_s(self) -> float:
        """Time of the last change [s since 1970]."""
        return 0.0 if self.stamps[0] is None else self.stamps[0][1] / 1e9


@dataclass(frozen=True, slots=True)
class Entry:
    """The result of an item in one round, which is a line of the ledger.

    Attributes:
        stamps: stamps of the item when it was worked on.
        asked: hash of the settings and the version.
        row: row in the summary; None for a file that is not a recording.
        outputs: name under OUT and stamp of each file written.
        again: whether it must be tried again, because the fault was not in the recording.
        round: name of the round.
        inputs: hashes of all else that the result was made from, in the order of use.
        why: code and values of the reason why a file is left out.
    """

    name: str
    stamps: tuple[FileStamp | None, ...]
    asked: str
    row: dict[str, Any] | None
    outputs: tuple[tuple[str, FileStamp], ...] = ()
    again: bool = False
    round: str = OWN
    inputs: tuple[str, ...] = ()
    why: dict[str, Any] | None = None

    @property
    def failed(self) -> bool:
        """True if there is no report."""
        return self.row is not None and self.row["outcome"] == FAILED


@dataclass(frozen=True, slots=True)
class RecordingState:
    """The results of a recording after some rounds: its own, and the latest."""

    item: Item
    own: Entry
    last: Entry


ProgressCallback = Callable[[float], None]
"""Called by the work with the part of the task that is done, 0 to 1."""

TaskFunction = Callable[[Any, ProgressCallback], Any]
"""The work on one task: a module-level function whose argument and result can be pickled."""

TaskProgress = Callable[[Any, float], None]
"""Called with a task and the part of it that is done; with 0 when it begins, if that is known."""


@dataclass(frozen=True, slots=True)
class Finished:
    """One task that ended.

    Attributes:
        result: return value of the work; None if the worker ended before that.
        fault: what happened to the worker; None if the work returned.
        retry: whether the machine may be at fault, and not the task.
        lacking: whether the machine ran out of a resource.
    """

    task: Any
    result: Any = None
    fault: str | None = None
    retry: bool = False
    lacking: bool = False


KINDS: dict[str, Any] = {"name": str, "asked": str, "round": str, "again": bool, "row": dict | None}
"""Types of what is saved of an entry and read as it is."""

LINE = re.compile(rb"^[0-9a-f]{8} \{", re.MULTILINE)
HALF_A_LINE = re.compile(rb"\s*[0-9a-f]{0,8} ?")
LOOKED_AT = 1 << 20
"""Number of bytes of a file that are searched for a line of a ledger."""


class Ledger:
    """Entries by name and round, and the file to which new ones are added.

    A process that is killed leaves at worst half a line, which is not read.
    """

    def __init__(
        self,
        path: Path,
        others: Iterable[Path] = (),
        wanted: Callable[[str], bool] = lambda _name: True,
        fits: Callable[[Entry], bool] = lambda _entry: True,
    ) -> None:
        """Read the entries of `path` and of other ledgers; what cannot be read is ignored.

        Args:
            wanted: returns True for the names whose entries are kept in memory.
            fits: returns False for an entry whose row is not ours, and is not believed.
        """
        self.path = path
        self.out = path.parent
        self._entries: dict[tuple[str, str], list[Entry]] = {}
        self._file: IO[str] | None = None
        for one in (path, *others):
            for entry in _read(one):
                if wanted(entry.name) and (entry.row is None or fits(entry)):
                    self._entries.setdefault((entry.name, entry.round), []).append(entry)

    def known(self, item: Item, asked: str, name: str = OWN) -> Entry | None:
        """Return the entry of an unchanged file with these settings, best one whose outputs are there."""
        if item.stamps[0] is None:
            return None
        entries = self.entries(item.name, name)
        same = [one for one in entries if one.stamps == item.stamps and one.asked == asked]
        return next((one for one in same if self.in_place(one)), same[0] if same else None)

    def entries(self, name: str, which: str = OWN) -> Sequence[Entry]:
        """Return a recording's entries of a round, the latest last, whatever changed since."""
        return self._entries.get((name, which), ())

    def in_place(self, entry: Entry) -> bool:
        """Return True if an entry's outputs are there unchanged."""
        return all(file_stamp(self.out / name) == stamp for name, stamp in entry.outputs)

    def add(self, entry: Entry) -> None:
        """Add an entry; if the disk is full, only the memory of it is lost."""
        self._entries[entry.name, entry.round] = [entry]
        with contextlib.suppress(OSError, OutputError):
            if self._file is None:
                self._file = open_plain(self.path, "a")
                self._file.write("\n")
            self._file.write(_line(entry))
            self._file.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file if it is open."""
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()

    def tidy(self, entries: Iterable[Entry]) -> None:
        """Rewrite the file with these entries alone, sorted by name."""
        with (
            contextlib.suppress(OutputError),
            replacing(self.path) as temporary,
            temporary.open("w", encoding="utf-8", newline="\n") as file,
        ):
            file.writelines(_line(entry) for entry in sorted(entries, key=lambda one: (one.name, one.round)))


def _line(entry: Entry) -> str:
    text = json.dumps(identity(LEDGER) | {one.name: getattr(entry, one.name) for one in fields(entry)})
    return f"{_checksum(text.encode())} {text}\n"


def _checksum(data: bytes) -> str:
    return f"{zlib.crc32(data):08x}"


def _read(path: Path) -> Iterator[Entry]:
    """Yield the entries of a file; equal texts become one object, which saves much memory."""
    texts: dict[str, str] = {}
    with contextlib.suppress(OSError, OutputError), open_plain(path, "rb") as lines:
        for line in lines:
            if (entry := _parsed(line.strip(), texts)) is not None:
                yield entry


def _shared(value: Any, texts: dict[str, str]) -> Any:
    """Replace texts by equal ones that were met before."""
    if isinstance(value, str):
        return texts.setdefault(value, value)
    if isinstance(value, dict):
        return {texts.setdefault(name, name): _shared(one, texts) for name, one in value.items()}
    return [_shared(one, texts) for one in value] if isinstance(value, list) else value


def shared_row(entry: Entry, texts: dict[str, str]) -> Entry:
    """Return an entry whose row has the texts that others have: each row of a worker comes with its own."""
    return replace(entry, row=_shared(entry.row, texts))


def is_ledger(path: Path) -> bool:
    """Return True if a file is a ledger, or what damage has left of one, and may be replaced.

    Raises:
        OSError, OutputError: see `open_plain`.
    """
    with open_plain(path, "rb") as file:
        start = file.read(LOOKED_AT).strip(b"\0")  # which a disk may leave of lines at a power failure
    return HALF_A_LINE.fullmatch(start) is not None or LINE.search(start) is not None


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _parsed(line: bytes, texts: dict[str, str]) -> Entry | None:
    checksum, _, text = line.partition(b" ")
    if checksum != _checksum(text).encode():
        return None
    try:
        saved: dict[str, Any] = _shared(json.loads(text), texts)
        plain, why = {name: saved[name] for name in KINDS}, saved["why"]
        if not can_be_read(saved, LEDGER) or not all(isinstance(plain[name], KINDS[name]) for name in KINDS):
            return None
        return Entry(
            stamps=tuple(None if one is None else (one[0], one[1]) for one in saved["stamps"]),
            outputs=tuple((_text(name), (found[0], found[1])) for name, found in saved["outputs"]),
            inputs=tuple(saved["inputs"]),
            why=None if why is None else {"code": _text(why["code"]), "values": {**why["values"]}},
            **plain,
        )
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError):
        return None
