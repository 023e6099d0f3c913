"""Options, as the command line, the Python API and files name them, made into the records that the work uses.

Names are those of the records' fields; None stands for an option that is not given. Text and bounds of single
values have been checked by click, or by `field_values`; how options go together is checked here.

Files next to recordings may state how to read them: `study.toml` for a folder, `NAME.toml` for one recording.
A `study.toml` has a table for each pattern of names, with reading options by name:

    ["phone/*.csv"]
    unit = "m/s2"
    timezone = "Europe/Berlin"

and before these, if some files are not recordings, `exclude = ["*_gyro.csv"]`. Where several patterns fit a
recording, the later one decides, option by option; its own NAME.toml takes precedence over all of them. The
command line must not contradict them.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass, replace
from datetime import date
from fnmatch import fnmatchcase
from functools import cache
from math import isfinite
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Generic, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from accelcal_cli.core.errors import AccelcalError, UnreadableError, UsageError, did_you_mean, printable
from accelcal_cli.core.formats import COLUMNS, IF_GIVEN, UNUSED, ReadOptions, reading_option, three_names
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.input_files import read_toml
from accelcal_cli.core.paths import has_file, is_same, is_there
from accelcal_cli.core.paths import stat_or_none as look
from accelcal_cli.core.settings import (
    DEFAULT,
    LEARNT_PRIORS,
    NEVER,
    NO_PRIOR,
    PAPER,
    POSES_IF_ASKED,
    PROFILES,
    RANGE_RULES,
    SIX_POSE,
    STILLNESS,
    PoseSettings,
    Settings,
    setting_of,
    with_stillness,
)
from accelcal_cli.formats import named_format
from accelcal_cli.formats.raw import FOLDER_NAME, SUFFIX, check_layout, named_layout
from accelcal_cli.optimize import named_optimizer
from accelcal_cli.output.report_reading import Document, damaged

# Reads settings and reading options back from a report's `settings`.
#
# Records are made from JSON by the types of their fields, and checked against what their fields
# allow.

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
        (kind,) = (one for one in get_args(hint) if one is not NoneType)
        return None if absent else converted(value, kind)
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
        report_only=_typed_value(values, "report_only", bool, default=False),
        layout=_file(values["input"], "layout"),
        poses=_file(values, "poses"),
        missing=missing,
        unknown=unknown,
        unused=tuple(unused),
        effect=_typed_value(values, "effect", bool, default=False),
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
    file_name = _typed_value(values, name, str, default=None)
    sha256 = _typed_value(values, f"{name}_sha256", str, default=None)
    return None if file_name is None else NamedFile(file_name, sha256)


def _typed_value(values: Mapping[str, Any], name: str, kind: type, *, default: Any) -> Any:
    value = values.get(name, default)
    if value is not default and not isinstance(value, kind):
        raise ValueError(f"{name} cannot be {str(value)[:80]!r}")
    return value


# Options, as the command line, the Python API and files name them, made into the records that the work uses.

STUDY_FILE = "study.toml"
LARGEST_FILE = 1 << 20
"""Most bytes of a file that states options."""

CHECKED_ALONE = {"timezone", "start"}
"""Options whose text can be checked without the others."""

GIVEN_VALUE = r"(=(?:'[^']*'|[\w:+./%-]+(?:,\w+)*))?"
"""Pattern of the value of `-R NAME=VALUE` in a message, with its `=`."""

MOST_DRAWS = 100_000
PAPER_ONLY = ("min_distance_g", "min_subset_points", "max_subset_points")
"""Settings that only profile `paper` has."""

BROUGHT_ALONG = (
    *("profile", *PAPER_ONLY, "stillness", "stillness_axes", "segment_seconds", "stillness_threshold_g"),
    *("optimizer", "model", "prior"),
)
"""Settings that the coefficients of a report bring along from their own recording."""

AnySettings = TypeVar("AnySettings", Settings, PoseSettings)


@cache
def option_fields(*kinds: type) -> dict[str, tuple[type, str]]:
    """Return the record and the field that each option sets, by its name in files: `lsb_per_g`."""
    return {
        option.keyword: (kind, one.name)
        for kind in kinds
        for one in fields(kind)
        if (option := setting_of(kind, one.name).option) is not None
    }


def named_fields(*fields: str) -> dict[str, tuple[type, str]]:
    """Return the options that `-R NAME=VALUE` gives: all of reading, and those of some fields of Settings."""
    others = {name: where for name, where in option_fields(Settings).items() if where[1] in fields}
    return option_fields(ReadOptions) | others


def not_given(*kinds: type) -> dict[str, Any]:
    """Return the values of all options of some records, by field, where none is given."""
    nothing: dict[str, Any] = {name: None for _, name in option_fields(*kinds).values()}
    return nothing | {"no_temperature": False, "force_timezone": False, "only_motion": False}


def named_values(texts: Iterable[tuple[str, str]], values: Mapping[str, Any], *fields: str) -> dict[str, Any]:
    """Return a command's values with those of options given by name, as `-R NAME=VALUE`.

    Args:
        texts: names and values.
        values: of the command's other options.
        fields: see `named_fields`.

    Raises:
        UsageError: a value is not possible, or another one is given, too.
    """
    known = named_fields(*fields)
    found = not_given(ReadOptions) | dict.fromkeys(fields) | dict(values)
    for name, text in texts:
        typed = {name: _typed(*known[name], text)}
        for field, value in _option_values(typed, known, f"-R {name}={text}: ").items():
            if found[field] not in (None, False, value):
                raise UsageError(f"{name} is given twice, with different values", hint="give one of them")
            found[field] = value
    return found


def _typed(kind: type, name: str, text: str) -> Any:
    """Return a text as the number or switch that a field holds; any other text as it is."""
    hint = get_type_hints(kind)[name]
    for one in {hint, *get_args(hint)} & {int, float}:
        try:
            return one(text)
        except ValueError:
            return text
    return {"true": True, "false": False}.get(text, text) if hint is bool else text


def field_values(options: Mapping[str, Any], *kinds: type) -> dict[str, Any]:
    """Return the values of options given by keyword, by field, None for those that are not given, as a
    command line would; raises what `_field_values` raises.
    """
    return not_given(ReadOptions, Settings) | _field_values(options, option_fields(*kinds))


def _field_values(options: Mapping[str, Any], known: Mapping[str, tuple[type, str]]) -> dict[str, Any]:
    """Return the values of options given by keyword, by field, without those that are None.

    Raises:
        TypeError: an option does not exist, or has a value of another type.
        UsageError: a value is out of bounds, or not one of the choices.
    """
    values = {}
    for keyword, value in options.items():
        if keyword not in known:
            meant = did_you_mean(keyword, known)
            raise TypeError("; ".join([f"there is no option {keyword!r}", *filter(None, [meant])]))
        if value is not None:
            kind, name = known[keyword]
            values["no_temperature" if keyword == "no_temperature" else name] = _checked(
                keyword, kind, name, value
            )
    return values


def _plain(name: str, value: Any) -> Any:
    """Return the value of an option as JSON has it."""
    match value:
        case tuple() | list():  # names or numbers of columns
            plain: Any = list(map(str, value))
        case Path():
            plain = str(value)
        case date():  # with a time, as TOML has them
            plain = value.isoformat()
        case np.generic():
            plain = value.item()
        case _:
            plain = value
    return three_names(plain) or plain if name in COLUMNS and isinstance(plain, str | list) else plain


def _checked(keyword: str, kind: type, name: str, value: Any) -> Any:
    plain = _plain(name, value)
    if name == "stillness_axes":
        if value not in tuple("xyz"):
            raise UsageError(f"{keyword} cannot be {value!r}", hint="possible: x, y, z")
        plain = ["xyz".index(value)]
    hint, declared = get_type_hints(kind)[name], setting_of(kind, name)
    try:
        found = converted(plain, hint)
    except TypeError:
        raise TypeError(f"{keyword} cannot be {value!r}") from None
    above = None if declared.option is None else declared.option.above
    if not declared.allows(found) or (above is not None and found <= above):
        allowed = ", ".join(declared.choices) or f"{declared.low:g} to {declared.high:g}"
        raise UsageError(f"{keyword} cannot be {value!r}", hint=f"possible: {allowed}")
    return found


def read_options(values: dict[str, Any]) -> ReadOptions:
    """Return the options of reading a recording.

    Raises:
        UsageError: a zone does not exist, or a name is not UTF-8 and could not stand in a report.
    """
    if values["timezone"] is not None and values["configured_zone"] is not None:
        raise UsageError("--timezone and -R configured_zone are the same", hint="give one of them")
    options = ReadOptions(**{name: values[name] for name in ReadOptions.__dataclass_fields__})
    options.times.check()
    columns = (*(values["columns"] or ()), *(values["gyro_columns"] or ()))
    for text in (values["time_column"], values["sensor"], *columns):
        if text is not None and re.search("[\ud800-\udfff]", text):  # stand for bytes that are not UTF-8
            raise UsageError(f"{printable(text)!r} is not UTF-8", hint="give columns by number, or rename it")
    return options


def check_draws(settings: Settings) -> None:
    """Raise UsageError if no plausible coefficients can be drawn."""
    if settings.prior == NO_PRIOR and settings.profile != PAPER.profile:
        raise UsageError("--draws needs a prior: without one no posterior is known", hint="omit --draws")


def chosen_settings(values: dict[str, Any], *, in_study: bool = False) -> Settings:
    """Return the profile's settings with those that the user changed.

    Args:
        in_study: there are other recordings from which a prior can be learnt.

    Raises:
        UsageError: the profile has no such model or number, or the stillness rule no such number.
    """
    profile = PROFILES[values["profile"] or DEFAULT.profile]
    if profile.profile == "paper" and (values["model"] or "9") not in ("auto", "9"):
        raise UsageError(
            "--profile paper fits nine parameters", hint="omit --model, or use --profile default"
        )
    for name in PAPER_ONLY if profile.profile != "paper" else ():
        if values.get(name) is not None:
            text = f"{_option(name)} is for --profile paper only"
            raise UsageError(text, hint="omit it, or use --profile paper")
    least, most = _subset_points(values)
    chosen = _stillness_settings(profile, values)
    chosen = replace(chosen, min_subset_points=least, max_subset_points=most)
    return fit_settings(values, chosen, in_study=in_study)


def _option(name: str) -> str:
    option = setting_of(Settings, name).option
    assert option is not None
    return option.name


def recipient_settings(values: dict[str, Any]) -> Settings:
    """Return the settings of a recording that coefficients of a report are applied to.

    Raises:
        UsageError: a setting is given that the coefficients bring along.
    """
    for name in BROUGHT_ALONG:
        if values.get(name) is not None:
            raise UsageError(
                f"{_option(name)} is for the recording's own calibration",
                hint="omit it: the coefficients are tested as their own recording was",
            )
    return replace(with_values(DEFAULT, values), temperature=not values["no_temperature"])


def _subset_points(values: dict[str, Any]) -> tuple[int, int]:
    """Return the fewest and most points of a subset; the one that is not given follows the other.

    Raises:
        UsageError: more are needed than taken.
    """
    least, most = values.get("min_subset_points"), values.get("max_subset_points")
    if least is not None and most is not None and least > most:
        raise UsageError(
            f"--min-subset-points {least} is more than --max-subset-points {most}", hint="make it less"
        )
    usual_least, usual_most = DEFAULT.min_subset_points, DEFAULT.max_subset_points
    return least or min(usual_least, most or usual_least), most or max(usual_most, least or usual_most)


def _stillness_settings(profile: Settings, values: dict[str, Any]) -> Settings:
    """Return the profile's settings with the user's stillness rule, checked against its numbers."""
    name, seconds = values["stillness"], values["segment_seconds"]
    chosen = profile if name is None else with_stillness(profile, name)
    if name is not None or values.get("stillness_axes") is not None:
        chosen = replace(chosen, other_stillness=False)
    if values["stillness_threshold_g"] is not None and chosen.stillness_threshold_g is None:
        raise UsageError(
            f"--stillness {chosen.stillness} has no limit on max - min",
            hint=f"omit --stillness-threshold-g, or use --stillness {' or '.join(RANGE_RULES)}",
        )
    if values.get("stillness_axes") is not None and len(chosen.stillness_axes) != 1:
        raise UsageError(
            f"--stillness {chosen.stillness} does not look at one axis",
            hint="omit --stillness-axis, or use --stillness range or --profile paper",
        )
    if chosen.adaptive is None or seconds is None:
        return chosen
    if seconds < STILLNESS["adaptive"]["segment_seconds"]:
        raise UsageError(
            "--stillness adaptive needs windows of at least 1 s", hint="give --segment-seconds 1 or more"
        )
    return replace(chosen, adaptive=replace(chosen.adaptive, min_samples=2))  # bounded by the length alone


def fit_settings(values: dict[str, Any], chosen: Settings = DEFAULT, *, in_study: bool = False) -> Settings:
    """Return settings with the user's choices of the fit, the place and the damage that is tolerated.

    Args:
        in_study: see `chosen_settings`.

    Raises:
        UsageError: there is no such optimizer, the prior does not go with the rest, or an altitude without a
            latitude.
    """
    changed = with_values(chosen, values)
    prior = _prior(changed, values.get("prior"))
    if prior in LEARNT_PRIORS and not in_study:
        raise UsageError(
            f"--prior {prior} uses other recordings and is available in a study only",
            hint=f"use accelcal study FOLDER -d OUT --prior {prior}",
        )
    temperature = changed.temperature and not values["no_temperature"]
    changed = replace(changed, temperature=temperature, prior=prior)
    if changed.profile == DEFAULT.profile:
        return changed
    if (wanted := values.get("recalibrate")) not in (None, NEVER):
        raise UsageError(f"--recalibrate {wanted} does not go with --profile paper", hint="omit one of them")
    return replace(changed, recalibrate=NEVER)  # profile `paper` keeps no windows along time


def _prior(chosen: Settings, wanted: str | None) -> str:
    """Return the prior: the given one, else the default where there can be one."""
    why = None
    if chosen.profile != DEFAULT.profile:
        why = f"--profile {chosen.profile}"
    elif named_optimizer(chosen.optimizer).fit_penalized is None:
        why = f"--optimizer {chosen.optimizer}"
    elif chosen.model != "auto":
        why = f"--model {chosen.model}"
    if wanted is None:
        return chosen.prior if why is None else NO_PRIOR
    if wanted != NO_PRIOR and why is not None:
        raise UsageError(
            f"--prior {wanted} does not go with {why}", hint="omit one of them, or use --prior none"
        )
    return wanted


def with_values(chosen: AnySettings, values: dict[str, Any]) -> AnySettings:
    """Return settings with all fields that the user gave.

    Raises:
        UsageError: there is an altitude without a latitude.
    """
    chosen_gravity(values)
    names = (name for name in chosen.__dataclass_fields__ if values.get(name) is not None)
    return replace(chosen, **{name: values[name] for name in names})


def chosen_gravity(values: dict[str, Any]) -> Gravity:
    """Return where the recording was made; raises UsageError for an altitude without a latitude."""
    if values["altitude_m"] is not None and values["latitude"] is None:
        raise UsageError("--altitude needs --latitude too", hint="give both, or neither")
    return Gravity(values["latitude"], values["altitude_m"])


@dataclass(frozen=True, slots=True)
class FolderRules:
    """The contents of a `study.toml`.

    Attributes:
        path: the file.
        folder: absolute path of the folder that its patterns are relative to.
        anywhere: recordings outside the folder are matched by their names; else no pattern fits them.
        tables: options by pattern, each the values of fields of `ReadOptions`.
        exclude: patterns of files that are not recordings.
    """

    path: Path
    folder: Path
    anywhere: bool
    tables: tuple[tuple[str, dict[str, Any]], ...]
    exclude: tuple[str, ...] = ()

    def fitting(self, path: Path) -> list[str]:
        """Return the patterns that a file fits, in their order, those of `exclude` first."""
        below = os.path.relpath(path.absolute(), self.folder).replace(os.sep, "/")
        if below.startswith("../"):
            below = path.name if self.anywhere else ""
        return [pattern for pattern in self.patterns if below and fits_pattern(below, (pattern,))]

    @property
    def patterns(self) -> tuple[str, ...]:
        """All patterns: those of `exclude`, then those of the tables."""
        return (*self.exclude, *(pattern for pattern, _ in self.tables))

    def excludes(self, path: Path) -> bool:
        """Return True if a file is not a recording."""
        return any(pattern in self.exclude for pattern in self.fitting(path))

    def choices(self, path: Path) -> Iterator[StatedOption]:
        """Yield the options stated for a file; later ones take precedence."""
        tables = dict(self.tables)
        for pattern in self.fitting(path):
            for name, value in tables.get(pattern, {}).items():
                yield StatedOption(name, value, f'{self.path.name}, "{pattern}"')

    def as_json(self) -> dict[str, Any]:
        """Return the tables by pattern, with the options' own names."""
        tables = {
            pattern: {reading_option(name).keyword: json_value(value) for name, value in values.items()}
            for pattern, values in self.tables
        }
        return {**({"exclude": list(self.exclude)} if self.exclude else {}), **tables}


