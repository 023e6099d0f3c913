"""The settings that `--stillness` and the options of its rules make.

Numbers on the command line.

Options that several commands share, and the records made of them.

What commands that find each recording's own calibration are asked to do with it.
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
from accelcal_cli.core.settings import DEFAULT, PROFILES, STILLNESS, Settings, with_stillness
from accelcal_cli.optimize import named_optimizer
from accelcal_cli.pipeline.jobs import DEFAULT_CHUNK_SAMPLES, Request


def stillness_settings(profile: Settings, values: dict[str, Any]) -> Settings:
    """The profile's settings with the rule of stillness that the user wants, and its numbers.

    Raises:
        UsageError: a number means nothing to the rule.
    """
    name, threshold_g, seconds = (
        values[option] for option in ("stillness", "stillness_threshold_g", "segment_seconds")
    )
    chosen = profile if name is None else with_stillness(profile, name)
    if threshold_g is not None:
        if chosen.stillness_threshold_g is None:
            raise UsageError(
                f"--stillness {chosen.stillness} has no threshold of max - min",
                hint="leave --stillness-threshold-g out, or use --stillness both or range",
            )
        chosen = replace(chosen, stillness_threshold_g=threshold_g)
    return chosen if seconds is None else _with_windows(chosen, seconds)


def _with_windows(chosen: Settings, seconds: float) -> Settings:
    """The settings with windows of another length, which then has no other lower bound."""
    if chosen.adaptive is None:
        return replace(chosen, segment_seconds=seconds)
    if seconds < STILLNESS["adaptive"]["segment_seconds"]:
        raise UsageError(
            "--stillness adaptive needs windows of at least 1 s", hint="give --segment-seconds 1 or more"
        )
    return replace(chosen, segment_seconds=seconds, adaptive=replace(chosen.adaptive, min_samples=2))


class Within(click.FloatRange):
    """A finite number in a range; click's own range lets NaN pass."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Parse and check."""
        number = float(super().convert(value, param, ctx))
        if not isfinite(number):
            self.fail(f"{value} is not a finite number", param, ctx)
        return number


Command = TypeVar("Command", bound=Callable[..., Any])


