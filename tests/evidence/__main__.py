"""`python -m tests.evidence`: freeze what the package makes of all recordings, and compare."""

from __future__ import annotations

import argparse
import json
import sys
from fnmatch import fnmatch
from pathlib import Path

from tests.evidence import compare, every_task, freeze, rules_of


def main(words: list[str] | None = None) -> int:
    """Run a command; return 1 if two files differ."""
    parser = argparse.ArgumentParser(prog="python -m tests.evidence")
    commands = parser.add_subparsers(dest="command", required=True)
    freezing = commands.add_parser("freeze")
    freezing.add_argument("file", type=Path)
    freezing.add_argument("--jobs", type=int, default=1)
    freezing.add_argument("--only", default="*", help="glob of the tasks, such as 'tables/*'")
    comparing = commands.add_parser("compare")
    comparing.add_argument("old", type=Path)
    comparing.add_argument("new", type=Path)
    comparing.add_argument("--ignore-prose", action="store_true")
    given = parser.parse_args(words)
    if given.command == "freeze":
        tasks = {name: task for name, task in every_task().items() if fnmatch(name, given.only)}
        given.file.write_text(json.dumps(freeze(tasks, given.jobs), indent=1, sort_keys=True) + "\n")
        return 0
    old, new = (json.loads(path.read_text()) for path in (given.old, given.new))
    lines, left = compare(old, new, rules_of(), ignore_prose=given.ignore_prose)
    sys.stdout.write("\n".join(lines) + "\n")
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main())