@dataclass(frozen=True, slots=True)
class StatedOption:
    """One option that a file states for a recording: a field of `ReadOptions`, its value, and the file."""

    field: str
    value: Any
    origin: str

    def __str__(self) -> str:
        return f"{reading_option(self.field).keyword}={option_text(self.value)}"


@contextmanager
def name_options_as_in_file(said: Mapping[str, StatedOption]) -> Iterator[None]:
    """Let an error of the block name an option that a file states as it stands there, with the file.

    `--timezone`, which nobody typed, becomes `timezone (study.toml)`, and `-R zero=512` `zero=512`.
    """
    try:
        yield
    except AccelcalError as error:
        for one in said.values():
            option = reading_option(one.field)
            typed = re.compile(rf"{re.escape(option.name)}(?![-\w]){GIVEN_VALUE}")

            def shown(found: re.Match[str], name: str = option.keyword, origin: str = one.origin) -> str:
                return f"{name}{found[1] or ''} ({origin})"

            error.message = typed.sub(shown, error.message)
            error.hint = error.hint and typed.sub(shown, error.hint)
        raise


def fits_pattern(below: str, patterns: Iterable[str]) -> bool:
    """Return True if a path fits a pattern: its name, or all of it if the pattern has a `/`."""

    def one(pattern: str) -> bool:
        text = below if "/" in pattern else below.rpartition("/")[2]
        return fnmatchcase(text.lower(), pattern.lower())

    return any(map(one, patterns))


