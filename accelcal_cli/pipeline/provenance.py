"""Who made a result, when, with what: the one part of a report that may differ between runs."""

from __future__ import annotations

import contextlib
import platform
import sys
from datetime import UTC, datetime
from functools import cache
from typing import Any

from accelcal_cli.core.names import printable

PACKAGES = ("numpy", "pyarrow", "h5py", "click")


def provenance(command: list[str]) -> dict[str, Any]:
    """The `provenance` object of a report."""
    return {
        "command": [printable(word) for word in command],
        "versions": dict(_versions()),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "host": platform.node(),
        "platform": f"{sys.platform} {platform.machine()}",
    }


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    from importlib.metadata import PackageNotFoundError, version  # only who writes a report needs it

    found = [("python", platform.python_version())]
    for name in PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            found.append((name, version(name)))
    return tuple(found)
