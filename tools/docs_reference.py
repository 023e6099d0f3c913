"""Reference pages of the documentation site, made from the program: commands, files, changelog."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from importlib import import_module, resources
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli.help import Command
from accelcal_cli.cli.main import cli as accelcal

ROOT = Path(__file__).resolve().parent.parent
Node = Mapping[str, Any]


def write(folder: Path) -> None:
    """Write all reference pages; files that stay the same are not touched."""
    folder.mkdir(exist_ok=True)
    pages = {
        "commands.md": "\n".join(commands()),
        "files.md": "\n".join(files()),
        "python.md": PYTHON,
        "changelog.md": outside_shown((ROOT / "CHANGELOG.md").read_text("utf-8").replace("](docs/", "](../")),
    }
    for name, text in pages.items():
        page = folder / name
        if not page.exists() or page.read_text("utf-8") != text:
            page.write_text(text, "utf-8")
    notebook = ROOT / "examples/first_look.ipynb"
    text = notebook.read_text("utf-8").replace("](../docs/", "](../")
    (folder / notebook.name).write_text(text, "utf-8")


OUTSIDE = re.compile(r"\[([^\]]*)\]\((?!https?:|#|\.\./[a-z0-9-]+\.md)([^)]*)\)")
"""A link of the changelog to a file of the repository that is not a page of the site."""


def outside_shown(text: str) -> str:
    """Replace links to files that the site does not have by their texts."""
    return OUTSIDE.sub(r"\1", text)


PYTHON = """# Python functions

What each function does and when to use it is described in [From Python](../python.md).

```{eval-rst}
.. automodule:: accelcal
   :members:
   :imported-members:
```
"""


def commands() -> Iterator[str]:
    """Yield the page of all commands."""
    yield "# Commands\n\nEvery command with its options, as `accelcal COMMAND --help-all` shows them.\n"
    context = click.Context(accelcal, info_name="accelcal")
    for name in accelcal.list_commands(context):
        command = accelcal.get_command(context, name)
        if command is not None and not command.hidden:
            yield from _command(command, click.Context(command, info_name=name, parent=context))


def _command(command: click.Command, context: click.Context) -> Iterator[str]:
    yield f"## {context.command_path}\n"
    yield f"{_text(command.help)}\n"
    usage = " ".join(command.collect_usage_pieces(context))
    yield f"```text\n{context.command_path} {usage}\n```\n"
    examples = getattr(command, "examples", ())
    if examples:
        yield "```bash"
        for example in examples:
            line, _, what = example.partition(" # ")
            yield from (*((f"# {what}",) if what else ()), f"accelcal {line}")
        yield "```\n"
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            part = command.get_command(context, name)
            if part is not None:
                yield from _command(part, click.Context(part, info_name=name, parent=context))
        return
    assert isinstance(command, Command)
    for title, rows in command.sections(context, everything=True):
        yield f"**{title}**\n\n| option | meaning |\n|---|---|"
        yield from (f"| `{option}` | {_cell(text)} |" for option, text in rows)
        yield ""


def _text(text: str | None) -> str:
    """Return help as Markdown: paragraphs without the line breaks of a terminal."""
    paragraphs = (text or "").replace("\b", "").split("\n\n")
    return "\n\n".join(_cell(" ".join(one.split())) for one in paragraphs)


def _cell(text: str) -> str:
    """Return text for a cell of a table; in code only the bar has a meaning there."""
    parts = text.split("`")
    for at in range(len(parts)):
        parts[at] = re.sub(r"(\|)" if at % 2 else r"([|*_<\[])", r"\\\1", parts[at])
    return "`".join(parts)


def files() -> Iterator[str]:
    """Yield the page of the keys of the JSON files and the columns of the study's table."""
    yield (
        "# Keys and columns\n\nEvery key of the files that accelcal writes. "
        "[What accelcal writes](../outputs.md) explains them in context.\n"
    )
    for title, name in (("NAME.calibration.json", "report"), ("NAME.quality.json", "quality")):
        schema = json.loads(
            resources.files("accelcal_cli.output").joinpath(f"{name}.schema.json").read_text("utf-8")
        )
        yield f"## `{title}`\n\n{_cell(schema.get('description', ''))}\n"
        for key, node in schema["properties"].items():
            yield f"### `{key}` ({name})\n\n{_sentence(node)}\n"
            rows = list(_rows(node, key))
            if rows:
                yield "| key | type | meaning |\n|---|---|---|"
                yield from rows
                yield ""
    yield from _study()


