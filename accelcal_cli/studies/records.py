"""What flows between the parts of a study: its files, their results, tasks and those who carry them out."""

from __future__ import annotations

import contextlib
import json
import os
import re
import zlib
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import IO, Any, Protocol

from accelcal_cli.core.errors import OutputError
from accelcal_cli.output.files import open_plain, replacing
from accelcal_cli.pipeline.jobs import FileStamp, Job, file_stamp
from accelcal_cli.pipeline.options import StatedOption

FAILED = "failed"
"""The summary's outcome of a recording that gave no report."""

OWN = "own"
"""The first round of a study: each recording's own result."""


@dataclass(frozen=True, slots=True)
class Item:
    """A file of the study.

    Attributes:
        name: its place under OUT with its full file name, `/` between folders: what it is known by.
        stamps: its own stamp, and those of the files beside it that may describe it; None for none. Then
            that of what files state of how it is read, where they state something.
        refusal: why nothing can be done with it, found before any work.
        aside: not to be started now, since `--include` does not name it.
        choices: what files state of how it is read.
    """

    name: str
    job: Job
    stamps: tuple[FileStamp | None, ...]
    refusal: str | None = None
    aside: bool = False
    choices: tuple[StatedOption, ...] = ()

    @property
    def source(self) -> Path:
        """The file."""
        return self.job.source

    @property
    def size(self) -> int:
        """Bytes; 0 where it cannot be looked at."""
        return 0 if self.stamps[0] is None else self.stamps[0][0]

    @property
    def changed_s(self) -> float:
        """When it was last changed [s since 1970]."""
        return 0.0 if self.stamps[0] is None else self.stamps[0][1] / 1e9


@dataclass(frozen=True, slots=True)
class Entry:
    """What became of an item in one round; a line of the ledger.

    Attributes:
        stamps: the item's when it was worked on.
        asked: a hash of the settings and the version.
        row: its row in the summary; None for a file that is no recording.
        outputs: name under OUT and stamp of each file written.
        again: whether it must be tried again, because the fault was not in the recording.
        round: the round that it is of.
        inputs: identities of what else the result was made of, in the order in which it was looked at.
    """

    name: str
    stamps: tuple[FileStamp | None, ...]
    asked: str
    row: dict[str, Any] | None
    outputs: tuple[tuple[str, FileStamp], ...] = ()
    again: bool = False
    round: str = OWN
    inputs: tuple[str, ...] = ()

    @property
    def failed(self) -> bool:
        """Whether it gave no report."""
        return self.row is not None and self.row["outcome"] == FAILED


@dataclass(frozen=True, slots=True)
class RecordingState:
    """What is known of a recording after some rounds: its own result, and the last one."""

    item: Item
    own: Entry
    last: Entry


ProgressCallback = Callable[[float], None]
"""Called where the work is done with the part of its task that is done, 0 to 1."""

TaskFunction = Callable[[Any, ProgressCallback], Any]
"""What is done with a task; a function of a module, and its task and answer can be pickled."""

ProgressDelta = Callable[[Any, float], None]
"""Called with a task and by how much more of it is done; less than 0 where it begins anew."""


@dataclass(frozen=True, slots=True)
class Finished:
    """One task that ended.

    Attributes:
        result: what the work returned; None if the worker ended before that.
        fault: what happened to the worker, else None.
        retry: whether the fault may lie in the machine and not in the task.
        lacking: whether the machine had not enough of something.
    """

    task: Any
    result: Any = None
    fault: str | None = None
    retry: bool = False
    lacking: bool = False


class Executor(Protocol):
    """Does tasks, several at a time; the failure of one does not affect the others."""

    def run(self, tasks: list[Any]) -> Generator[Finished, None, None]:
        """Do all tasks; yields each as it ends. Nothing is left running when the iteration is given up."""


LINE = re.compile(rb"^[0-9a-f]{8} \{", re.MULTILINE)
HALF_A_LINE = re.compile(rb"\s*[0-9a-f]{0,8} ?")
LOOKED_AT = 1 << 20
"""Bytes of a file in which a line of ours is looked for."""


