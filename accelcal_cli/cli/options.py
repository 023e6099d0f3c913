"""Options that several commands share, and the records made of them.

The options of settings are made from what core/settings.py declares of each: name, bounds, choices, help.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from functools import wraps
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.shell_completion import CompletionItem

from accelcal_cli.cli.exit_codes import say
from accelcal_cli.cli.help import AnyType, Named, NameValue, Rare
from accelcal_cli.core.errors import UsageError, counted, did_you_mean
from accelcal_cli.core.formats import ReadOptions, reading_option, three_names
from accelcal_cli.core.input_files import may_be_archive, pattern_of
from accelcal_cli.core.paths import is_file
from accelcal_cli.core.settings import LEARNT_PRIORS, Option, Setting, Settings, setting_of
from accelcal_cli.formats import all_encoders, all_formats
from accelcal_cli.optimize import all_optimizers
from accelcal_cli.pipeline.jobs import DEFAULT_CHUNK_SAMPLES, Request, resolved_path
from accelcal_cli.pipeline.options import (
    FolderRules,
    chosen_settings,
    folder_rules,
    named_fields,
    named_values,
    read_options,
    read_rules,
)

Command = TypeVar("Command", bound=Callable[..., Any])

if TYPE_CHECKING:
    from accelcal_cli.output.registry import RegistryEntry

    AnyChoice = click.Choice[Any]
else:  # older versions of click know no kinds of these
    AnyChoice = click.Choice


LARGEST_SHOWN = 400.0
"""Bound above which the help does not show it: no user meets it."""


class Within(click.FloatRange):
    """Option type: a finite number in a range; click's own range lets NaN pass."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Parse and check."""
        plain = click.FloatRange(self.min, self.max, self.min_open, self.max_open)
        plain.name = self.name  # of the type itself, whose error names any range
        number = float(plain.convert(value, param, ctx))
        if not isfinite(number):
            self.fail(f"{value} is not a finite number", param, ctx)
        return number

    def _describe_range(self) -> str:
        """Return the bounds for the help, where a user could meet them."""
        known = [abs(bound) for bound in (self.min, self.max) if bound is not None]
        return "" if max(known, default=0.0) > LARGEST_SHOWN else super()._describe_range()


class Positive(Within):
    """Option type: a finite number above zero, at most `largest`."""

    def __init__(self, largest: float = 1e9) -> None:
        super().__init__(0, int(largest), min_open=True)


class OneOf(AnyChoice):
    """Option type: one of some words; a misspelt one is answered with the nearest."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Look it up."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter as error:
            meant = did_you_mean(str(value), map(str, self.choices))
            if not meant:
                raise
            self.fail(f"{error.message} {meant[0].upper()}{meant[1:]}", param, ctx)

    def get_missing_message(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """List the words on one line; click 8.1 gives no context."""
        return f"It is one of {', '.join(map(str, self.choices))}."


class OwnPrior(OneOf):
    """Option type: a prior that needs no other recordings."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Look it up; of one that a study learns, say where it is to be had."""
        if value in LEARNT_PRIORS:
            self.fail(f"{value} is available only in `accelcal study`: it uses other recordings.", param, ctx)
        return super().convert(value, param, ctx)


class Axis(OneOf):
    """Option type: x, y or z, as a tuple of its number."""

    def __init__(self) -> None:
        super().__init__(tuple("xyz"))

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Look it up."""
        return ("xyz".index(super().convert(value, param, ctx)),)


class Name(AnyType):
    """Option type: a name that is looked up later; a shell completes the known ones.

    Args:
        known: returns the known names; called when a shell asks for them.
        several: names may be joined by commas.
    """

    name = "name"

    def __init__(self, known: Callable[[], Iterable[str]], *, several: bool = False) -> None:
        self.known = known
        self.several = several

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the known names that begin so."""
        before, comma, begun = incomplete.rpartition(",") if self.several else ("", "", incomplete)
        return [CompletionItem(f"{before}{comma}{name}") for name in self.known() if name.startswith(begun)]


def _zones() -> list[str]:
    from zoneinfo import available_timezones

    return ["UTC", *sorted(zone for zone in available_timezones() if "/" in zone)]


FORMAT = Name(lambda: [item.name for item in all_formats()])
OPTIMIZER = Name(lambda: [item.name for item in all_optimizers()])
METHOD = Name(lambda: [f"{item.name}{end}" for item in all_optimizers() for end in ("", ":paper")])
OPTIMIZERS = Name(lambda: [item.name for item in all_optimizers()], several=True)
ENCODER = Name(lambda: [item.name for item in all_encoders()])