def json_value(value: Any) -> Any:
    """Return a value as JSON can hold it."""
    return list(value) if isinstance(value, tuple) else printable(value) if isinstance(value, Path) else value


def option_text(value: Any) -> str:
    """Return a value as it is written on the command line."""
    return ",".join(map(str, value)) if isinstance(value, tuple) else printable(str(value))


def read_rules(path: Path, folder: Path | None = None, *, found: bool = False) -> FolderRules:
    """Read a `study.toml`.

    Args:
        folder: of the recordings; None: that of the file, and recordings elsewhere are matched by name.
        found: the file was not named.

    Raises:
        UsageError: it cannot be read, or holds something that is not a reading option.
    """
    document = read_toml(path, STUDY_FILE, LARGEST_FILE, found=found)
    exclude = document.pop("exclude", [])
    if not isinstance(exclude, list) or not all(isinstance(pattern, str) for pattern in exclude):
        raise UsageError('exclude is not a list of patterns such as ["*_gyro.csv"]', path=path)
    for pattern, table in document.items():
        if not isinstance(table, Mapping):
            hint = f'write it below a pattern such as ["*.csv"], or ["*"] for all: {pattern} = ...'
            raise UsageError(f"{pattern!r} is not a table", path=path, hint=hint)
    tables = tuple((pattern, _values(table, path, f'"{pattern}": ')) for pattern, table in document.items())
    for _, values in tables:
        if "layout" in values:
            values["layout"] = values["layout"].absolute()
    return FolderRules(path, (folder or path.parent).absolute(), folder is None, tables, tuple(exclude))


