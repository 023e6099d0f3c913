"""Prints the oldest version of each dependency that pyproject.toml allows, a line each, for `pip install`."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent / "pyproject.toml"


def oldest(dependencies: list[str]) -> list[str]:
    """`numpy>=2.0` gives `numpy==2.0`."""
    return [one.replace(">=", "==") for one in dependencies]


if __name__ == "__main__":
    project = tomllib.loads(PROJECT.read_text("utf-8"))["project"]
    sys.stdout.write(
        "\n".join(oldest([*project["dependencies"], *project["optional-dependencies"]["methods"]])) + "\n"
    )
