"""Help of every command: groups, examples that the command takes, no words that a reader cannot know."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click
import pytest

from accelcal_cli.cli.evaluate import PARTS
from accelcal_cli.cli.help import GROUPS, Command, NameValue, Rare
from accelcal_cli.cli.main import COMMANDS, SECTIONS, cli
from tests.cli.run import assert_one_line, run

NAMES = [(name,) for name in COMMANDS if name != "evaluate"] + [("evaluate", name) for name in PARTS]


def command(names: tuple[str, ...]) -> Command:
    """The command of a name or two."""
    found: click.Command = cli
    for name in names:
        assert isinstance(found, click.Group)
        one = found.get_command(click.Context(found), name)
        assert one is not None
        found = one
    assert isinstance(found, Command)
    return found


@pytest.mark.parametrize("names", NAMES, ids=" ".join)
def test_every_command_has_two_examples_that_it_takes(names: tuple[str, ...]) -> None:
    found = command(names)
    assert len(found.examples) >= 2
    for example in found.examples:
        line, _, _ = example.partition(" # ")
        words = shlex.split(line)
        assert tuple(words[: len(names)]) == names
        found.make_context(names[-1], words[len(names) :])


def test_every_option_that_commands_share_is_in_one_group() -> None:
    grouped = [name for names in GROUPS.values() for name in names]
    assert len(set(grouped)) == len(grouped)
    options = {one.name for names in NAMES for one in command(names).params if isinstance(one, click.Option)}
    assert set(grouped) - {"help", "help_all"} <= options


@pytest.mark.parametrize("names", NAMES, ids=" ".join)
def test_help_is_one_screen_and_help_all_has_every_option(names: tuple[str, ...]) -> None:
    """And it names what its reader has: no words of ours, no document that is elsewhere."""
    common, everything = (run(*names, words, code=0).out for words in ("--help", "--help-all"))
    assert common.startswith(f"Usage: accelcal {' '.join(names)}") and "Examples:" in common
    assert "--help" in common
    for word in ("STEM", "docs/", ".md", "postures", "sphere", "1000000"):
        assert word not in common, word
    assert max(map(len, common.splitlines())) <= 100 and len(common.splitlines()) <= 60
    assert not re.search(r"^Options:\n(  .*\n)*  (-h, )?--help ", common, re.MULTILINE), "it is in a group"
    assert f"accelcal {names[0]}" in (Path(__file__).parents[2] / "README.md").read_text()
    for one in command(names).params:
        if isinstance(one, click.Option):
            assert re.search(rf"^  (-\w, )?{one.opts[-1]}\b", everything, re.MULTILINE), one.opts
            assert isinstance(one, Rare) or re.search(rf"^  (-\w, )?{one.opts[-1]}\b", common, re.MULTILINE)
        if isinstance(one.type, NameValue):
            known = {f"--{name.replace('_', '-')}" for name in one.type.known()}
            own = {word for other in command(names).params for word in other.opts}
            assert all(f"  {name[2:].replace('-', '_')}=" in everything for name in known - own)


def test_the_surface_is_small() -> None:
    shared = [
        one.opts[-1] for names in NAMES for one in command(names).params if isinstance(one, click.Option)
    ]
    assert len(COMMANDS) <= 14
    assert len(shared) <= 400
    assert len(set(shared)) <= 110


@pytest.mark.parametrize(
    ("words", "form"),
    [
        (("calibrate", "a.csv", "--date-format", "dmy"), "--date-format is now -R date_format=dmy"),
        (("study", "in", "--zero=512", "-d", "out"), "--zero is now -R zero=512"),
        (("inspect", "--time-format", "%d/%m/%Y %H", "a"), "is now -R time_format='%d/%m/%Y %H'"),
        (("apply", "a", "--force-timezone"), "is now -R force_timezone=true"),
        (("watch", "a", "--max-damage"), "is now -R max_damage=PERCENT"),
        (("devices", "out", "--offset-mg", 3), "--offset-mg is now --rule offset_mg=3"),
        (("evaluate", "methods", "a", "--rate", 25), "--rate is now -R rate=25"),
        (("evaluate", "segments", "a", "--gain-percent", 2), "--gain-percent is now --errors gain_percent=2"),
    ],
)
def test_an_option_that_is_given_by_name_now_is_answered_so(words: tuple[object, ...], form: str) -> None:
    assert_one_line(run(*words), form)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("-R", "zero"), "'zero' is not NAME=VALUE"),
        (("-R", "dateformat=dmy"), "there is no 'dateformat'; did you mean 'date_format'?"),
        (("-R", "xyzzy=1"), "known are format, rate"),
        (("-R", "date_format=dym"), "date_format cannot be 'dym'; possible: dmy, mdy, ymd"),
        (("-R", "zero=1.5"), "zero cannot be '1.5'"),
        (("-R", "rate=25", "--rate", 50), "rate is given twice, with different values"),
        (("-R", "zero=1", "-R", "zero=2"), "zero is given twice, with different values"),
    ],
)
def test_values_by_name_are_checked(words: tuple[object, ...], message: str) -> None:
    assert_one_line(run("calibrate", "a.csv", *words), message)


OWN: dict[str, set[str]] = {
    "apply": {"coefficients", "any_device"},
    "six-pose": {"poses", "unchecked", "roll", "face_degrees"},
    "watch": {"kind"},
    "verify": {"values", "poses", "coefficients"},
}
"""Options that are what a command is about: they stand first, in no group."""

LIMITS_AND_TRUTHS = ("devices", "simulate", "evaluate")
"""Commands with many options of their own: limits of findings, and properties of simulated sensors."""


@pytest.mark.parametrize("names", [one for one in NAMES if one[0] not in LIMITS_AND_TRUTHS], ids=" ".join)
def test_options_stand_in_a_group_but_those_that_a_command_is_about(names: tuple[str, ...]) -> None:
    grouped = {name for group in GROUPS.values() for name in group}
    options = {one.name for one in command(names).params if isinstance(one, click.Option)}
    assert options - grouped == OWN.get(names[0], set())


def test_priors_that_a_study_learns_are_offered_in_a_study_alone() -> None:
    for names in NAMES:
        for one in command(names).params:
            if one.name == "prior":
                assert isinstance(one.type, click.Choice)
                assert ("device" in one.type.choices) == (names == ("study",))


def test_sections_hold_every_command_once() -> None:
    assert sorted(name for names in SECTIONS.values() for name in names) == sorted(COMMANDS)


def test_without_arguments_one_screen_says_what_to_type_first() -> None:
    ran = run(code=2)
    assert "accelcal calibrate recording" in ran.out and ran.out.count("\n") <= 20


def test_headings_are_bold_unless_no_colour_is_set(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    context = click.Context(command(("gravity",)), info_name="gravity", color=True)
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert "\x1b[1m" in context.get_help()
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b" not in context.get_help()
