"""What is asked for by name, as on the command line, made into the records that the work is done by.

Names are those of the records' fields; None stands for what is not given. Text and bounds of single values
have been checked by click, or by `values_of`; here is what goes together and what does not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from datetime import date
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np

from accelcal_cli.core.errors import UsageError, did_you_mean, printable
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.settings import (
    DEFAULT,
    LEARNT_PRIORS,
    NEVER,
    NO_PRIOR,
    PROFILES,
    RANGE_RULES,
    STILLNESS,
    PoseSettings,
    Settings,
    setting_of,
    with_stillness,
)
from accelcal_cli.optimize import named_optimizer
from accelcal_cli.pipeline.report_settings import converted

OF_PAPER = ("min_distance_g", "min_subset_points", "max_subset_points")
"""Settings of profile `paper` alone."""

OF_A_FIT = (
    *("profile", *OF_PAPER, "stillness", "stillness_axes", "segment_seconds", "stillness_threshold_g"),
    *("optimizer", "model", "prior"),
)
"""Settings that coefficients of a report bring with them."""

AnySettings = TypeVar("AnySettings", Settings, PoseSettings)


@cache
def keywords(*kinds: type) -> dict[str, tuple[type, str]]:
    """The record and the field that each option sets, by its name without dashes: `lsb_per_g`."""
    return {
        option.name.removeprefix("--").replace("-", "_"): (kind, one.name)
        for kind in kinds
        for one in fields(kind)
        if (option := setting_of(kind, one.name).option) is not None
    }


def values_of(options: Mapping[str, Any], *kinds: type) -> dict[str, Any]:
    """What options given by keyword say, by field; only those that are given.

    Raises:
        TypeError: an option does not exist, or has a value of another type.
        UsageError: a value is out of bounds, or is none of the choices.
    """
    known, values = keywords(*kinds), {}
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


def _checked(keyword: str, kind: type, name: str, value: Any) -> Any:
    """A value of an option, as its field's type."""
    plain = list(map(str, value)) if isinstance(value, tuple | list) else value  # names or numbers of columns
    plain = str(plain) if isinstance(plain, Path) else plain
    plain = plain.isoformat() if isinstance(plain, date) else plain  # a date and time, as TOML has them
    if name == "stillness_axes":
        if value not in tuple("xyz"):
            raise UsageError(f"{keyword} cannot be {value!r}", hint="possible: x, y, z")
        plain = ["xyz".index(value)]
    hint, declared = get_type_hints(kind)[name], setting_of(kind, name)
    try:
        found = converted(plain.item() if isinstance(plain, np.generic) else plain, hint)
    except TypeError:
        raise TypeError(f"{keyword} cannot be {value!r}") from None
    above = None if declared.option is None else declared.option.above
    if not declared.allows(found) or (above is not None and found <= above):
        allowed = ", ".join(declared.choices) or f"{declared.low:g} to {declared.high:g}"
        raise UsageError(f"{keyword} cannot be {value!r}", hint=f"possible: {allowed}")
    return found


def read_options(values: dict[str, Any]) -> ReadOptions:
    """What the user said about the recording.

    Raises:
        UsageError: a zone does not exist, or a name is not UTF-8 and could not stand in a report.
    """
    if values["timezone"] is not None and values["configured_zone"] is not None:
        raise UsageError("--timezone and --configured-zone are the same", hint="give one of them")
    options = ReadOptions(**{name: values[name] for name in ReadOptions.__dataclass_fields__})
    options.times.check()
    columns = (*(values["columns"] or ()), *(values["gyro_columns"] or ()))
    for text in (values["time_column"], values["sensor"], *columns):
        if text is not None and not _utf8(text):
            raise UsageError(f"{printable(text)!r} is not UTF-8", hint="give columns by number, or rename it")
    return options


def _utf8(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def settings(values: dict[str, Any], *, in_study: bool = False) -> Settings:
    """The profile's settings with what the user changed.

    Args:
        in_study: whether there are other recordings from which a prior can be learnt.

    Raises:
        UsageError: the profile has no such model or number, or the stillness rule no such number.
    """
    profile = PROFILES[values["profile"] or DEFAULT.profile]
    if profile.profile == "paper" and (values["model"] or "9") not in ("auto", "9"):
        raise UsageError(
            "--profile paper fits nine parameters", hint="omit --model, or use --profile default"
        )
    for name in OF_PAPER if profile.profile != "paper" else ():
        if values.get(name) is not None:
            text = f"{_option(name)} is for --profile paper only"
            raise UsageError(text, hint="omit it, or use --profile paper")
    least, most = _subset_points(values)
    chosen = _stillness_settings(profile, values)
    chosen = replace(chosen, min_subset_points=least, max_subset_points=most)
    return fitting_settings(values, chosen, in_study=in_study)


def _option(name: str) -> str:
    """The option of a field of `Settings`."""
    option = setting_of(Settings, name).option
    assert option is not None
    return option.name


def settings_beside(values: dict[str, Any]) -> Settings:
    """What the user may say besides coefficients, as for `apply`.

    Raises:
        UsageError: a setting is given that the coefficients bring along.
    """
    for name in OF_A_FIT:
        if values.get(name) is not None:
            raise UsageError(
                f"{_option(name)} is for the recording's own calibration",
                hint="omit it: the coefficients are tested as their own recording was",
            )
    return replace(with_given(DEFAULT, values), temperature=not values["no_temperature"])


def _subset_points(values: dict[str, Any]) -> tuple[int, int]:
    """Fewest and most points of a subset; the one that is not given goes along with the other.

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
    """The profile's settings with the stillness rule that the user wants, checked against its numbers."""
    name, seconds = values["stillness"], values["segment_seconds"]
    chosen = profile if name is None else with_stillness(profile, name)
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


def fitting_settings(
    values: dict[str, Any], chosen: Settings = DEFAULT, *, in_study: bool = False
) -> Settings:
    """Settings with what the user said of the fit, the place and the damage that is tolerated.

    Args:
        in_study: see `settings`.

    Raises:
        UsageError: there is no such optimizer, the prior does not go with the rest, or an altitude without a
            latitude.
    """
    changed = with_given(chosen, values)
    prior = _prior(changed, values.get("prior"))
    if prior in LEARNT_PRIORS and not in_study:
        raise UsageError(
            f"--prior {prior} is learnt from other recordings",
            hint="use it with `accelcal study FOLDER -d OUT`",
        )
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
