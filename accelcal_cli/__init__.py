"""Autocalibration of raw accelerometer (actigraph) recordings by the stillness they contain.

From Python, `import accelcal` (docs/python.md); its names can be had from this package, too.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from accelcal_cli.core.version import __version__ as __version__

if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """The names of `accelcal`, which this package was before it had one of its own."""
        if name in import_module("accelcal").__all__:
            return getattr(import_module("accelcal"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
