"""Where two JSON documents differ."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

_ABSENT = object()


def differing(one: Any, other: Any, where: str = "") -> Iterator[str]:
    """Places such as `calibration.gain[1][0]` where two JSON values are not the same, bit for bit."""
    if isinstance(one, dict) and isinstance(other, dict):
        for name in [*one, *(name for name in other if name not in one)]:
            place = f"{where}.{name}" if where else str(name)
            yield from differing(one.get(name, _ABSENT), other.get(name, _ABSENT), place)
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for index, (left, right) in enumerate(zip(one, other, strict=True)):
            yield from differing(left, right, f"{where}[{index}]")
    elif one is _ABSENT or other is _ABSENT or json.dumps(one) != json.dumps(other):
        yield where
