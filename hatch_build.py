"""The version of a build: that of the release, or with the commit that it was built from.

Hatchling takes the version from here, and puts it into the package, where every report states it. An sdist
carries it along, so that a wheel built of it without git has the same.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from pathlib import Path
from typing import Any

try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # `python hatch_build.py` needs no more than git
    BuildHookInterface = object

ROOT = Path(__file__).resolve().parent
MADE = "accelcal_cli/core/_build.txt"


def version() -> str:
    """Return `1.0.0` of a tagged commit `v1.0.0`, else such as `1.0.0.dev5+g9e2152a`."""
    if (ROOT / MADE).exists():
        return (ROOT / MADE).read_text("ascii").strip()
    (stated,) = re.findall(r'^STATED = "(.*)"$', (ROOT / "accelcal_cli/core/version.py").read_text(), re.M)
    top, commit = git("rev-parse", "--show-toplevel"), git("rev-parse", "--short=7", "HEAD")
    if not commit or Path(top).resolve() != ROOT:
        return str(stated)
    changed = git("status", "--porcelain", "--untracked-files=no")
    if f"v{stated}" in git("tag", "--points-at", "HEAD").split() and not changed:
        return str(stated)
    last = git("describe", "--tags", "--abbrev=0", "--match", "v*")
    number = git("rev-list", "--count", f"{last}..HEAD" if last else "HEAD")
    return f"{stated.removesuffix('.dev0')}.dev{number or 0}+g{commit}{'.dirty' if changed else ''}"


def git(*words: str) -> str:
    """Return what git prints; nothing where there is no git, or no repository."""
    try:
        done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return done.stdout.strip()


class CustomBuildHook(BuildHookInterface):
    """Puts the version into what is built; an editable install reads that of its checkout."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the file."""
        if version == "editable":
            return
        if (ROOT / MADE).exists():
            build_data["force_include"][str(ROOT / MADE)] = MADE
            return
        self._folder = tempfile.TemporaryDirectory()
        made = Path(self._folder.name) / "_build.txt"
        made.write_text(self.metadata.version + "\n", "ascii")
        build_data["force_include"][str(made)] = MADE

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the file again."""
        if hasattr(self, "_folder"):
            self._folder.cleanup()


if __name__ == "__main__":
    print(version())
