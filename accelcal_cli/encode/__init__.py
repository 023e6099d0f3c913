"""One file a recording writer, found by listing this folder. Used by `accelcal simulate`."""

from __future__ import annotations

from functools import cache

from accelcal_cli.core.encoding import Encoder
from accelcal_cli.core.plugins import bound, named


@cache
def all_encoders() -> tuple[Encoder, ...]:
    """All of them, by name."""
    return tuple(bound(__name__, __path__, "ENCODER"))


def named_encoder(name: str) -> Encoder:
    """Look one up by name; raises UsageError where there is none."""
    return named(name, all_encoders(), "format to write")