def _study() -> Iterator[str]:
    summary = import_module("accelcal_cli.studies.summary")
    yield "## `study.csv` and `study.parquet`\n\n| column | meaning |\n|---|---|"
    yield from (f"| `{column}` | {_cell(meaning_of(column))} |" for column in summary.COLUMNS)


def meaning_of(column: str) -> str:
    """Return the meaning of a column of a study's table; raises KeyError for one that is not described."""
    if column.startswith("se_"):
        return f"standard error of {column[3:]}"
    if found := re.fullmatch(r"(k_[xyz]{2}|offset_[xyz]_g|slope_[xyz]_g_per_c)", column):
        kinds = {"k": "entry of the gain matrix", "o": "offset [g]"}
        kinds["s"] = "slope of the offset [g per degree C]"
        return kinds[found[1][0]]
    if found := re.fullmatch(r"(min|max)_([xyz])_g", column):
        return f"{'lowest' if found[1] == 'min' else 'highest'} point on {found[2]} [g]"
    if found := re.fullmatch(r"(enmo|mad|mvpa)_(low|high)_(mg|min)", column):
        return f"{found[2]}er end of the 95 % interval of {found[1].upper()}"
    return COLUMNS[column]


COLUMNS = {
    "path": "the recording, relative to the study's folder",
    "use": "yes, with care, or no",
    "why": "why not, or why with care",
    "calibration_error_mg": "calibration error over all orientations [mg]",
    "calibration_error_low_mg": "lower end of its 95 % interval",
    "calibration_error_high_mg": "upper end of its 95 % interval",
    "calibration_error_worst_mg": "the same error in the worst direction",
    "calibration_error_before_mg": "error over all orientations before calibration [mg]",
    "wear_hours": "hours in which the device was worn",
    "filled_percent": "share of samples that the device filled without measuring [%]",
    "device_serial": "serial number of the device",
    "device_model": "model of the device",
    "device_firmware": "version of its firmware",
    "start_time": "time of the first sample by the device clock",
    "decided_by": "the person who decided on its use",
    "decided_at": "when that was decided",
    "note": "remark of that person",
    "result": "name of the result, by which a decision knows it",
    "sensor": "the value of `--sensor`, if the file holds several recordings",
    "outcome": "calibrated, provisional, reduced_model, already_good, borrowed, refused or failed",
    "exit_code": "exit code that `calibrate` would have",
    "reason": "code of the reason for the outcome",
    "cautions": "codes of all cautions",
    "message": "the reason in sentences",
    "model": "model that was fitted",
    "copy_of": "the recording with the same bytes that counts",
    "borrowed_from": "the recording whose coefficients are used",
    "pool": "report of the pool",
    "pool_recordings": "number of recordings in the pool",
    "windows_before_mg": "error of its own still windows before the pool's coefficients [mg]",
    "windows_after_mg": "the same after them [mg]",
    "own_outcome": "outcome of its own calibration, where another one took its place",
    "own_message": "reason of its own calibration",
    "own_after_mg": "held-out error of its own calibration [mg]",
    "prior": "prior that was used",
    "before_mg": "|r - 1| of held-out orientations before calibration [mg]",
    "after_mg": "the same after calibration [mg]",
    "ci95_low_mg": "lower end of the 95 % interval of after_mg",
    "ci95_high_mg": "upper end of the 95 % interval of after_mg",
    "improvement_percent": "error before in percent of the error after, so that 100 means no change",
    "improvement_factor": "how many times smaller the held-out error became",
    "improvement_factor_low": "lower end of its 95 % interval",
    "improvement_factor_high": "upper end of its 95 % interval",
    "postures": "number of orientations that were held out",
    "points": "number of points that were held out",
    "change": "change of the sensor during the recording",
    "change_at": "when it changed",
    "change_mg": "size of the change [mg]",
    "misfits": "sensor errors outside the model that were found",
    "gyroscope": "outcome of the gyroscope's calibration",
    "gyro_before_deg": "error of gravity's direction after held-out turns, raw [degrees]",
    "gyro_after_deg": "the same, calibrated [degrees]",
    "gyro_pairs": "number of turns",
    "enmo_raw_mg": "mean ENMO of the raw values [mg]",
    "enmo_mg": "mean ENMO of the calibrated values [mg]",
    "enmo_differs_mg": "mean difference of ENMO by epoch [mg]",
    "mad_mg": "mean MAD, calibrated [mg]",
    "mvpa_raw_min": "minutes of moderate to vigorous activity, raw",
    "mvpa_min": "the same, calibrated",
    "inactive_raw_min": "minutes of inactivity, raw",
    "inactive_min": "the same, calibrated",
    "format": "format of the file",
    "time_zone": "what `time` in the Parquet file is in: UTC or unknown",
    "duration_s": "length [s]",
    "rate_hz": "sampling rate [Hz]",
    "rate_hz_measured": "sampling rate by the time stamps [Hz]",
    "lsb_per_g": "counts per g",
    "range_g": "range of the sensor [g]",
    "samples": "number of samples",
    "gaps": "number of gaps",
    "filled_samples": "samples that the device filled",
    "clipped_samples_before": "raw samples at the end of the range",
    "clipped_samples_after": "calibrated samples beyond the range",
    "problems": "number of problems found in the file",
    "cells": "number of points of the fit",
    "condition_number": "condition number of the fit",
    "reference_c": "temperature at which the offsets hold [degrees C]",
    "lost_percent": "share of the file that is damaged or missing [%]",
    "bytes": "size of the file",
    "sha256": "SHA-256 of the file",
    "accelcal_version": "version that made the result",
    "parquet": "file of the calibrated values",
    "report": "file of the report",
}
"""Meanings of the columns of a study's table that follow no pattern."""


