"""Options that several commands share, and the records made of them.

The options of settings are made from what core/settings.py declares of each: name, bounds, choices, help.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar

import click

from accelcal_cli.core.clock import utc_offset_s
from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.settings import (
    DEFAULT,
    NEVER,
    NO_PRIOR,
    PROFILES,
    RANGE_RULES,
    STILLNESS,
    Option,
    PoseSettings,
    Setting,
    Settings,
    setting_of,
    with_stillness,
)
from accelcal_cli.optimize import named_optimizer
from accelcal_cli.pipeline.jobs import DEFAULT_CHUNK_SAMPLES, Request

Command = TypeVar("Command", bound=Callable[..., Any])
AnySettings = TypeVar("AnySettings", Settings, PoseSettings)


class Within(click.FloatRange):
    """A finite number in a range; click's own range lets NaN pass."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Parse and check."""
        number = float(super().convert(value, param, ctx))
        if not isfinite(number):
            self.fail(f"{value} is not a finite number", param, ctx)
        return number


class Positive(Within):
    """A finite number above zero, at most `largest`."""

    def __init__(self, largest: float = 1e9) -> None:
        super().__init__(0, int(largest), min_open=True)


class ColumnNames(click.ParamType[tuple[str, str, str]]):
    """Three names separated by commas."""

    name = "X,Y,Z"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, str, str]:
        """Split and count."""
        if isinstance(value, tuple):
            return value
        parts = [part.strip() for part in str(value).split(",")]
        if len(parts) != 3 or not all(parts):
            self.fail(f"{value!r} is not three names separated by commas", param, ctx)
        return parts[0], parts[1], parts[2]


class Listed(click.ParamType[tuple[Any, ...]]):
    """Different numbers of one kind within bounds, separated by commas."""

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


def setting_option(kind: type, name: str, **words: Any) -> Callable[[Command], Command]:
    """The option that sets a field of a record; None if it is not given.

    Args:
        words: passed to click in place of what the field's metadata say.
    """
    declared, default = setting_of(kind, name), kind.__dataclass_fields__[name].default  # type: ignore[attr-defined]
    option = declared.option
    assert option is not None
    if isinstance(default, bool):
        return click.option(option.name, is_flag=True, help=option.help)
    shown = f"{default:g}" if isinstance(default, float) else default
    shown = option.default or shown
    text = option.help if shown is None else f"{option.help}  [default: {shown}]"
    given = {"type": _type_of(declared, option), "metavar": option.metavar, "help": text} | words
    return click.option(option.name, name, **given)


def _type_of(declared: Setting, option: Option) -> click.ParamType[Any] | None:
    if declared.choices:
        return click.Choice(declared.choices)
    low, high = option.bounds or (declared.low, declared.high)
    if option.above is not None:
        return Within(option.above, high, min_open=True)
    return None if low is None else Within(low, high)


def _settings_options(*names: str) -> list[Callable[[Any], Any]]:
    return [setting_option(Settings, name) for name in names]


_READ_TYPES: dict[str, Any] = {"columns": ColumnNames(), "layout": FILE}
"""Types of reading options that their Settings do not state."""

_PLACES = [
    click.argument("recordings", nargs=-1, required=True, type=FILE),
    click.option("-d", "--output-dir", type=FILE, help="Folder for the outputs."),
    click.option("-o", "--output", type=FILE, help="Name of the Parquet file."),
    *_settings_options("precision_mg"),
]

_PRINTING = [
    click.option("--json", "as_json", is_flag=True, help="Print the report, one JSON object per line."),
    click.option("--tsv", is_flag=True,
                 help="Print fields at a terminal too, instead of a sentence."),
    click.option("--force", is_flag=True,
                 help="Redo outputs that are up to date; overwrite files that accelcal did not write."),
    click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors on stderr."),
    click.option("-v", "--verbose", is_flag=True, help="Print more on stderr."),
]  # fmt: skip

_READING = [
    setting_option(ReadOptions, name, **({"type": _READ_TYPES[name]} if name in _READ_TYPES else {}))
    for name in ReadOptions.__dataclass_fields__
]
_METHOD = _settings_options(
    "profile", "min_distance_g", "stillness", "segment_seconds", "stillness_threshold_g", "longest_gap_s"
)
_FITTING = _settings_options("optimizer", "model", "prior", "temperature")
_GRAVITY = _settings_options("latitude", "altitude_m")

_CHUNK = click.option(
    "--chunk-samples", type=click.IntRange(1), default=DEFAULT_CHUNK_SAMPLES, show_default=True,
    help="Samples held in memory at a time; the result does not depend on it.",
)  # fmt: skip
_REPORT_ONLY = click.option("--report-only", is_flag=True, help="Write reports but no Parquet.")
_INTEGERS = click.option(
    "--integers", is_flag=True, help="Also write each fit's points and result as fixed-point integers."
)


