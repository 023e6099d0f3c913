"""One file a recording writer, found by listing this folder. Used by `accelcal simulate`."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from accelcal_cli.core.encoding import Encoder
from accelcal_cli.core.errors import UsageError


@cache
def all_encoders() -> tuple[Encoder, ...]:
    """Every recording writer, by name."""
    names = [info.name for info in pkgutil.iter_modules(__path__) if not info.name.startswith("_")]
    found = [importlib.import_module(f"{__name__}.{name}").ENCODER for name in sorted(names)]
    return tuple(sorted(found, key=lambda item: item.name))


def named_encoder(name: str) -> Encoder:
    """Look a recording writer up by name; raises UsageError where there is none."""
    for item in all_encoders():
        if item.name == name:
            return item
    known = ", ".join(item.name for item in all_encoders())
    raise UsageError(f"cannot write format {name!r}", hint=f"formats with a writer: {known}")
