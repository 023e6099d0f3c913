"""Reads settings and reading options back from a report's `settings`.

Records are made from JSON by the types of their fields, and checked against what their fields allow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from math import isfinite
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Generic, TypeVar, Union, get_args, get_origin, get_type_hints

from accelcal_cli.core.errors import AccelcalError, UnreadableError
from accelcal_cli.core.formats import IF_GIVEN, UNUSED, ReadOptions
from accelcal_cli.core.settings import POSES_IF_ASKED, SIX_POSE, STILLNESS, PoseSettings, Settings, setting_of
from accelcal_cli.formats import named_format
from accelcal_cli.optimize import named_optimizer
from accelcal_cli.output.report_reading import Document, damaged

T = TypeVar("T")

POINTS = "points"
"""Name of the format of the tables that `fit` reads."""

NOT_SETTINGS = ("report_only", "input")
"""Keys in addition to the settings of every report."""

IF_ASKED = ("effect",)
"""Keys in addition to the settings that a report of `calibrate` has only if the user asked for them."""

FIXED = tuple(name for name in PoseSettings().as_json() if name not in PoseSettings.__dataclass_fields__)
"""Keys of a session's method that no user can change."""

NOT_POSE_SETTINGS = (*NOT_SETTINGS, *FIXED, "poses", "poses_sha256")
NOT_OPTIONS = ("layout", "layout_sha256")


@dataclass(frozen=True, slots=True)
class Restored(Generic[T]):
    """A record made from a JSON object.

    Attributes:
        missing: fields that the object lacks; they have their defaults.
        unknown: keys of the object that no field has.
    """

    record: T
    missing: tuple[str, ...]
    unknown: tuple[str, ...]


def restored(kind: type[T], values: Mapping[str, Any]) -> Restored[T]:
    """Make a dataclass, all of whose fields have defaults, from a JSON object.

    Raises:
        ValueError: a value is not of its field's type; the message names the key.
    """
    names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    hints = get_type_hints(kind)
    converted_values = {}
    for name in names:
        if name in values:
            try:
                converted_values[name] = converted(values[name], hints[name])
            except TypeError as error:
                raise ValueError(f"{name} cannot be {str(values[name])[:80]!r}") from error
    missing = tuple(name for name in names if name not in values)
    return Restored(kind(**converted_values), missing, tuple(name for name in values if name not in names))


def converted(value: Any, hint: Any) -> Any:
    """Convert a JSON value to a type: str, int, float, bool, None, Path, records, tuples, unions of these.

    Raises:
        TypeError: it is of another type, or not finite.
    """
    origin = get_origin(hint)
    if origin in (Union, UnionType):
        absent = value is None and NoneType in get_args(hint)
        return None if absent else converted(value, *({*get_args(hint)} - {NoneType}))
    if origin is tuple:
        return _of_tuple(value, get_args(hint))
    if is_dataclass(hint):
        return _record(value, hint)
    if hint is Path and isinstance(value, str):
        return Path(value)
    if hint is float and type(value) is int:
        return float(value)
    if type(value) is not hint or (hint is float and not isfinite(value)):
        raise TypeError
    return value


def _record(value: Any, kind: Any) -> Any:
    if not isinstance(value, dict) or set(value) != {field.name for field in fields(kind)}:
        raise TypeError
    try:
        return restored(kind, value).record
    except ValueError as error:
        raise TypeError from error


def _of_tuple(value: Any, parts: tuple[Any, ...]) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise TypeError
    kinds = parts[:1] * len(value) if parts[1:] == (...,) else parts
    if len(kinds) != len(value):
        raise TypeError
    return tuple(converted(item, kind) for item, kind in zip(value, kinds, strict=True))


@dataclass(frozen=True, slots=True)
class NamedFile:
    """A file whose name and hash a report holds."""

    name: str
    sha256: str | None


@dataclass(frozen=True, slots=True)
class ReportSettings:
    """The settings and options that a report was made with.

    Attributes:
        settings: of `six-pose` in a report of that command.
        options: reading options without the layout.
        layout: the layout file of a raw dump, None without one.
        poses: the list of poses of a session, None without one.
        missing: settings that the report does not name; they have this version's defaults.
        unknown: settings that it names and this version does not have; they are not used.
        unused: options that mean nothing for the recording.
        effect: whether measures of activity were asked for.
    """

    settings: Settings | PoseSettings
    options: ReadOptions
    report_only: bool
    layout: NamedFile | None
    poses: NamedFile | None
    missing: tuple[str, ...]
    unknown: tuple[str, ...]
    unused: tuple[str, ...] = ()
    effect: bool = False


