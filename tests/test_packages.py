"""What the citation, the conda recipe and the container file repeat is as in pyproject.toml."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import hatch_build
from accelcal_cli.core.version import STATED
from tools.oldest import oldest

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
CITATION = (ROOT / "CITATION.cff").read_text("utf-8")
RECIPE = (ROOT / "recipe/recipe.yaml").read_text("utf-8")
CONTAINER = (ROOT / "Containerfile").read_text("utf-8")


def items(text: str, key: str) -> list[str]:
    """The list below a key of YAML, however deep."""
    found = re.search(rf"^( *){key}:\n((?:\1 +-.*\n)+|(?:\1-.*\n)+)", text, re.MULTILINE)
    assert found is not None, key
    return [line.strip().removeprefix("- ") for line in found[2].splitlines()]


def as_conda(requirement: str) -> str:
    """`numpy>=2.0` as `numpy >=2.0`."""
    return re.sub("(?=>=)", " ", requirement, count=1)


def test_versions_are_that_of_the_package() -> None:
    assert re.findall(r"^version: (.*)$", CITATION, re.MULTILINE) == [STATED]
    assert '\n  version: ${{ env.get("VERSION") }}\n' in RECIPE  # of the project, with its commit
    assert RECIPE.splitlines()[1].startswith("# VERSION=$(python hatch_build.py) rattler-build ")
    assert (
        f'echo "$PKG_VERSION" > {hatch_build.MADE}' in RECIPE and f"> /source/{hatch_build.MADE}" in CONTAINER
    )


def test_the_recipe_needs_what_the_project_needs() -> None:
    about = PROJECT["project"]
    python = f"python {about['requires-python']}"
    assert items(RECIPE, "run") == [python, *map(as_conda, about["dependencies"])]
    (backend,) = PROJECT["build-system"]["requires"]
    assert items(RECIPE, "host") == [python, "pip", as_conda(backend)]
    ((name, function),) = about["scripts"].items()
    assert items(RECIPE, "entry_points") == [f"{name} = {function}"]
    assert f"license: {about['license']}" in RECIPE and (ROOT / "LICENSE").exists()


def test_the_citation_describes_the_project() -> None:
    about = PROJECT["project"]
    assert about["description"] + "." in CITATION
    assert items(CITATION, "keywords") == about["keywords"]
    assert f"\nlicense: {about['license']}\n" in CITATION
    assert re.search(r'^title: "accelcal: ', CITATION, re.MULTILINE)
    assert "\ncff-version: 1.2.0\n" in f"\n{CITATION}"


def test_the_container_has_a_python_that_is_supported_and_no_root() -> None:
    image = r"ARG PYTHON=docker\.io/library/python@sha256:[0-9a-f]{64}"
    based = rf"^# python:(\d+\.\d+)\.\d+-slim-\w+; .*:\1-slim\n{image}$"
    (version,) = re.findall(based, CONTAINER, re.MULTILINE)
    assert f"Programming Language :: Python :: {version}" in PROJECT["project"]["classifiers"]
    assert re.search(r"^USER [1-9]\d*:[1-9]\d*$", CONTAINER, re.MULTILINE)
    kept = (ROOT / ".dockerignore").read_text("utf-8").split()
    for line in re.findall(r"^COPY (?!--from)(.*) \S+$", CONTAINER, re.MULTILINE):
        for source in line.split():
            assert (ROOT / source).exists() and f"!{source}" in kept


def test_each_dependency_names_its_oldest_version() -> None:
    """`make oldest` installs these."""
    about = PROJECT["project"]
    needed = [*about["dependencies"], *about["optional-dependencies"]["methods"]]
    pinned = oldest(needed)
    assert len(pinned) == len(needed)
    assert all(re.fullmatch(r"[a-z0-9]+==\d+(\.\d+)*", one) for one in pinned), pinned
