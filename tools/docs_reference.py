"""Reference pages of the documentation site, made from the program: commands, files, changelog."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli.help import Command
from accelcal_cli.cli.main import cli as accelcal
from accelcal_cli.output.quality import quality_schema
from accelcal_cli.output.report_reading import report_schema

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
        schema = report_schema() if name == "report" else quality_schema()
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
    columns = import_module("accelcal_cli.studies.columns")
    for file, names in (("study.csv", columns.READ), ("study.parquet", columns.NAMES)):
        yield f"## `{file}`\n\n| column | meaning |\n|---|---|"
        yield from (f"| `{name}` | {_cell(columns.meaning_of(name))} |" for name in names)
        yield ""


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
