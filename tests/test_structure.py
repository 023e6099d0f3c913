"""The layers of the package: imports point downward, no circles, formats keep their inside to themselves."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parent.parent / "accelcal_cli"
LAYER = {
    "core": 0, "parquet": 1, "formats": 2, "segment": 2, "collect": 2, "optimize": 2, "judge": 2,
    "output": 2, "pipeline": 3, "six_pose": 4, "watching": 4, "simulate": 4, "activity_effect": 5,
    "exports": 4, "studies": 4, "verify": 5, "devices": 5, "pages": 6, "cli": 8, "laboratory": 9,
    "run_log": 5, "__main__": 9, "": 9,
}  # fmt: skip
"""Each top-level package or module, lowest first (docs/architecture.md); "" is the package's own face."""

FACE = PACKAGE.parent / "accelcal"
"""The package from Python, above all layers but the commands."""

MODULES = sorted(PACKAGE.rglob("*.py"))
LONGEST = 1200
SHORTEST = 40
SHORT = {
    "__main__.py": "`python -m accelcal_cli`",
    "cli/evaluate.py": "one file a command",
    "cli/gravity.py": "one file a command",
    "formats/tables/writer.py": "names the two writers where all formats have theirs",
    "studies/preload.py": "imported for its imports, by the server that worker processes are forked from",
}
"""Files of fewer lines than SHORTEST, and why each stands alone; `__init__.py` and vendors need no reason."""