def _decorate(options: list[Callable[[Any], Any]]) -> Callable[[Command], Command]:
    def decorator(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorator


place_options = _decorate(_PLACES)
printing_options = _decorate(_PRINTING)
reading_options = _decorate([*_READING, _CHUNK])
chunk_option = _decorate([_CHUNK])
damage_option = _decorate(_settings_options("max_damage_percent"))
precision_option = _decorate(_settings_options("precision_mg"))
gravity_options = _decorate(_GRAVITY)
fitting_options = _decorate([*_FITTING, *_GRAVITY])
method_options = _decorate([*_METHOD, *_FITTING, *_GRAVITY])
_recalibrate_option = _decorate(_settings_options("recalibrate"))
comparing_options = _decorate([*_METHOD, *_settings_options("model", "temperature"), *_GRAVITY])
"""Those of a method but for the optimizer and the prior."""


def read_options(values: dict[str, Any]) -> ReadOptions:
    """What the user said about the recording.

    Raises:
        UsageError: a zone does not exist, or a name is not UTF-8 and could not stand in a report.
    """
    utc_offset_s(values["timezone"], 0)
    if values["force_timezone"] and values["timezone"] is None:
        raise UsageError("--force-timezone has no zone to use", hint="give it with --timezone")
    for text in (values["time_column"], values["sensor"], *(values["columns"] or ())):
        if text is not None and not _utf8(text):
            raise UsageError(f"{printable(text)!r} is not UTF-8", hint="give columns by number, or rename it")
    return ReadOptions(**{name: values[name] for name in ReadOptions.__dataclass_fields__})


def _utf8(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def settings(values: dict[str, Any]) -> Settings:
    """The profile's settings with what the user changed.

    Raises:
        UsageError: the profile has no such model or number, or the stillness rule no such number.
    """
    profile = PROFILES[values["profile"] or DEFAULT.profile]
    if profile.profile == "paper" and (values["model"] or "9") not in ("auto", "9"):
        raise UsageError(
            "--profile paper fits nine parameters", hint="omit --model, or use --profile default"
        )
    if profile.profile != "paper" and values["min_distance_g"] is not None:
        raise UsageError(
            "--min-distance-g is for --profile paper only", hint="omit it, or use --profile paper"
        )
    return fitting_settings(values, _stillness_settings(profile, values))


def _stillness_settings(profile: Settings, values: dict[str, Any]) -> Settings:
    """The profile's settings with the stillness rule that the user wants, checked against its numbers."""
    name, seconds = values["stillness"], values["segment_seconds"]
    chosen = profile if name is None else with_stillness(profile, name)
    if values["stillness_threshold_g"] is not None and chosen.stillness_threshold_g is None:
        raise UsageError(
            f"--stillness {chosen.stillness} has no limit on max - min",
            hint=f"omit --stillness-threshold-g, or use --stillness {' or '.join(RANGE_RULES)}",
        )
    if chosen.adaptive is None or seconds is None:
        return chosen
    if seconds < STILLNESS["adaptive"]["segment_seconds"]:
        raise UsageError(
            "--stillness adaptive needs windows of at least 1 s", hint="give --segment-seconds 1 or more"
        )
    return replace(chosen, adaptive=replace(chosen.adaptive, min_samples=2))  # bounded by the length alone


def fitting_settings(values: dict[str, Any], chosen: Settings = DEFAULT) -> Settings:
    """Settings with what the user said of the fit, the place and the damage that is tolerated.

    Raises:
        UsageError: there is no such optimizer, the prior does not go with the rest, or an altitude without a
            latitude.
    """
    changed = with_given(chosen, values)
    prior = _prior(changed, values.get("prior"))
    recalibrate = _recalibrate(changed, values.get("recalibrate"))
    temperature = changed.temperature and not values["no_temperature"]
    return replace(changed, temperature=temperature, prior=prior, recalibrate=recalibrate)


def _recalibrate(chosen: Settings, given: str | None) -> str:
    """Whether to follow a sensor that changes; profile `paper` has no windows along time to see it by."""
    if chosen.profile == DEFAULT.profile:
        return chosen.recalibrate
    if given not in (None, NEVER):
        raise UsageError(f"--recalibrate {given} does not go with --profile paper", hint="omit one of them")
    return NEVER


def _prior(chosen: Settings, given: str | None) -> str:
    """The prior: the one given, else the default where there can be one."""
    why = _why_no_prior(chosen)
    if given is None:
        return chosen.prior if why is None else NO_PRIOR
    if given != NO_PRIOR and why is not None:
        raise UsageError(
            f"--prior {given} does not go with {why}", hint="omit one of them, or use --prior none"
        )
    return given


def _why_no_prior(chosen: Settings) -> str | None:
    """The option that leaves no room for a prior."""
    if chosen.profile != DEFAULT.profile:
        return f"--profile {chosen.profile}"
    if named_optimizer(chosen.optimizer).fit_penalized is None:
        return f"--optimizer {chosen.optimizer}"
    return None if chosen.model == "auto" else f"--model {chosen.model}"


def with_given(chosen: AnySettings, values: dict[str, Any]) -> AnySettings:
    """Settings with all fields that the user gave; raises UsageError for an altitude without a latitude."""
    gravity(values)
    names = (name for name in chosen.__dataclass_fields__ if values.get(name) is not None)
    return replace(chosen, **{name: values[name] for name in names})


def gravity(values: dict[str, Any]) -> Gravity:
    """Where the recording was made; raises UsageError for an altitude without a latitude."""
    if values["altitude_m"] is not None and values["latitude"] is None:
        raise UsageError("--altitude needs --latitude too", hint="give both, or neither")
    return Gravity(values["latitude"], values["altitude_m"])


def calibrating_options(command: Command) -> Command:
    """The options that `request_of` needs, and how much is printed."""
    for decorator in (_recalibrate_option, method_options, damage_option, reading_options, printing_options):
        command = decorator(command)
    return _REPORT_ONLY(_INTEGERS(command))


def request_of(values: dict[str, Any]) -> Request:
    """The request that the options of `calibrate` and `study` make; raises what its parts raise."""
    return Request(
        options=read_options(values),
        settings=settings(values),
        chunk_samples=values["chunk_samples"],
        report_only=values["report_only"],
        integers=values["integers"],
        windows=values.get("windows"),
        force=values["force"],
        command=("accelcal", *sys.argv[1:]),
    )
