"""Batch calibration of raw actigraph recordings from the stillness they contain.

From Python: `import accelcal_cli as accelcal`; `read`, `calibrate`, `fit`, `from_poses`, `apply`,
`effect`, `study`, `sentence` (docs/python.md).
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from accelcal_cli.core.version import __version__ as __version__

if TYPE_CHECKING:
    from accelcal_cli.api import (
        AccelcalError,
        Reading,
        Reason,
        Result,
        Samples,
        apply,
        calibrate,
        effect,
        fit,
        from_poses,
        read,
        sentence,
        study,
    )

__all__ = [
    "AccelcalError", "Reading", "Reason", "Result", "Samples",
    "apply", "calibrate", "effect", "fit", "from_poses", "read", "sentence", "study",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """The names of the API, imported when one is first used: the command does not need them."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("accelcal_cli.api"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
