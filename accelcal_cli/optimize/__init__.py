"""One file an optimizer, found by listing this folder."""

from __future__ import annotations

from functools import cache

from accelcal_cli.core.plugins import bound, named, only
from accelcal_cli.core.points import Optimizer


@cache
def all_optimizers() -> tuple[Optimizer, ...]:
    """All of them, by name."""
    return tuple(bound(__name__, __path__, "OPTIMIZER"))


def named_optimizer(name: str) -> Optimizer:
    """Look one up by name, importing no other; raises UsageError where there is none."""
    listed = only(__name__, __path__, "OPTIMIZER", name)
    return listed or named(name, all_optimizers(), "optimizer")
