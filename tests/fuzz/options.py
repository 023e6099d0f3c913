"""Odd words for the options and arguments of every command."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any
from unittest.mock import patch

import click

from accelcal_cli.cli.help import NameValue
from accelcal_cli.cli.main import cli
from tests.fuzz import command
from tests.fuzz.made import directions, recording

WORDS = (
    *(
        "",
        "0",
        "-1",
        "nan",
        "inf",
        "-inf",
        "1e-320",
        "1e308",
        "1e400",
        "9" * 30,
        "x",
        "\x1b[31m",
        "\u0663",
        "1,2",
    ),
    *("1,2,3", "a,b,c", "None", "True", "good.csv", "nothere", "/dev/null", ".", "..", "-", "--", "\xe9"),
    *("\udcff", "a/b/c", "1e9", "0.5", "25", "100", "Europe/Berlin", "+14:00", "2024-01-01", "2024-13-01"),
    *(
        "1/0",
        "0/1",
        "1/1",
        "1/2",
        "slurm",
        "*",
        "[",
        "auto",
        "9",
        "default",
        "paper",
        "out.csv",
        "-o",
        "\u202e",
    ),
)
GIVEN = {
    "recordings": ("good.csv",),
    "recording": ("good.csv",),
    "report": ("known.json",),
    "points": ("points.csv", "good.csv"),
    "out": ("out", "out.csv"),
    "folders": (".",),
    "coefficients": ("known.json",),
    "output_dir": ("out",),
}
"""What makes sense, for some of the options and arguments."""

LEFT_OUT = ("dask", "executor", "jobs", "days", "timeout", "settle", "cases")
"""Options that reach other machines, or make a run as long as they say."""

SHORT = {
    "simulate": ["--days", "0.003"],
    "study": ["-j", "1"],
    "evaluate simulation": ["--cases", "2"],
    "evaluate gravity": ["--cases", "2"],
}
SLOW, SLOW_SHARE = "evaluate", 0.1
"""What is tried less often."""


def commands(
    command: click.Command = cli, names: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    if not isinstance(command, click.Group):
        yield names, command
        return
    context = click.Context(command)
    for name in command.list_commands(context):
        one = command.get_command(context, name)
        assert one is not None
        yield from commands(one, (*names, name))


def line(names: tuple[str, ...], one: click.Command, random: Random) -> list[str]:
    words = list(names)
    for item in one.params:
        odd = random.choice(WORDS)
        value = random.choice(GIVEN.get(str(item.name), (odd,))) if random.random() < 0.9 else odd
        if isinstance(item, click.Argument):
            words += [value] * (random.random() < 0.98)
        elif item.name not in LEFT_OUT and random.random() < (
            0.95 if item.required else 1.5 / len(one.params)
        ):
            words += option(item, value, random)
    return [*words, *SHORT.get(" ".join(names), [])]


def option(item: click.Parameter, value: str, random: Random) -> list[str]:
    name = random.choice(item.opts)
    if getattr(item, "is_flag", False):
        return [name]
    if isinstance(item.type, click.Choice) and random.random() < 0.6:
        value = random.choice([str(choice) for choice in item.type.choices])
    if isinstance(item.type, NameValue) and random.random() < 0.9:
        value = f"{random.choice(list(item.type.known()))}={value}"
    return [name, *[value] * item.nargs]


def options(folder: Path) -> Any:
    kept, here = folder / "kept", folder / "here"
    kept.mkdir(exist_ok=True)
    recording(kept / "good.csv")
    rows = "\n".join(",".join(f"{value:.6f}" for value in row) for row in directions(50).tolist())
    (kept / "points.csv").write_text(f"x,y,z\n{rows}\n")
    command.run(["calibrate", kept / "good.csv", "-d", folder, "--report-only"])
    shutil.move(folder / "good.calibration.json", kept / "known.json")
    held = {path.name: path.read_bytes() for path in kept.iterdir()}
    known = sorted(commands(), key=lambda item: item[0])
    share = [SLOW_SHARE if names[0] == SLOW else 1 for names, _ in known]

    def attempt(random: Random, number: int, folder: Path, tally: Any) -> tuple[bytes, str, str | None]:
        names, one = random.choices(known, share)[0]
        words = line(names, one, random)
        shutil.rmtree(here, ignore_errors=True)
        shutil.copytree(kept, here)
        with contextlib.chdir(here), Path(os.devnull).open() as nothing, patch.object(sys, "stdin", nothing):
            ran = command.run(words)
        tally.refused += ran.code != 0
        data = repr(words).encode()
        (folder / "mutant.txt").write_bytes(data)
        return data, repr(words), command.wrong(ran) or hurt(here, held)

    return attempt


def hurt(here: Path, held: dict[str, bytes]) -> str | None:
    for name, data in held.items():
        path = here / name
        if not path.is_file() or path.read_bytes() != data:
            return f"INPUT CHANGED: {name}"
    left = [path.name for path in here.rglob("*") if path.name.startswith(".") or path.suffix == ".tmp"]
    return f"LEFT BEHIND: {left[0]}" if left else None