class ColumnNames(AnyType):
    """Option type: three names separated by commas, or one."""

    name = "X,Y,Z"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, str, str]:
        """Split and count."""
        if (names := three_names(value)) is None:
            self.fail(f"{value!r} is not three names separated by commas, nor one", param, ctx)
        return names[0], names[1], names[2]


class Listed(AnyType):
    """Option type: different numbers of one kind within bounds, separated by commas."""

    name = "numbers"

    def __init__(self, kind: type[int] | type[float], least: float, largest: float) -> None:
        self.kind = kind
        self.least = least
        self.largest = largest

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[Any, ...]:
        """Split, parse and check."""
        if isinstance(value, tuple):
            return value
        parts = str(value).replace(",", " ").split()
        try:
            numbers = tuple(dict.fromkeys(self.kind(part) for part in parts))
        except ValueError:
            numbers = ()
        if not numbers:
            self.fail(f"{value!r} is not a list of numbers separated by commas", param, ctx)
        for number in numbers:
            if not self.least <= number <= self.largest:
                self.fail(f"{number} is not between {self.least:g} and {self.largest:g}", param, ctx)
        return numbers


FILE = click.Path(path_type=Path, readable=False)


def setting_option(
    kind: type, name: str, *, rare: bool | None = None, **words: Any
) -> Callable[[Command], Command]:
    """Return the option that sets a field of a record; its value is None if it is not given.

    Args:
        rare: whether only `--help-all` shows it; None: as the field's metadata say.
        words: arguments of click.option that override those from the field's metadata.
    """
    declared, default = setting_of(kind, name), kind.__dataclass_fields__[name].default  # type: ignore[attr-defined]
    option = declared.option
    assert option is not None
    given: dict[str, Any] = {"cls": Rare if rare or (rare is None and option.rare) else None}
    if isinstance(default, bool):
        return click.option(option.name, is_flag=True, help=option.help, **given)
    shown = option.default or (f"{default:g}" if isinstance(default, float) else default)
    text = option.help if shown is None else f"{option.help}  [default: {shown}]"
    kind_of = _type_of(declared, option, whole=isinstance(default, int))
    metavar = option.metavar or "|".join(declared.choices) or None
    given |= {"type": kind_of, "metavar": metavar, "help": text} | words
    return click.option(option.name, name, **given)


def _type_of(declared: Setting, option: Option, *, whole: bool) -> AnyType | None:
    if declared.choices:
        return OneOf(declared.choices)
    low, high = option.bounds or (declared.low, declared.high)
    if whole and low is not None and high is not None:
        return click.IntRange(int(low), int(high))
    if option.above is not None:
        return Within(option.above, high, min_open=True)
    return None if low is None else Within(low, high)


def _settings_options(*names: str, rare: bool | None = None) -> list[Callable[[Any], Any]]:
    return [setting_option(Settings, name, rare=rare) for name in names]


def _named_option(*fields: str, what: str = "Any other reading option") -> Callable[[Command], Command]:
    """Return the option `-R NAME=VALUE`, whose values the command gets with those of its other options.

    Args:
        fields: of `Settings` that are given so.
        what: which options these are, for the help.
    """

    def known() -> dict[str, Named]:
        return {name: _named(*where) for name, where in named_fields(*fields).items()}

    option = click.option(
        "-R", "named", type=NameValue(known), multiple=True,
        help=f"{what} (--help-all lists them).",
    )  # fmt: skip

    def decorator(command: Command) -> Command:
        @wraps(command)
        def with_named(*words: Any, named: Sequence[tuple[str, str]], **values: Any) -> Any:
            return command(*words, **named_values(named, values, *fields))

        return option(with_named)  # type: ignore[return-value]

    return decorator


def _named(kind: type, name: str) -> Named:
    """Return how the help shows an option that is given by name."""
    declared = setting_of(kind, name)
    assert declared.option is not None
    switch = isinstance(kind.__dataclass_fields__[name].default, bool)  # type: ignore[attr-defined]
    kind_of = getattr(_READ_TYPES.get(name), "name", "").upper() or "N"
    form = "true" if switch else "|".join(declared.choices) or declared.option.metavar or kind_of
    return Named(form, declared.option.help)


_READ_TYPES: dict[str, Any] = {
    "columns": ColumnNames(), "gyro_columns": ColumnNames(), "layout": FILE, "format": FORMAT,
    "timezone": Name(_zones),
}  # fmt: skip
"""Option types of reading options that their Settings do not state."""