def folder_rules(folders: Sequence[Path]) -> tuple[FolderRules, ...]:
    """Read the `study.toml` of each folder that has one; raises what `read_rules` raises."""
    found = ((folder / STUDY_FILE, folder) for folder in folders)
    return tuple(read_rules(path, folder, found=True) for path, folder in found if is_there(path))


def sidecar_path(path: Path) -> Path | None:
    """Return where the options of one recording may lie: `NAME.toml` next to `NAME.csv` or `NAME.csv.gz`."""
    if not path.name:
        return None
    own_file = path.with_name(named_layout(path).name.removesuffix(SUFFIX) + ".toml")
    return None if own_file.name in (STUDY_FILE, FOLDER_NAME) else own_file


def stated_options(
    path: Path, rules: Sequence[FolderRules], layout: Path | None = None
) -> dict[str, StatedOption]:
    """Return the reading options that files state for a recording, by field of `ReadOptions`.

    Args:
        layout: a layout that the user named, which may be the recording's `NAME.toml`.

    Raises:
        UsageError: its `NAME.toml` cannot be read, or holds something that is not a reading option.
    """
    stated = [choice for one in rules for choice in one.choices(path)]
    own_file = sidecar_path(path)
    if own_file is not None and has_file(own_file) and not (layout and is_same(layout, own_file)):
        table = read_toml(own_file, own_file.name, LARGEST_FILE, found=True)
        stated += [
            StatedOption(name, value, own_file.name) for name, value in _values(table, own_file).items()
        ]
    return {choice.field: choice for choice in stated}


