"""What each option of a setting accepts, written out: it may be more or less than a report may hold."""

from __future__ import annotations

import math

import click
import pytest

from accelcal_cli.cli.help import NameValue
from accelcal_cli.cli.main import cli
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.settings import Settings
from accelcal_cli.pipeline.options import named_values
from tests.cli.run import assert_one_line, run

RATE = {"calibrate", "study", "six-pose", "inspect", "apply", "evaluate methods", "evaluate stillness"}
FITTING = {"calibrate", "study", "inspect"}
WINDOWS = {*FITTING, "evaluate methods"}
TINY = 5e-324
"""The least number above zero."""

BOUNDS: list[tuple[set[str], str, float, float]] = [
    (WINDOWS, "--min-distance-g", 0, 2),
    (RATE, "--lsb-per-dps", 1e-9, 1e9),
    (RATE, "--rate", TINY, 100_000),
    (RATE, "--lsb-per-g", TINY, 1e9),
    (RATE, "--zero", -(2**30), 2**30),
    (WINDOWS, "--segment-seconds", TINY, 3600),
    ({"six-pose"}, "--segment-seconds", 0.1, 60),
    ({*WINDOWS, "six-pose"}, "--stillness-threshold-g", TINY, 4),
    ({"six-pose"}, "--face-degrees", 1, 45),
    ({"calibrate", "study", "apply"}, "--precision", 0.001, 1000),
    ({*FITTING, "six-pose", "fit", "gravity", "evaluate methods"}, "--latitude", -90, 90),
    ({*FITTING, "six-pose", "fit", "gravity", "evaluate methods"}, "--altitude", -500, 9000),
    ({*FITTING, "six-pose", "apply"}, "--max-damage", 0, 100),
    ({*FITTING, "fit", "apply", "watch"}, "--max-error", TINY, 1e6),
]
CHOICES: list[tuple[set[str], str, tuple[str, ...]]] = [
    (WINDOWS, "--profile", ("default", "paper")),
    (WINDOWS, "--stillness-axis", ("x", "y", "z")),
    (RATE, "--gyro-unit", ("deg/s", "rad/s", "none")),
    (WINDOWS, "--stillness", ("both", "range", "deviation", "adaptive")),
    ({*WINDOWS, "fit"}, "--model", ("auto", "9", "6", "3")),
    (RATE, "--unit", ("g", "mg", "m/s2", "counts")),
    (RATE, "--date-format", ("dmy", "mdy", "ymd")),
]

LEAST_IN_FILES = {
    "--rate": 1e-3,
    "--lsb-per-g": 1e-9,
    "--segment-seconds": 1e-6,
    "--stillness-threshold-g": 1e-9,
}


def option(command: str, name: str) -> click.Parameter | None:
    """The option of a command; None if it is given by name."""
    node: click.Command = cli
    for word in command.split():
        assert isinstance(node, click.Group)
        node = node.get_command(click.Context(node), word)  # type: ignore[assignment]
    if (found := next((one for one in node.params if name in one.opts), None)) is None:
        kind = next(one.type for one in node.params if "-R" in one.opts)
        assert isinstance(kind, NameValue) and name[2:].replace("-", "_") in kind.known()
    return found


def accepts(command: str, name: str, text: str) -> bool:
    parameter, by_name = option(command, name), [(name[2:].replace("-", "_"), text)]
    try:
        if parameter is None:
            named_values(by_name, {}, *Settings.__dataclass_fields__)
        else:
            parameter.type(text, parameter, None)
    except (click.BadParameter, UsageError):
        return False
    return True


@pytest.mark.parametrize(
    ("command", "name", "low", "high"),
    [(command, *row) for commands, *row in BOUNDS for command in sorted(commands)],
)
def test_numbers_within_the_bounds_and_no_others(command: str, name: str, low: float, high: float) -> None:
    if option(command, name) is None and low == TINY:  # checked as in a file
        low = LEAST_IN_FILES.get(name, low)
    beyond = (math.nextafter(low, -math.inf), math.nextafter(high, math.inf), math.nan, math.inf, -math.inf)
    assert accepts(command, name, repr(low)) and accepts(command, name, repr(high))
    assert [number for number in beyond if accepts(command, name, repr(number))] == []


@pytest.mark.parametrize(
    ("words", "bounds"),
    [(("--segment-seconds", "1e308"), "0<x<=3600"), (("--altitude", "inf"), "-500<=x<=9000")],
)
def test_an_error_names_bounds_that_the_help_omits(words: tuple[str, ...], bounds: str) -> None:
    assert_one_line(run("calibrate", "x", *words), f"is not in the range {bounds};", code=2)
    assert bounds not in run("calibrate", "--help-all").out


@pytest.mark.parametrize("name", ["--min-subset-points", "--max-subset-points"])
@pytest.mark.parametrize("command", sorted(WINDOWS))
def test_numbers_of_points_are_whole(command: str, name: str) -> None:
    found = [text for text in ("0", "1", "2", "100", "101", "1.0", "nan") if accepts(command, name, text)]
    assert found == ["1", "2", "100"]


@pytest.mark.parametrize(
    ("command", "name", "choices"),
    [(command, *row) for commands, *row in CHOICES for command in sorted(commands)],
)
def test_choices(command: str, name: str, choices: tuple[str, ...]) -> None:
    parameter = option(command, name)
    assert all(accepts(command, name, choice) for choice in choices)
    assert not any(accepts(command, name, f"{choice}x") for choice in choices)
    assert parameter is None or (
        isinstance(parameter.type, click.Choice) and len(parameter.type.choices) == len(choices)
    )
