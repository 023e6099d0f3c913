"""One file for each optimizer, found by listing this folder."""

from __future__ import annotations

from functools import cache

from accelcal_cli.core.plugins import find_plugin, find_plugins, named_plugin
from accelcal_cli.core.points import Optimizer


@cache
def all_optimizers() -> tuple[Optimizer, ...]:
    """All of them, by name."""
    return tuple(find_plugins(__name__, __path__, "OPTIMIZER"))


def named_optimizer(name: str) -> Optimizer:
    """Look one up by name, importing no other; raises UsageError if there is none."""
    listed = find_plugin(__name__, __path__, "OPTIMIZER", name)
    return listed or named_plugin(name, all_optimizers(), "optimizer")