def with_stated(options: ReadOptions, choices: Mapping[str, StatedOption], path: Path) -> ReadOptions:
    """Return options with those that files state for the recording.

    Raises:
        UsageError: they contradict each other, or do not go together.
    """
    if not choices:
        return options
    nothing = _defaults()
    values = {name: getattr(options, name) for name in nothing}
    for name, choice in choices.items():
        if values[name] != nothing[name] and values[name] != choice.value:
            given = reading_option(name).with_value(option_text(values[name]))
            text = f"{given} contradicts {choice} ({choice.origin})"
            raise UsageError(text, path=path, hint="say it in one place")
        values[name] = choice.value
    try:
        return read_options(values)
    except UsageError as error:
        raise UsageError(error.message, path=path, hint=error.hint) from error


def recording_options(path: Path, options: ReadOptions, rules: Sequence[FolderRules] = ()) -> ReadOptions:
    """Return the options by which a recording is read: those given, and those that files state.

    Raises:
        UsageError: see `stated_options` and `with_stated`.
    """
    return with_stated(options, stated_options(path, rules, options.layout), path)


def sidecar_fingerprint(choices: Mapping[str, StatedOption]) -> tuple[int, int]:
    """Return the number of stated options, and a hash of them; a layout counts with size and last change."""
    values = {name: json_value(choice.value) for name, choice in sorted(choices.items())}
    layout = choices.get("layout")
    if layout is not None and (status := look(layout.value)) is not None:
        values["layout"] = [values["layout"], status.st_size, status.st_mtime_ns]
    digest = hashlib.sha256(json.dumps(values).encode()).digest()
    return len(choices), int.from_bytes(digest[:7], "big")


