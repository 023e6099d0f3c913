"""How recordings are to be read, as files beside them say: `study.toml` for a folder, `NAME.toml` for one.

A `study.toml` has a table for each pattern of names, in it reading options by name:

    ["phone/*.csv"]
    unit = "m/s2"
    timezone = "Europe/Berlin"

and before these, if some files are no recordings, `exclude = ["*_gyro.csv"]`.

Of several patterns that fit a recording the later one decides, option by option, and its own NAME.toml before
all. What is said on the command line must not contradict them.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.core.formats import ReadOptions, option_name
from accelcal_cli.core.input_files import read_toml
from accelcal_cli.formats.raw import FOLDER_NAME, SUFFIX, check_layout, is_file, named_layout
from accelcal_cli.pipeline import given

STUDY_FILE = "study.toml"
LARGEST_FILE = 1 << 20
"""Bytes."""

ALONE = {"timezone", "start"}
"""Options whose text can be checked by itself."""


@dataclass(frozen=True, slots=True)
class Rules:
    """What a `study.toml` says.

    Attributes:
        path: the file.
        folder: where the paths of its patterns begin, absolute.
        anywhere: recordings elsewhere count by their names; else none of the patterns is meant for them.
        tables: options by pattern, each the values of fields of `ReadOptions`.
        exclude: patterns of files that are no recordings.
    """

    path: Path
    folder: Path
    anywhere: bool
    tables: tuple[tuple[str, dict[str, Any]], ...]
    exclude: tuple[str, ...] = ()

    def fitting(self, path: Path) -> list[str]:
        """The patterns that a file fits, in their order; first those of `exclude`."""
        below = os.path.relpath(path.absolute(), self.folder).replace(os.sep, "/")
        if below.startswith("../"):
            below = path.name if self.anywhere else ""
        return [pattern for pattern in self.patterns if below and fits(below, (pattern,))]

    @property
    def patterns(self) -> tuple[str, ...]:
        """All of them: those of `exclude`, and those of the tables."""
        return (*self.exclude, *(pattern for pattern, _ in self.tables))

    def excludes(self, path: Path) -> bool:
        """Whether a file is no recording."""
        return any(pattern in self.exclude for pattern in self.fitting(path))

    def choices(self, path: Path) -> Iterator[Choice]:
        """All that is said of a file, what decides last."""
        tables = dict(self.tables)
        for pattern in self.fitting(path):
            for name, value in tables.get(pattern, {}).items():
                yield Choice(name, value, f'{self.path.name}, "{pattern}"')

    def as_json(self) -> dict[str, Any]:
        """By pattern, with the options' own names."""
        tables = {
            pattern: {option_name(name)[2:]: plain(value) for name, value in values.items()}
            for pattern, values in self.tables
        }
        return {**({"exclude": list(self.exclude)} if self.exclude else {}), **tables}


@dataclass(frozen=True, slots=True)
class Choice:
    """One option that a file states for a recording: a field of `ReadOptions`, its value, and who says so."""

    field: str
    value: Any
    origin: str

    def __str__(self) -> str:
        return f"{option_name(self.field)[2:]}={words(self.value)}"


def fits(below: str, patterns: Iterable[str]) -> bool:
    """Whether a path below a folder fits a pattern: its name, or all of it if the pattern has a `/`."""

    def one(pattern: str) -> bool:
        text = below if "/" in pattern else below.rpartition("/")[2]
        return fnmatchcase(text.lower(), pattern.lower())

    return any(map(one, patterns))


def plain(value: Any) -> Any:
    """A value as JSON has it."""
    return list(value) if isinstance(value, tuple) else printable(value) if isinstance(value, Path) else value


def words(value: Any) -> str:
    """A value as on the command line."""
    return ",".join(map(str, value)) if isinstance(value, tuple) else printable(str(value))


def read_rules(path: Path, folder: Path | None = None) -> Rules:
    """Read a `study.toml`.

    Args:
        folder: of the recordings; None: that of the file, and recordings elsewhere count by their names.

    Raises:
        UsageError: it cannot be read, or says what is no reading option.
    """
    document = read_toml(path, STUDY_FILE, LARGEST_FILE)
    exclude = document.pop("exclude", [])
    if not isinstance(exclude, list) or not all(isinstance(pattern, str) for pattern in exclude):
        raise UsageError('exclude is no list of patterns such as ["*_gyro.csv"]', path=path)
    for pattern, table in document.items():
        if not isinstance(table, Mapping):
            hint = f'write it below a pattern such as ["*.csv"], or ["*"] for all: {pattern} = ...'
            raise UsageError(f"{pattern!r} is not a table", path=path, hint=hint)
    tables = tuple((pattern, _values(table, path, f'"{pattern}": ')) for pattern, table in document.items())
    for _, values in tables:
        if "layout" in values:
            values["layout"] = values["layout"].absolute()
    return Rules(path, (folder or path.parent).absolute(), folder is None, tables, tuple(exclude))