def module_name(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


NAMES = {module_name(path): path for path in MODULES}


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text("utf-8"))


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield all statements, those inside functions and classes as well."""
    for node in ast.iter_child_nodes(tree):
        if not isinstance(node, ast.expr):
            yield node
            yield from statements(node)


def only_for_types(node: ast.AST) -> bool:
    """Return True for `if TYPE_CHECKING:`, whose imports never run."""
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


@cache
def imported(path: Path, running: bool = False) -> tuple[str, ...]:
    """Names that a module imports, inside functions too; with `running`, without those only for types."""
    names: list[str] = []
    tree = tree_of(path)
    skipped = {
        id(inner) for node in statements(tree) if running and only_for_types(node) for inner in ast.walk(node)
    }
    for node in statements(tree):
        if id(node) in skipped:
            continue
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return tuple(names)


def modules_imported(path: Path) -> set[str]:
    """Modules of the package that a module imports, at the top or inside a function."""
    found = {name if name in NAMES else name.rpartition(".")[0] for name in imported(path, running=True)}
    return found & set(NAMES)


def layer_of(name: str) -> str:
    """The top-level package or module that a dotted name of ours belongs to."""
    part = name.split(".")[1] if "." in name else ""
    return part if part in LAYER else ""


def all_imports() -> Iterator[tuple[str, str]]:
    """Each module of the package with each name that it imports."""
    return ((module, name) for module, path in NAMES.items() for name in imported(path))


def test_imports_point_downward_and_siblings_keep_apart() -> None:
    layers = [
        (module, name, layer_of(module), layer_of(name))
        for module, name in all_imports()
        if name.split(".")[0] == "accelcal_cli"
    ]
    assert len(layers) > len(MODULES)
    assert not [
        f"{module} imports {name}"
        for module, name, own, other in layers
        if other != own and LAYER[other] >= LAYER[own]
    ]


def test_no_circle_of_imports() -> None:
    """Modules are taken away as long as one imports none of those that are left."""
    left = {name: modules_imported(path) - {name} for name, path in NAMES.items()}
    while free := [name for name, needs in left.items() if not needs & set(left)]:
        for name in free:
            del left[name]
    assert not left, f"these import each other: {sorted(left)}"


def test_a_class_name_stands_in_few_modules() -> None:
    """A name that many modules use for different things explains none of them."""
    homes: dict[str, set[str]] = {}
    for module, path in NAMES.items():
        inside_a_format = module.startswith("accelcal_cli.formats.") and module.count(".") > 2
        if not inside_a_format or module.split(".")[2].startswith("_"):
            for node in ast.walk(tree_of(path)):
                if isinstance(node, ast.ClassDef):
                    homes.setdefault(node.name.lstrip("_"), set()).add(module)
    assert {name: sorted(modules) for name, modules in homes.items() if len(modules) > 2} == {}


def reaches_inside(own: list[str], parts: list[str]) -> bool:
    """Whether a module imports another that only its format, or only the formats, may know."""
    if parts[:2] != ["accelcal_cli", "formats"] or len(parts) < 3:
        return False
    shared = own[1:2] == ["formats"] and parts[2].startswith("_")
    front_door = len(parts) == 3 and not parts[2].startswith("_")
    return not (shared or front_door or own[1:3] == parts[1:3])


def test_nobody_outside_a_format_imports_its_inside() -> None:
    assert not [
        f"{module} imports {name}"
        for module, name in all_imports()
        if reaches_inside(module.split("."), (name if name in NAMES else name.rpartition(".")[0]).split("."))
    ]


def test_nobody_outside_parquet_imports_its_inside() -> None:
    inside = [name for name in NAMES if name.startswith("accelcal_cli.parquet.")]
    assert inside
    assert not [
        f"{module} imports {name}"
        for module, name in all_imports()
        if layer_of(module) != "parquet" and name.startswith(tuple(inside))
    ]


def test_only_the_command_layer_imports_click_or_tqdm() -> None:
    users = {module for module, name in all_imports() if name.split(".")[0] in ("click", "tqdm")}
    assert {module.split(".")[1] for module in users} == {"cli", "laboratory"}


def test_what_some_systems_lack_is_behind_one_door() -> None:
    """The provenance names the system, and `multiprocessing` has its own ways."""
    door, named = PACKAGE / "core" / "system.py", PACKAGE / "pipeline" / "outputs.py"
    lacking = (
        r"sys\.platform|/proc/|(has|get)attr\((os|signal|ctypes)|os\.(fork|sched_|fdatasync|kill)|SIGALRM"
    )
    found = {path for path in MODULES if re.search(lacking, path.read_text("utf-8"))}
    assert found <= {door, named} and door in found


@pytest.mark.parametrize("folder", ["formats", "optimize", "formats/csv/vendors", "laboratory/optimizers"])
def test_plugins_do_not_import_each_other(folder: str) -> None:
    package = ".".join(("accelcal_cli", *folder.split("/")))
    for path in (PACKAGE / folder).rglob("*.py"):
        own = path.relative_to(PACKAGE / folder).with_suffix("").parts[0]
        for name in imported(path):
            if not name.startswith(f"{package}."):
                continue
            other = name.removeprefix(f"{package}.").split(".")[0]
            file = PACKAGE / folder / other
            plugin = file.is_dir() or file.with_suffix(".py").exists()
            assert other.startswith("_") or other == own or not plugin, f"{path} imports {name}"


def test_the_python_package_is_above_all_but_the_commands() -> None:
    assert not [
        f"{module} imports {name}" for module, name in all_imports() if name.split(".")[0] == "accelcal"
    ]
    used = {
        layer_of(name) for path in FACE.glob("*.py") for name in imported(path) if "accelcal_cli." in name
    }
    assert "pipeline" in used and not used & {"cli", "laboratory", ""}
    assert all(len(path.read_text("utf-8").splitlines()) <= LONGEST for path in FACE.glob("*.py"))


def test_options_from_python_are_those_of_the_settings() -> None:
    subprocess.run([sys.executable, FACE.parent / "tools/make_options.py", "--check"], check=True)


def test_a_file_is_a_subject() -> None:
    lines = {path: len(path.read_text("utf-8").splitlines()) for path in MODULES}
    assert not [path for path, number in lines.items() if number > LONGEST]
    short = {path for path, number in lines.items() if number < SHORTEST and path.name != "__init__.py"}
    short = {path for path in short if path.parent.name != "vendors"}
    assert {str(path.relative_to(PACKAGE)) for path in short} == set(SHORT), (
        "merge it, or say why it is alone; and no word of those that are no longer short"
    )


BUDGET = {
    "core": 7_185, "formats": 24_450, "formats/tables": 11_000, "segment": 800, "collect": 1_850,
    "optimize": 900, "judge": 4_080, "parquet": 1_050, "pipeline": 5_710, "output": 5_440,
    "six_pose": 1_800, "exports": 1_770, "devices": 1_445, "studies": 5_025, "pages": 2_835,
    "watching": 600, "laboratory": 4_060, "cli": 3_340,
}  # fmt: skip
"""Most lines of a folder: what goes beyond has to take something away."""

ALL_LINES, TEST_LINES = 76_125, 74_500
"""Most lines of both packages together, and of the tests."""


def lines_below(*folders: Path) -> int:
    paths = (path for folder in folders for path in folder.rglob("*.py"))
    return sum(len(path.read_text("utf-8").splitlines()) for path in paths)


def test_the_whole_keeps_its_budget() -> None:
    assert lines_below(PACKAGE, PACKAGE.parent / "accelcal") <= ALL_LINES
    assert lines_below(PACKAGE.parent / "tests") <= TEST_LINES


@pytest.mark.parametrize("folder", BUDGET)
def test_a_folder_keeps_its_budget(folder: str) -> None:
    assert lines_below(PACKAGE / folder) <= BUDGET[folder]


def test_every_layer_has_its_place() -> None:
    found = {path.stem for path in PACKAGE.iterdir() if path.is_dir() or path.suffix == ".py"}
    assert found - {"__pycache__", "__init__", "py"} <= set(LAYER)


TESTS = sorted(Path(__file__).resolve().parent.rglob("*.py"))
SHARED = {"accelcal_cli.formats", "accelcal_cli.optimize"}
"""Packages whose modules with a leading `_` are no plugins but what these share: public within."""


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


@cache
def private_names() -> set[str]:
    """Functions, classes, attributes and constants of the package that are nobody else's business."""
    names: set[str] = set()
    for path in MODULES:
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                names.add(node.name)
            elif isinstance(node, ast.Attribute | ast.Name) and isinstance(node.ctx, ast.Store):
                names.add(node.attr if isinstance(node, ast.Attribute) else node.id)
    return {name for name in names if is_private(name) and name != "_"}


