"""Rewrites the golden files: `python -m tests.golden`, by hand and never by a test."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.optimize import golden_case

FILES: dict[Path, Callable[[], dict[str, Any]]] = {
    golden_case.GOLDEN: golden_case.results,
}
"""Each golden file and what makes its content."""


def main() -> None:
    """Write every golden file and name it."""
    for path, make in FILES.items():
        path.write_text(as_text(make()), "utf-8")
        sys.stdout.write(f"{path}\n")


def as_text(content: dict[str, Any]) -> str:
    """JSON with each list of integers on one line, so that a change shows where it is."""
    text = json.dumps(content, indent=1)
    return re.sub(r"\[[-\d,\s]+\]", lambda found: "".join(found[0].split()).replace(",", ", "), text) + "\n"


if __name__ == "__main__":
    main()
