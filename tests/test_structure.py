"""The house: imports point downward, siblings keep apart, only the command layer knows click."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parent.parent / "accelcal_cli"
FLOOR = {
    "": 0,
    "core": 0,
    "readers": 1,
    "encode": 1,
    "segment": 1,
    "collect": 1,
    "optimize": 1,
    "judge": 1,
    "poses": 1,
    "simulate": 1,
    "output": 1,
    "pipeline": 2,
    "evaluate": 3,
    "study": 3,
    "fleet": 4,
    "cli": 5,
    "__main__": 6,
}
MODULES = sorted(PACKAGE.rglob("*.py"))


def room(parts: tuple[str, ...]) -> str:
    return parts[0] if parts else ""


def imported(path: Path) -> list[str]:
    tree = ast.parse(path.read_text("utf-8"))
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_downward_and_siblings_keep_apart(path: Path) -> None:
    own = room(path.relative_to(PACKAGE).with_suffix("").parts)
    own = "" if own == "__init__" else own
    for name in imported(path):
        if not name.startswith("accelcal_cli."):
            continue
        other = room(tuple(name.split(".")[1:]))
        other = "" if other == "__version__" else other
        assert other == own or FLOOR[other] < FLOOR[own], f"{path} imports {name}"


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_only_the_command_layer_imports_click_or_tqdm(path: Path) -> None:
    heavy = {name.split(".")[0] for name in imported(path)} & {"click", "tqdm"}
    assert not heavy or path.is_relative_to(PACKAGE / "cli")


@pytest.mark.parametrize("folder", ["readers", "encode", "optimize"])
def test_plugins_do_not_import_each_other(folder: str) -> None:
    for path in (PACKAGE / folder).glob("*.py"):
        for name in imported(path):
            if not name.startswith(f"accelcal_cli.{folder}."):
                continue
            other = name.split(".")[2]
            assert other.startswith("_"), f"{path} imports {name}"


def test_every_room_has_its_place() -> None:
    rooms = {path.name for path in PACKAGE.iterdir() if path.is_dir() and path.name != "__pycache__"}
    assert rooms <= set(FLOOR)
