"""The ledger: what earlier runs did, a line for each recording and round. It saves work, no more.

Without it, or where it does not fit, a worker looks at the outputs and hashes the recording. Each line begins
with its checksum: a line that is damaged, cut short or of another version is not read.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import IO, Any

from accelcal_cli.core.errors import OutputError
from accelcal_cli.output.files import open_plain, replacing
from accelcal_cli.pipeline.jobs import file_stamp
from accelcal_cli.studies.records import OWN, Entry, Item

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
