"""One file an optimizer, found by listing this folder."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.points import Optimizer


@cache
def all_optimizers() -> tuple[Optimizer, ...]:
    """Every optimizer, by name. A module whose name starts with `_` is a helper."""
    names = [info.name for info in pkgutil.iter_modules(__path__) if not info.name.startswith("_")]
    found = [importlib.import_module(f"{__name__}.{name}").OPTIMIZER for name in sorted(names)]
    return tuple(sorted(found, key=lambda item: item.name))


def named_optimizer(name: str) -> Optimizer:
    """Look an optimizer up by name; raises UsageError where there is none."""
    for item in all_optimizers():
        if item.name == name:
            return item
    known = ", ".join(item.name for item in all_optimizers())
    raise UsageError(f"unknown optimizer {name!r}", hint=f"known optimizers: {known}")