def _sentence(node: Node) -> str:
    return f"{_kind(node)}. {_cell(node.get('description', ''))}".strip()


def _rows(node: Node, path: str) -> Iterator[str]:
    for key, child in _children(node):
        where = f"{path}{key}"
        yield f"| `{where}` | {_kind(child)} | {_cell(child.get('description', ''))} |"
        yield from _rows(child, where)


def _children(node: Node) -> Iterator[tuple[str, Node]]:
    for key, child in node.get("properties", {}).items():
        yield f".{key}", child
    items = node.get("items")
    if isinstance(items, Mapping):
        yield from ((f"[]{key}", child) for key, child in _children(items))
    for branch in (*node.get("anyOf", ()), *node.get("oneOf", ())):
        yield from _children(branch)


def _kind(node: Node) -> str:
    """Name the type of a node."""
    if "const" in node:
        return f"`{json.dumps(node['const'])}`"
    if "enum" in node:
        return " or ".join(f"`{one}`" for one in node["enum"])
    kinds = node.get("type", [])
    if isinstance(kinds, str):
        if kinds == "array" and isinstance(node.get("items"), Mapping):
            return f"array of {_kind(node['items'])}"
        return kinds
    if kinds:
        return " or ".join(kinds)
    return " or ".join(dict.fromkeys(_kind(one) for one in (*node.get("anyOf", ()), *node.get("oneOf", ()))))