def private_imports(name: str) -> bool:
    """Whether a dotted name of ours has a private part that is no module of SHARED."""
    parts = name.split(".")
    hidden = [place for place, part in enumerate(parts) if is_private(part)]
    return any(".".join(parts[:place]) not in SHARED for place in hidden)


def reaches(path: Path) -> Iterator[str]:
    """Private names of ours in a test: imported, attributes of others, or in texts that are run."""
    known = private_names()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Attribute) and node.attr in known:
            if not (isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")):
                yield node.attr
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield from (name for name in re.findall(r"\.(_\w+)", node.value) if name in known)
        elif isinstance(node, ast.Call) and len(node.args) > 1 and isinstance(node.args[1], ast.Constant):
            yield from (name for name in known & {node.args[1].value} if "attr" in ast.unparse(node.func))
    yield from (name for name in imported(path) if name.startswith("accelcal_cli") and private_imports(name))


def test_no_test_names_what_is_private() -> None:
    others = sorted({*TESTS} - {Path(__file__).resolve()})
    suspects = [path for path in others if re.search(r"\b_[a-z]", path.read_text("utf-8"), re.IGNORECASE)]
    assert {path: found for path in suspects if (found := [*reaches(path)])} == {}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("from accelcal_cli.verify import _keep_paths", ["accelcal_cli.verify._keep_paths"]),
        ("from accelcal_cli.formats._problems import ProblemLog", []),
        ("from accelcal_cli.formats._problems import _x", ["accelcal_cli.formats._problems._x"]),
        ("verify._keep_paths(a)", ["_keep_paths"]),
        ("self._keep_paths = os._exit", []),
        ("patch.setattr(verify, '_keep_paths', 1)", ["_keep_paths"]),
        ("patch.setattr('accelcal_cli.verify._keep_paths', 1)", ["_keep_paths"]),
    ],
)
def test_private_names_are_seen_wherever_they_are(tmp_path: Path, text: str, found: list[str]) -> None:
    path = tmp_path / "test_a.py"
    path.write_text(text)
    assert [*reaches(path)] == found
