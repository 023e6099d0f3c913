"""What a shell completes, and what is said of slips."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.shell_completion import BashComplete

from accelcal_cli.cli.main import COMMANDS, cli
from accelcal_cli.formats import all_encoders, all_formats
from accelcal_cli.optimize import all_optimizers
from tests.cli.run import run, run_process
from tests.recordings import good_raw


def completed(*words: str) -> list[tuple[str, str]]:
    """Kind and value of all that completes the last word."""
    *before, last = words
    shell = BashComplete(cli, {}, "accelcal", "_ACCELCAL_COMPLETE")
    return [(item.type, item.value) for item in shell.get_completions(before, last)]


def values(*words: str) -> list[str]:
    found = completed(*words)
    assert {kind for kind, _ in found} <= {"plain"}
    return [value for _, value in found]


def leaves() -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """All commands that do something, with their words."""

    def below(words: tuple[str, ...], group: click.Group) -> Iterator[tuple[tuple[str, ...], click.Command]]:
        context = click.Context(group)
        for name in group.list_commands(context):
            found = group.get_command(context, name)
            assert found is not None
            if isinstance(found, click.Group):
                yield from below((*words, name), found)
            else:
                yield (*words, name), found

    yield from below((), cli)


OPTIMIZERS = [item.name for item in all_optimizers()]
FORMATS = [item.name for item in all_formats()]


def test_commands_complete() -> None:
    assert values("") == list(COMMANDS)
    assert values("s") == [name for name in COMMANDS if name.startswith("s")]
    assert values("evaluate", "me") == ["methods"]
    assert values("--ver") == ["--version"]


def test_completing_a_command_and_the_help_of_all_import_none() -> None:
    code = (
        "import sys; from click.shell_completion import BashComplete; from accelcal_cli.cli.main import cli; "
        "assert BashComplete(cli, {}, 'accelcal', 'X').get_completions([], 'cal')[0].value == 'calibrate'; "
        "cli.main(['--help'], standalone_mode=False); "
        "assert not {'numpy', 'pyarrow', 'pandas', 'h5py', 'tqdm'} & {*sys.modules}"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("calibrate", "--format", ""), FORMATS),
        (("study", "x", "--format", "g"), ["genea", "geneactiv", "gt3x"]),
        (("simulate", "x", "--format", ""), [item.name for item in all_encoders()]),
        (("calibrate", "--optimizer", ""), OPTIMIZERS),
        (("fit", "--optimizer", "f"), ["fixed16", "fixed32", "float32", "float64"]),
        (("evaluate", "simulation", "--optimizer", "fixed32"), ["fixed32", "fixed32:paper"]),
        (("evaluate", "methods", "--only", "bfgs,el"), ["bfgs,ellipsoid"]),
        (("calibrate", "--timezone", "Europe/Ber"), ["Europe/Berlin"]),
        (("calibrate", "--timezone", "UT"), ["UTC"]),
        (("calibrate", "--model", ""), ["auto", "9", "6", "3"]),
        (("calibrate", "--stillness", ""), ["both", "range", "deviation", "adaptive"]),
        (("calibrate", "--unit", "m"), ["mg", "m/s2"]),
        (("calibrate", "--prior", "p"), ["population"]),
        (("calibrate", "-R", "date_format=d"), ["date_format=dmy"]),
        (("calibrate", "-R", "gyro_"), ["gyro_columns=", "gyro_unit="]),
        (("export", "x", "--to", "b"), ["biobank", "bids"]),
        (("study", "x", "--pool", ""), ["device"]),
        (("calibrate", "--pro"), ["--profile"]),
    ],
)
def test_values_complete(words: tuple[str, ...], expected: list[str]) -> None:
    assert values(*words) == expected


def test_files_complete_as_files_everywhere() -> None:
    """Every argument, and every option that names a file or folder."""
    files = 0
    for words, found in leaves():
        for parameter in found.params:
            if isinstance(parameter.type, click.Path):
                before = () if isinstance(parameter, click.Argument) else (parameter.opts[0],)
                assert [kind for kind, _ in completed(*words, *before, "rec")] == ["file"], (words, parameter)
                files += 1
    assert files > 30


def test_options_with_a_list_of_values_are_of_a_kind_that_completes() -> None:
    """A choice of click's own would pass over slips."""
    for words, found in leaves():
        for parameter in found.params:
            assert type(parameter.type) is not click.Choice, (words, parameter)


def test_the_lines_that_the_cookbook_names_work(monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[2] / "docs/cookbook.md").read_text("utf-8")
    for shell, needed in (
        ("bash", "complete -o"),
        ("zsh", "#compdef accelcal"),
        ("fish", "--command accelcal"),
    ):
        assert f"_ACCELCAL_COMPLETE={shell}_source accelcal" in page
        if shell != "bash" or shutil.which("bash"):
            monkeypatch.setenv("_ACCELCAL_COMPLETE", f"{shell}_source")
            ran = run_process()
            assert ran.code == 0 and needed in ran.out.replace("accelcal_cli", "accelcal"), ran


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_completes(tmp_path: Path) -> None:
    """The script that it is given, run by bash itself."""
    program = tmp_path / "accelcal"
    program.write_text(f"#!/bin/sh\nexec '{sys.executable}' -c '{START}' \"$@\"\n")
    program.chmod(0o755)
    script = (
        f'PATH="{tmp_path}:$PATH"; eval "$(_ACCELCAL_COMPLETE=bash_source accelcal)"; '
        "COMP_WORDS=(accelcal calibrate --stillness ad); COMP_CWORD=3; _accelcal_completion accelcal; "
        'echo "${COMPREPLY[@]}"'
    )
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=False)
    assert done.stdout == "adaptive\n", done


START = "from accelcal_cli.cli.main import main; main()"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("calibrat", "x"), "no such command 'calibrat'. Did you mean 'calibrate'?"),
        (("evaluate", "metods"), "Did you mean 'methods'?"),
        (("calibrate", "x", "--stilness", "both"), "--stillness"),
        (("calibrate", "x", "--stillness", "bth"), "Did you mean 'both'?"),
        (("calibrate", "x", "--unit", "G"), "Did you mean 'g'?"),
        (("export", "x", "--to", "ggri"), "Did you mean 'ggir'?"),
        (("calibrate", "{good}", "--optimizer", "fixd32"), "did you mean 'fixed32'?"),
        (("calibrate", "{good}", "--format", "RAW"), "did you mean 'raw'?"),
        (("simulate", "x", "--format", "gt3"), "did you mean 'gt3x'?"),
        (("calibrate", "{good}", "--timezone", "europe/berlim"), "did you mean 'Europe/Berlin'?"),
        (("evaluate", "methods", "{good}", "--only", "bfsg"), "did you mean 'bfgs'?"),
    ],
)
def test_slips_are_pointed_out(tmp_path: Path, words: tuple[str, ...], said: str) -> None:
    good = str(good_raw(tmp_path))
    ran = run(*(word.format(good=good) for word in words))
    assert ran.code == 2 and said in ran.err, ran
