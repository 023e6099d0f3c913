"""The version of the package, which the build reads from here and every report states."""

from __future__ import annotations

import os

STATED = "1.0.0.dev0"
"""The release, or the one that is being developed."""


def build_version() -> str:
    """Return the version with the commit that it was built from, such as `1.0.0.dev5+g9e2152a`.

    A build holds it (hatch_build.py). A checkout has that of its commit, read from its files; an archive of
    the files alone has no more than what is stated here.
    """
    here = os.path.dirname(os.path.abspath(__file__))  # noqa: PTH100, PTH120 (every start imports this)
    made = _line(os.path.join(here, "_build.txt"))  # noqa: PTH118
    if made is not None:
        return made
    commit = _commit(os.path.join(os.path.dirname(os.path.dirname(here)), ".git"))  # noqa: PTH118, PTH120
    return STATED if commit is None else f"{STATED.removesuffix('.dev0')}.dev0+g{commit[:7]}"


def _commit(git: str) -> str | None:
    """Return the commit of a checkout, by the files of its repository; None if there is none."""
    if (pointer := _line(git)) is not None:  # a further work tree
        git = os.path.join(os.path.dirname(git), pointer.removeprefix("gitdir: "))  # noqa: PTH118, PTH120
    head = _line(os.path.join(git, "HEAD"))  # noqa: PTH118
    if head is None or not head.startswith("ref: "):
        return head
    name = head.removeprefix("ref: ")
    common = os.path.join(git, _line(os.path.join(git, "commondir")) or "")  # noqa: PTH118
    return _line(os.path.join(common, name)) or _packed(os.path.join(common, "packed-refs"), name)  # noqa: PTH118


def _packed(path: str, name: str) -> str | None:
    try:
        with open(path, encoding="utf-8") as file:  # noqa: PTH123
            return next((line.split()[0] for line in file if line.rstrip().endswith(f" {name}")), None)
    except (OSError, ValueError):
        return None


def _line(path: str) -> str | None:
    """Return the first line of a file, None if it cannot be read."""
    try:
        with open(path, encoding="utf-8") as file:  # noqa: PTH123
            return file.readline().strip() or None
    except (OSError, ValueError):
        return None


__version__ = build_version()
"""Version of this build: results of one version are the same, and every output states it."""