def settings_from_report(document: Document) -> ReportSettings:
    """Read the settings of a report.

    Raises:
        UnreadableError: they are missing, or a value is not possible.
    """
    values = document.report.get("settings")
    if not isinstance(values, dict) or not isinstance(values.get("input"), dict):
        raise damaged(document, "it does not say how the recording was read")
    try:
        return _from_values(values)
    except ValueError as error:
        raise damaged(document, f"settings: {error}") from error
    except AccelcalError as error:
        raise UnreadableError(
            f"settings: {error.message}", path=document.path, hint="this version does not know it"
        ) from error


def _from_values(values: dict[str, Any]) -> ReportSettings:
    settings, read = _settings(values), values["input"]
    if read.get("format") == POINTS:
        options = Restored(ReadOptions(), (), ())
    else:
        options = restored(ReadOptions, _without(read, (*NOT_OPTIONS, UNUSED)))
    _check(settings.record)
    _check(options.record)
    missing, unknown = _unmatched(values, settings, options)
    unused = read.get(UNUSED, [])
    if not isinstance(unused, list) or not {*map(str, unused)} <= ReadOptions.__dataclass_fields__.keys():
        raise ValueError(f"input.{UNUSED} cannot be {str(unused)[:80]!r}")
    return ReportSettings(
        settings=settings.record,
        options=options.record,
        report_only=_typed(values, "report_only", bool, default=False),
        layout=_file(values["input"], "layout"),
        poses=_file(values, "poses"),
        missing=missing,
        unknown=unknown,
        unused=tuple(unused),
        effect=_typed(values, "effect", bool, default=False),
    )


def _settings(values: Mapping[str, Any]) -> Restored[Any]:
    if values.get("profile") == SIX_POSE:
        found = restored(PoseSettings, _without(values, NOT_POSE_SETTINGS))
        missing = tuple(name for name in found.missing if name not in POSES_IF_ASKED)
        return Restored(found.record, missing, found.unknown)
    return restored(Settings, _without(values, NOT_SETTINGS + IF_ASKED))


def _without(values: Mapping[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if name not in names}


def _unmatched(
    values: Mapping[str, Any], settings: Restored[Any], options: Restored[ReadOptions]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return missing and unknown keys, by their places in `settings`."""
    outer = [name for name in NOT_SETTINGS if name not in values]
    read = [name for name in options.missing if name not in (*NOT_OPTIONS, *IF_GIVEN)]
    if values["input"].get("format") != POINTS:
        read += [name for name in NOT_OPTIONS if name not in values["input"]]
    return (
        (*settings.missing, *outer, *(f"input.{name}" for name in read)),
        (*settings.unknown, *(f"input.{name}" for name in options.unknown)),
    )


def _check(record: Settings | PoseSettings | ReadOptions) -> None:
    """Raise ValueError for a value that its field does not allow, AccelcalError for an unknown name."""
    _check_values(record)
    if isinstance(record, Settings):
        named_optimizer(record.optimizer)
        _check_stillness(record)
    elif isinstance(record, ReadOptions):
        record.times.check()
        if record.format is not None:
            named_format(record.format)


def _check_values(record: Any, start: str = "") -> None:
    """Raise ValueError for a value beyond its bounds or not among its choices."""
    for name in record.__dataclass_fields__:
        value = getattr(record, name)
        if value is not None and not setting_of(record, name).allows(value):
            raise ValueError(f"{start}{name} cannot be {value!r}")


def _check_stillness(record: Settings) -> None:
    """Raise ValueError for numbers of a rule of stillness that are impossible, or belong to another rule."""
    rule = STILLNESS[record.stillness]
    axes, usual = record.stillness_axes, rule["stillness_axes"]
    if axes != usual and not len(axes) == len(usual) == 1:
        raise ValueError(f"stillness_axes cannot be {axes}")
    for name in ("stillness_threshold_g", "stillness_deviation_g"):
        value = getattr(record, name)
        if bool(value) != bool(rule[name]):
            raise ValueError(f"{name} cannot be {value}")
    if record.min_subset_points > record.max_subset_points:
        raise ValueError(f"max_subset_points cannot be {record.max_subset_points}")
    if (record.adaptive is not None) != (record.stillness == "adaptive"):
        raise ValueError(f"adaptive cannot be {record.adaptive}")
    if record.adaptive is not None:
        _check_values(record.adaptive, "adaptive.")


def _file(values: Mapping[str, Any], name: str) -> NamedFile | None:
    file_name = _typed(values, name, str, default=None)
    sha256 = _typed(values, f"{name}_sha256", str, default=None)
    return None if file_name is None else NamedFile(file_name, sha256)


def _typed(values: Mapping[str, Any], name: str, kind: type, *, default: Any) -> Any:
    value = values.get(name, default)
    if value is not default and not isinstance(value, kind):
        raise ValueError(f"{name} cannot be {str(value)[:80]!r}")
    return value