def folder_rules(folders: Sequence[Path]) -> tuple[Rules, ...]:
    """Those of each folder that has a `study.toml`; raises what `read_rules` raises."""
    found = ((folder / STUDY_FILE, folder) for folder in folders)
    return tuple(read_rules(path, folder) for path, folder in found if os.path.lexists(path))


def sidecar(path: Path) -> Path | None:
    """Where the options of one recording may lie: `NAME.toml` beside `NAME.csv` or `NAME.csv.gz`."""
    if not path.name:
        return None
    beside = path.with_name(named_layout(path).name.removesuffix(SUFFIX) + ".toml")
    return None if beside.name in (STUDY_FILE, FOLDER_NAME) else beside


def choices_of(path: Path, rules: Sequence[Rules], layout: Path | None = None) -> dict[str, Choice]:
    """What files say of how a recording is to be read, by field of `ReadOptions`.

    Args:
        layout: a layout that the user named: the recording's `NAME.toml` may be that.

    Raises:
        UsageError: its `NAME.toml` cannot be read, or says what is no reading option.
    """
    said = [choice for one in rules for choice in one.choices(path)]
    beside = sidecar(path)
    if (
        beside is not None
        and is_file(beside)
        and not (layout and is_file(layout) and layout.samefile(beside))
    ):
        table = read_toml(beside, beside.name, LARGEST_FILE)
        said += [Choice(name, value, beside.name) for name, value in _values(table, beside).items()]
    return {choice.field: choice for choice in said}


def with_choices(options: ReadOptions, choices: Mapping[str, Choice], path: Path) -> ReadOptions:
    """Options of a recording with what files state of it.

    Raises:
        UsageError: they contradict each other, or do not go together.
    """
    if not choices:
        return options
    nothing = _unsaid()
    values = {name: getattr(options, name) for name in nothing}
    for name, choice in choices.items():
        if values[name] != nothing[name] and values[name] != choice.value:
            text = f"{option_name(name)} {words(values[name])} contradicts {choice} ({choice.origin})"
            raise UsageError(text, path=path, hint="say it in one place")
        values[name] = choice.value
    try:
        return given.read_options(values)
    except UsageError as error:
        raise UsageError(error.message, path=path, hint=error.hint) from error


def options_of(path: Path, options: ReadOptions, rules: Sequence[Rules] = ()) -> ReadOptions:
    """How a recording is read: as was given, and as files state; raises what its two parts raise."""
    return with_choices(options, choices_of(path, rules, options.layout), path)


def stamp_of(choices: Mapping[str, Choice]) -> tuple[int, int]:
    """How many options are stated, and a hash of what they are; of a layout also its size and last change."""
    said = {name: plain(choice.value) for name, choice in sorted(choices.items())}
    layout = choices.get("layout")
    if layout is not None and is_file(layout.value):
        status = layout.value.stat()
        said["layout"] = [said["layout"], status.st_size, status.st_mtime_ns]
    digest = hashlib.sha256(json.dumps(said).encode()).digest()
    return len(choices), int.from_bytes(digest[:7], "big")


def _values(table: Mapping[str, Any], path: Path, place: str = "") -> dict[str, Any]:
    """Fields and values of a table's options; a layout's path begins at the table's file."""
    try:
        values = given.values_of({key.replace("-", "_"): value for key, value in table.items()}, ReadOptions)
        if "layout" in values:
            values["layout"] = path.parent / values["layout"]
            check_layout(values["layout"])
        for name in ALONE & values.keys():
            given.read_options(_unsaid() | {name: values[name]})
    except TypeError as error:
        known = f"reading options are {', '.join(given.keywords(ReadOptions))}"
        unknown = not {key.replace("-", "_") for key in table} <= given.keywords(ReadOptions).keys()
        raise UsageError(f"{place}{error}", path=path, hint=known if unknown else None) from error
    except UsageError as error:
        raise UsageError(f"{place}{error.message}", path=path, hint=error.hint) from error
    return values


def _unsaid() -> dict[str, Any]:
    """All reading options as if none were given."""
    return {name: getattr(ReadOptions(), name) for name in ReadOptions.__dataclass_fields__}