DAMAGE = ("max_damage_percent",)
"""Settings that are given by name, as the rarer reading options are."""

OWN_PRIORS = tuple(name for name in setting_of(Settings, "prior").choices if name not in LEARNT_PRIORS)
"""Priors that need no other recordings."""

_PLACES = [
    click.argument("recordings", nargs=-1, required=True, type=FILE),
    click.option("-d", "--output-dir", type=FILE, help="Folder for the outputs."),
    click.option("-o", "--output", type=FILE, help="Name of the calibrated Parquet file."),
    *_settings_options("precision_mg"),
]

_PRINTING = [
    click.option("--json", "as_json", is_flag=True, help="Print the reports, one JSON object a line."),
    click.option("--tsv", is_flag=True, help="Print tab-separated fields at a terminal too."),
    click.option("--force", is_flag=True, help="Redo what is up to date; overwrite foreign files."),
    click.option("-q", "--quiet", is_flag=True, help="Say less: only errors and refusals."),
    click.option("-v", "--verbose", is_flag=True, help="Say more."),
]


def _reading(*, shown: Sequence[str] | None = None) -> list[Callable[[Any], Any]]:
    """Return the options of reading.

    Args:
        shown: those that are not rare; None: as their fields say.
    """
    return [
        setting_option(
            ReadOptions,
            name,
            rare=None if shown is None else name not in shown,
            **({"type": _READ_TYPES[name]} if name in _READ_TYPES else {}),
        )
        for name in ReadOptions.__dataclass_fields__
        if not reading_option(name).by_name
    ]


_METHOD_ONLY = ("min_distance_g", "min_subset_points", "max_subset_points", "stillness")
_WINDOWS = ("segment_seconds", "stillness_threshold_g", "longest_gap_s")
_OPTIMIZER = setting_option(Settings, "optimizer", type=OPTIMIZER)
_PRIOR = setting_option(Settings, "prior", type=OwnPrior(OWN_PRIORS), metavar="|".join(OWN_PRIORS))
_ANY_PRIOR = setting_option(
    Settings,
    "prior",
    metavar="NAME",
    help="none, population, study (learn from its other devices) or device (also from the same device).  "
    "[default: population]",
)
_GRAVITY = _settings_options("latitude", "altitude_m")


def _method(*, rare: bool | None = None) -> list[Callable[[Any], Any]]:
    """Return the options of the method, except the prior."""
    return [
        *_settings_options("profile", rare=rare),
        *_settings_options(*_METHOD_ONLY),
        setting_option(Settings, "stillness_axes", type=Axis()),
        *_settings_options(*_WINDOWS),
        _OPTIMIZER,
        *_settings_options("model", "temperature", rare=rare),
    ]


_CHUNK = click.option(
    "--chunk-samples", cls=Rare, type=click.IntRange(1), default=DEFAULT_CHUNK_SAMPLES, show_default=True,
    metavar="N",
    help="Samples held in memory at a time. The result does not depend on it.",
)  # fmt: skip
_REPORT_ONLY = click.option("--report-only", is_flag=True, help="Write no calibrated data.")
_KEEP_REFUSED = click.option(
    "--keep-refused", is_flag=True, help="Write raw data of refused recordings, marked as raw."
)
_EFFECT = click.option("--effect", is_flag=True, help="Also report ENMO, MAD and MVPA, raw and calibrated.")
_INTEGERS = click.option(
    "--integers", cls=Rare, is_flag=True, help="Also write points and fits as fixed-point integers."
)


