"""Discovery of plug-ins: formats, writers and optimizers are objects that the modules of a folder bind."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable
from functools import cache
from types import ModuleType
from typing import Any, Protocol, TypeVar

from accelcal_cli.core.errors import UsageError, did_you_mean, printable


class Named(Protocol):
    """Anything with a name."""

    @property
    def name(self) -> str:
        """Name as in the options of the command."""


def find_plugins(package: str, folder: Iterable[str], attribute: str) -> list[Any]:
    """Return `attribute` of every module of a package, sorted by the items' names; `_` modules are helpers.

    A module binds one item, or a tuple of them.
    """
    names = [name for name in _modules(tuple(folder)) if not name.startswith("_")]
    found = [
        item for name in names for item in items_of(importlib.import_module(f"{package}.{name}"), attribute)
    ]
    return sorted(found, key=lambda item: str(item.name))


@cache
def _modules(folder: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the modules in a package's folder, listed once."""
    return tuple(info.name for info in pkgutil.iter_modules(folder))


def items_of(module: ModuleType, attribute: str) -> tuple[Any, ...]:
    """Return what a module binds: one item, or a tuple of them."""
    bound_here = getattr(module, attribute)
    return bound_here if isinstance(bound_here, tuple) else (bound_here,)


def find_plugin(package: str, folder: Iterable[str], attribute: str, name: str) -> Any:
    """Return `attribute` of the module called like the item, with `_` for hyphens; None without one."""
    module = name.replace("-", "_")
    if module.startswith("_") or module not in _modules(tuple(folder)):
        return None
    items = items_of(importlib.import_module(f"{package}.{module}"), attribute)
    return next((item for item in items if item.name == name), None)


T = TypeVar("T", bound=Named)


def named_plugin(name: str, items: tuple[T, ...], what: str) -> T:
    """Return the item of a name; raises UsageError with the known names if there is none."""
    for item in items:
        if item.name == name:
            return item
    known = [item.name for item in items]
    meant = did_you_mean(name, known)
    raise UsageError(
        f"unknown {what} {printable(name)!r}", hint=f"{meant and meant + ' '}use one of {', '.join(known)}"
    )