def _values(table: Mapping[str, Any], path: Path, place: str = "") -> dict[str, Any]:
    """Return fields and values of a table's options; a layout's path is relative to the table's file."""
    named = {key.replace("-", "_"): value for key, value in table.items()}
    return _option_values(named, option_fields(ReadOptions), place, path)


def _option_values(
    table: Mapping[str, Any], known: Mapping[str, tuple[type, str]], place: str, path: Path | None = None
) -> dict[str, Any]:
    """Return fields and values of options given by name.

    Args:
        place: where they stand, at the beginning of a message.
        path: the file that states them.

    Raises:
        UsageError: an option does not exist, or its value is not possible.
    """
    try:
        values = _field_values(table, known)
        if "layout" in values:
            values["layout"] = (Path() if path is None else path.parent) / values["layout"]
            check_layout(values["layout"])
        for name in CHECKED_ALONE & values.keys():
            read_options(_defaults() | {name: values[name]})
    except TypeError as error:
        names = f"reading options are {', '.join(known)}"
        unknown = not table.keys() <= known.keys()
        raise UsageError(f"{place}{error}", path=path, hint=names if unknown else None) from error
    except UsageError as error:
        raise UsageError(f"{place}{error.message}", path=path, hint=error.hint) from error
    return values


def _defaults() -> dict[str, Any]:
    return {name: getattr(ReadOptions(), name) for name in ReadOptions.__dataclass_fields__}
