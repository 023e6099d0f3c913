"""Prints the exact versions that are installed here of all that the project needs, for requirements.lock."""

from __future__ import annotations

import sys
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROJECT = Path(__file__).resolve().parent.parent / "pyproject.toml"


def wanted() -> list[Requirement]:
    """Requirements of the project and of all its extras."""
    project = tomllib.loads(PROJECT.read_text("utf-8"))["project"]
    extras = project["optional-dependencies"].values()
    return [Requirement(one) for group in (project["dependencies"], *extras) for one in group]


def installed(requirements: list[Requirement]) -> dict[str, str]:
    """Versions by name, with those that they need in turn; what is not installed has none."""
    found: dict[str, str] = {}
    waiting = [(one, ("",)) for one in requirements]
    while waiting:
        one, extras = waiting.pop()
        name = canonicalize_name(one.name)
        needed = one.marker is None or any(one.marker.evaluate({"extra": extra}) for extra in extras)
        if not needed or (name in found and not one.extras):
            continue
        try:
            there = distribution(name)
        except PackageNotFoundError:
            continue
        found[name] = there.version
        waiting += [(Requirement(text), ("", *one.extras)) for text in there.requires or ()]
    return found


if __name__ == "__main__":
    head = "# exact versions with which `make test` passed (Python {}.{}); written by `make lock`\n"
    lines = [f"{name}=={version}\n" for name, version in sorted(installed(wanted()).items())]
    sys.stdout.write(head.format(*sys.version_info) + "".join(lines))
