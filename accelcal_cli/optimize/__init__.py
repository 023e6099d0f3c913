"""The optimizers, found by listing this folder and that of the ones for comparison, in the laboratory."""

from __future__ import annotations

from functools import cache
from importlib import import_module

from accelcal_cli.core.plugins import find_plugin, find_plugins, named_plugin
from accelcal_cli.core.points import Optimizer

FOLDERS = (__name__, "accelcal_cli.laboratory.optimizers")
"""Packages that are listed; the second is imported only when an optimizer is not found in the first."""


@cache
def all_optimizers() -> tuple[Optimizer, ...]:
    """Return all optimizers, by name."""
    found = [
        item for name in FOLDERS for item in find_plugins(name, import_module(name).__path__, "OPTIMIZER")
    ]
    return tuple(sorted(found, key=lambda item: str(item.name)))


def named_optimizer(name: str) -> Optimizer:
    """Return the optimizer of a name, importing no other for one of this folder; raises UsageError."""
    listed = find_plugin(__name__, __path__, "OPTIMIZER", name)
    return listed or named_plugin(name, all_optimizers(), "optimizer")