def _decorate(options: list[Callable[[Any], Any]]) -> Callable[[Command], Command]:
    def decorator(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorator


place_options = _decorate(_PLACES)
measuring_options = _decorate([_REPORT_ONLY, _EFFECT])
printing_options = _decorate(_PRINTING)
stream_options = _decorate([*_reading(), _named_option(*DAMAGE)])
reading_options = _decorate([*_reading(), _named_option(*DAMAGE), _CHUNK])
study_reading_options = _decorate([*_reading(shown=("timezone", "sensor")), _named_option(*DAMAGE), _CHUNK])
chunk_option = _decorate([_CHUNK])
error_option = _decorate(_settings_options("max_error_mg"))
strict_option = _decorate(_settings_options("strict"))
precision_option = _decorate(_settings_options("precision_mg"))
gravity_options = _decorate(_GRAVITY)
fitting_options = _decorate([_OPTIMIZER, *_settings_options("model", "temperature"), _PRIOR, *_GRAVITY])
method_options = _decorate([*_method(), _PRIOR, *_GRAVITY])
study_method_options = _decorate([*_method(rare=True), _ANY_PRIOR, *_GRAVITY])
recalibrate_option = _decorate(_settings_options("recalibrate"))

_BY_NAME = _named_option(
    *("stillness_axes", *_METHOD_ONLY[:3], *_WINDOWS, "latitude", "altitude_m"),
    what="Any other option of `calibrate` for reading and judging",
)
"""Settings of a method that the laboratory takes by name."""

_COMPARED = _settings_options("profile", "stillness", "model", "temperature")
laboratory_reading_options = _decorate([_named_option(), _CHUNK])
comparing_options = _decorate([_BY_NAME, _CHUNK, *_COMPARED])
laboratory_options = _decorate([_BY_NAME, _CHUNK, *_COMPARED, _OPTIMIZER, _PRIOR])


registry_option = click.option(
    "--registry", cls=Rare, type=FILE, metavar="FILE.json",
    help="Registry of devices, for refused recordings.",
)  # fmt: skip


def registry_of(values: dict[str, Any]) -> list[RegistryEntry] | None:
    """Return the entries of --registry; raises UnreadableError for any other file."""
    from accelcal_cli.output.registry import read_registry  # which --help does not need

    path: Path | None = values["registry"]
    return None if path is None else read_registry(path)


config_option = click.option("--config", type=FILE, metavar="FILE.toml", help="Reading options by file name.")


parts_option = click.option("--parts", is_flag=True, help="RECORDING is a folder of parts of one recording.")


def recordings_of(recordings: tuple[Path, ...], values: dict[str, Any]) -> list[Path]:
    """Return the recordings, several files with --parts as one; raises what `pattern_of` raises."""
    recordings = tuple(resolved_path(one) if one.name in ("", "..") else one for one in recordings)
    recordings = _without_results(recordings)
    several = values["parts"] and len(recordings) > 1
    files = several and all(is_file(one) and not may_be_archive(one) for one in recordings)
    return [pattern_of(recordings)] if files else list(recordings)


def _without_results(named: tuple[Path, ...]) -> tuple[Path, ...]:
    """Return files without accelcal's own results, which `*` names too; raises UsageError if none stay."""
    if len(named) < 2:
        return named
    from accelcal_cli.pipeline.outputs import is_own_result  # it takes longer to load than to show --help

    others = tuple(one for one in named if not is_own_result(one))
    if not others:
        raise UsageError("all of these are results of accelcal", hint="name the recordings")
    if number := len(named) - len(others):
        say(f"{counted(number, 'file')} left out: results of accelcal are not recordings")
    return others


def rules_of(values: dict[str, Any], folders: tuple[Path, ...] | None = None) -> tuple[FolderRules, ...]:
    """Read the rules of --config for the recordings in folders, else those of a study.toml in each of them.

    Args:
        folders: folders of a study; None for single recordings, whose patterns are relative to the file.

    Raises:
        UsageError: the file cannot be read, or contains something that is not a reading option.
    """
    path: Path | None = values["config"]
    if path is None:
        return () if folders is None else folder_rules(folders)
    return tuple(read_rules(path, folder) for folder in folders or (None,))


def calibrating_options(command: Command) -> Command:
    """Add the options that `request_of` needs, and those of printing."""
    return _calibrating(method_options(reading_options(command)))


def study_options(command: Command) -> Command:
    """Add what `calibrating_options` does, with the priors that a study learns."""
    return _calibrating(study_method_options(study_reading_options(command)))


def _calibrating(command: Command) -> Command:
    limits = (recalibrate_option, error_option, strict_option)
    for decorator in (*limits, registry_option, config_option, printing_options):
        command = decorator(command)
    return measuring_options(_KEEP_REFUSED(_INTEGERS(command)))


def request_of(values: dict[str, Any], folders: tuple[Path, ...] | None = None) -> Request:
    """Make the request from the options of `calibrate` and `study`; raises what its parts raise.

    Args:
        folders: folders of a study.
    """
    return Request(
        options=read_options(values),
        settings=chosen_settings(values, in_study=folders is not None),
        chunk_samples=values["chunk_samples"],
        report_only=values["report_only"],
        keep_refused=values["keep_refused"],
        integers=values["integers"],
        windows=values.get("windows"),
        draws=values.get("draws") or 0,
        registry=registry_of(values),
        effect=values["effect"],
        force=values["force"],
        command=("accelcal", *sys.argv[1:]),
        rules=rules_of(values, folders),
        parts=folders is not None or values["parts"],
        joined=folders is None and values["parts"],
    )