class Ledger:
    """Entries by name and round, and a file to which new ones are added as they come.

    A process that is killed leaves at worst half a line, which is not read.
    """

    def __init__(
        self, path: Path, others: Iterable[Path] = (), wanted: Callable[[str], bool] = lambda _name: True
    ) -> None:
        """Read the entries of `path` and of others; what cannot be read is as if it were not there.

        Args:
            wanted: whether entries of a name are looked for; others are not kept in memory.
        """
        self.path = path
        self.out = path.parent
        self._entries: dict[tuple[str, str], list[Entry]] = {}
        self._file: IO[str] | None = None
        for one in (path, *others):
            for entry in _read(one):
                if wanted(entry.name):
                    self._entries.setdefault((entry.name, entry.round), []).append(entry)

    def known(self, item: Item, asked: str, name: str = OWN) -> Entry | None:
        """What came of a file in a round, with these settings and this version.

        Of several entries one whose outputs are there is taken."""
        if item.stamps[0] is None:
            return None
        entries = self._entries.get((item.name, name), ())
        same = [one for one in entries if one.stamps == item.stamps and one.asked == asked]
        return next((one for one in same if self.in_place(one)), same[0] if same else None)

    def as_it_was(self, item: Item, asked: str) -> Item:
        """The item with the stamps of its last own result, if it has one; as it is, if not."""
        own = [one for one in self._entries.get((item.name, OWN), ()) if one.asked == asked and one.row]
        return replace(item, stamps=own[-1].stamps) if own else item

    def current(self, item: Item, asked: str, name: str = OWN) -> Entry | None:
        """The entry that still stands: it is known, and its outputs are there."""
        entry = self.known(item, asked, name)
        return entry if entry is not None and self.in_place(entry) else None

    def latest(self, name: str, asked: str, which: str) -> Entry | None:
        """The last entry of a round whose outputs are there, whatever became of the file since."""
        good = [one for one in self._entries.get((name, which), ()) if one.asked == asked and not one.failed]
        return next((one for one in reversed(good) if self.in_place(one)), None)

    def held(self, name: str, asked: str, rounds: Iterable[str]) -> list[Entry]:
        """The last entry of each of these rounds, whatever became of the file and of the outputs since."""
        last = [self._entries[name, which][-1] for which in rounds if (name, which) in self._entries]
        return [one for one in last if one.asked == asked]

    def of_others(self, item: Item, rounds: Iterable[str]) -> list[Entry]:
        """What a run with other options left of a recording: its own result, then that which replaced it.

        Empty where the outputs of the last of them are not there."""
        own = [one for one in self._entries.get((item.name, OWN), ()) if one.row is not None][-1:]
        later = [one for name in rounds for one in self._entries.get((item.name, name), ())[-1:]]
        there = [one for one in later if own and one.asked == own[0].asked and self.in_place(one)]
        last = (own + there)[-1:]
        return own + there[-1:] if last and self.in_place(last[0]) else []

    def in_place(self, entry: Entry) -> bool:
        """Whether the outputs that lie there are those of an entry."""
        return all(file_stamp(self.out / name) == stamp for name, stamp in entry.outputs)

    def add(self, entry: Entry) -> None:
        """Keep an entry. A disk that is full costs the memory, not the work."""
        self._entries[entry.name, entry.round] = [entry]
        with contextlib.suppress(OSError, OutputError):
            if self._file is None:
                self._file = open_plain(self.path, "a")
                self._file.write("\n")
            self._file.write(_line(entry))
            self._file.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file, if there is one."""
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()

    def tidy(self, entries: Iterable[Entry]) -> None:
        """Write these entries alone, by name."""
        with (
            contextlib.suppress(OutputError),
            replacing(self.path) as temporary,
            temporary.open("w", encoding="utf-8", newline="\n") as file,
        ):
            file.writelines(_line(entry) for entry in sorted(entries, key=lambda one: (one.name, one.round)))


def _line(entry: Entry) -> str:
    text = json.dumps({one.name: getattr(entry, one.name) for one in fields(entry)})
    return f"{_checksum(text.encode())} {text}\n"


def _checksum(data: bytes) -> str:
    return f"{zlib.crc32(data):08x}"


def _read(path: Path) -> Iterator[Entry]:
    """Entries of a file. Texts that are alike are one: of 100 000 rows they would be much of the memory."""
    texts: dict[str, str] = {}
    with contextlib.suppress(OSError, OutputError), open_plain(path, "rb") as lines:
        for line in lines:
            if (entry := _parsed(line.strip(), texts)) is not None:
                yield entry


def _shared(value: Any, texts: dict[str, str]) -> Any:
    """The value with the same text wherever one was met before."""
    if isinstance(value, str):
        return texts.setdefault(value, value)
    if isinstance(value, dict):
        return {texts.setdefault(name, name): _shared(one, texts) for name, one in value.items()}
    return [_shared(one, texts) for one in value] if isinstance(value, list) else value


def is_ledger(path: Path) -> bool:
    """Whether a file can be a ledger, of which damage has left something: then it may be replaced.

    Raises:
        OSError, OutputError: see `open_plain`.
    """
    with open_plain(path, "rb") as file:
        start = file.read(LOOKED_AT)
    return HALF_A_LINE.fullmatch(start) is not None or LINE.search(start) is not None


def _parsed(line: bytes, texts: dict[str, str]) -> Entry | None:
    checksum, _, text = line.partition(b" ")
    if checksum != _checksum(text).encode():
        return None
    try:
        held: dict[str, Any] = _shared(json.loads(text), texts)
        if not all(isinstance(held[name], str) for name in ("name", "asked", "round")):
            return None
        return Entry(
            name=held["name"],
            stamps=tuple(None if one is None else (one[0], one[1]) for one in held["stamps"]),
            asked=held["asked"],
            row=held["row"],
            outputs=tuple((name, (found[0], found[1])) for name, found in held["outputs"]),
            again=held["again"],
            round=held["round"],
            inputs=tuple(held["inputs"]),
        )
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError):
        return None