class Positive(click.ParamType[float]):
    """A finite number above zero, at most `largest`."""

    name = "number"

    def __init__(self, largest: float = 1e9) -> None:
        self.largest = largest

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Parse and check."""
        try:
            number = float(value)
        except ValueError:
            self.fail(f"{value!r} is not a number", param, ctx)
        if not 0 < number <= self.largest:
            self.fail(f"{value} is not between 0 and {self.largest:g}", param, ctx)
        return number


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


_PRECISION = click.option(
    "--precision",
    "precision_mg",
    type=Within(0.001, 1000),
    metavar="MG",
    help="Write values in steps of at most so much: smaller files.  [default: exact]",
)

_PLACES = [
    click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path, readable=False)),
    click.option(
        "-d", "--output-dir", type=click.Path(path_type=Path, readable=False), help="Folder of the outputs."
    ),
    click.option(
        "-o", "--output", type=click.Path(path_type=Path, readable=False), help="Name of the Parquet file."
    ),
    _PRECISION,
]

_SAYING = [
    click.option("--json", "as_json", is_flag=True, help="Print the report, one JSON object a line."),
    click.option(
        "--force", is_flag=True, help="Redo what is up to date; overwrite what accelcal did not write."
    ),
    click.option("-q", "--quiet", is_flag=True, help="Say nothing on stderr but errors."),
    click.option("-v", "--verbose", is_flag=True, help="Say more on stderr."),
]

_READING = [
    click.option(
        "--format", "format_name", metavar="NAME", help="Format of the recording, if not by content."
    ),
    click.option("--rate", "rate_hz", type=Positive(1e5), metavar="HZ", help="Sampling rate."),
    click.option("--unit", type=click.Choice(["g", "mg", "m/s2", "counts"]), help="Unit of the raw values."),
    click.option("--lsb-per-g", type=Positive(), metavar="N", help="Counts in one g."),
    click.option("--columns", type=ColumnNames(), help="Columns of x, y, z: names, or numbers from 0."),
    click.option("--time-column", metavar="NAME", help="Column of the times."),
    click.option(
        "--date-format",
        type=click.Choice(["dmy", "mdy", "ymd"]),
        help="Order of day, month and year in dates such as 04/03/2024.",
    ),
    click.option("--timezone", metavar="ZONE", help="Zone of the device's clock, such as Europe/Berlin."),
    click.option(
        "--layout",
        type=click.Path(path_type=Path, readable=False),
        help="Layout file (TOML) of a raw dump.",
    ),
    click.option("--sensor", metavar="NAME", help="Which sensor of a file with several."),
]

_METHOD = [
    click.option(
        "--profile",
        type=click.Choice(sorted(PROFILES)),
        default="default",
        show_default=True,
        help="`paper`: the published procedure, 18 points and 50 iterations.",
    ),
    click.option(
        "--stillness",
        type=click.Choice(list(STILLNESS)),
        help="What counts as still, see docs/stillness.md.  [default: both; profile paper: range]",
    ),
    click.option(
        "--segment-seconds", type=Positive(3600), help="Length of a window.  [default: by --stillness]"
    ),
    click.option(
        "--stillness-threshold-g",
        type=Positive(4),
        help="Largest max - min of a still window, of both and range.  [default: 0.12]",
    ),
]

_FITTING = [
    click.option(
        "--optimizer",
        metavar="NAME",
        help="How parameters are found, see docs/optimizers.md.  [default: fixed32]",
    ),
    click.option(
        "--model",
        type=click.Choice(["auto", "9", "6", "3"]),
        help="Parameters to fit; auto lets held-out error decide.  [default: auto]",
    ),
    click.option("--no-temperature", is_flag=True, help="Do not use the recording's temperature."),
]

_GRAVITY = [
    click.option("--latitude", type=Within(-90, 90), metavar="DEGREES", help="Where the recording was made."),
    click.option(
        "--altitude", type=Within(-500, 9000), metavar="METRES", help="Above the sea.  [default: 0]"
    ),
]

_DAMAGE = click.option(
    "--max-damage",
    type=Within(0, 100),
    default=DEFAULT.max_damage_percent,
    show_default=True,
    metavar="PERCENT",
    help="Refuse a recording of which damage has taken more.",
)

_CHUNK = click.option(
    "--chunk-samples",
    type=click.IntRange(1),
    default=DEFAULT_CHUNK_SAMPLES,
    show_default=True,
    help="Samples held in memory at once; the result does not depend on it.",
)


def _decorate(options: list[Callable[[Any], Any]]) -> Callable[[Command], Command]:
    def decorator(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorator


place_options = _decorate(_PLACES)
saying_options = _decorate(_SAYING)
reading_options = _decorate([*_READING, _CHUNK])
chunk_option = _decorate([_CHUNK])
damage_option = _decorate([_DAMAGE])
precision_option = _decorate([_PRECISION])
gravity_options = _decorate(_GRAVITY)
fitting_options = _decorate([*_FITTING, *_GRAVITY])
method_options = _decorate([*_METHOD, *_FITTING, *_GRAVITY])


def read_options(values: dict[str, Any]) -> ReadOptions:
    """What the user said about the recording.

    Raises:
        UsageError: a zone does not exist, or a name is not UTF-8 and could not stand in a report.
    """
    utc_offset_s(values["timezone"], 0)
    for text in (values["time_column"], values["sensor"], *(values["columns"] or ())):
        if text is not None and not _utf8(text):
            raise UsageError(f"{printable(text)!r} is not UTF-8", hint="name columns by number, or rename it")
    return ReadOptions(
        format=values["format_name"],
        rate_hz=values["rate_hz"],
        unit=values["unit"],
        lsb_per_g=values["lsb_per_g"],
        columns=values["columns"],
        time_column=values["time_column"],
        date_format=values["date_format"],
        timezone=values["timezone"],
        layout=values["layout"],
        sensor=values["sensor"],
    )


def _utf8(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def settings(values: dict[str, Any]) -> Settings:
    """The profile's settings with what the user changed.

    Raises:
        UsageError: the profile has no such model, or the rule of stillness no such number.
    """
    if values["profile"] == "paper" and (values["model"] or "9") not in ("auto", "9"):
        raise UsageError(
            "profile paper fits nine parameters", hint="leave --model out, or use profile default"
        )
    return fitting_settings(values, stillness_settings(PROFILES[values["profile"]], values))


def fitting_settings(values: dict[str, Any], chosen: Settings = DEFAULT) -> Settings:
    """Settings with what the user said of the fit and of the place.

    Raises:
        UsageError: there is no such optimizer, or an altitude without a latitude.
    """
    changed = _changed(chosen, values, ("optimizer", "model"))
    named_optimizer(changed.optimizer)
    place = gravity(values)
    warm = changed.temperature and not values["no_temperature"]
    precision = values.get("precision_mg")
    allowed = values.get("max_damage", chosen.max_damage_percent)
    return replace(
        changed,
        latitude=place.latitude,
        altitude_m=place.altitude_m,
        temperature=warm,
        precision_mg=precision,
        max_damage_percent=allowed,
    )


def _changed(chosen: Settings, values: dict[str, Any], names: tuple[str, ...]) -> Settings:
    return replace(chosen, **{name: values[name] for name in names if values[name] is not None})


def gravity(values: dict[str, Any]) -> Gravity:
    """Where the recording was made; raises UsageError for an altitude without a latitude."""
    if values["altitude"] is not None and values["latitude"] is None:
        raise UsageError("--altitude says nothing without --latitude", hint="give both")
    return Gravity(values["latitude"], values["altitude"])


_REPORT_ONLY = click.option("--report-only", is_flag=True, help="Write reports but no Parquet.")
_INTEGERS = click.option(
    "--integers", is_flag=True, help="Also write each fit's points and result as fixed-point integers."
)


def calibrating_options(command: Command) -> Command:
    """The options that `request_of` needs, and how much is said."""
    for decorator in (method_options, damage_option, reading_options, saying_options):
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
        force=values["force"],
        command=("accelcal", *sys.argv[1:]),
    )
