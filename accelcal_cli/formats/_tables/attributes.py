"""What is stated beside the columns of a table, by names compared without case and punctuation."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from accelcal_cli.core.vocabulary import normalized


def readable(text: str) -> str:
    """A name or text of a file; bytes that are not UTF-8, which h5py passes on, are replaced."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def plain_value(value: object) -> str | float | None:
    """An attribute as text or number; None if it is neither, empty or a list."""
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size == 1 else None
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if isinstance(value, str):
        return readable(value).replace("\0", " ").strip() or None
    if isinstance(value, bool | int | float | np.number | np.bool_) and not np.iscomplexobj(value):
        return float(value)
    return None


class Attributes:
    """What is stated of a column, of the groups around it and of the file: the nearest wins.

    Names are compared without case and punctuation. What cannot be read counts as absent and its name is
    kept in `damaged`.

    Args:
        layers: values by their names, the nearest first.
    """

    def __init__(self, layers: Sequence[Mapping[str, object]] = ()) -> None:
        self.damaged: list[str] = []
        self._layers = [{normalized(name): value for name, value in layer.items()} for layer in layers]

    def value(self, *names: str) -> str | float | None:
        """The first one of these names that says something."""
        for depth in range(len(self._layers)):
            for name in names:
                if (found := self.read(depth, normalized(name))) is not None:
                    return found
        return None

    def read(self, depth: int, name: str) -> str | float | None:
        """What a layer says under a name as `normalized` returns it, None if nothing."""
        return plain_value(self._layers[depth].get(name))

    def text(self, *names: str) -> str | None:
        """As text; a whole number is written without a decimal point."""
        value = self.value(*names)
        if isinstance(value, float):
            return f"{value:.0f}" if value.is_integer() else str(value)
        return value

    def number(self, *names: str) -> float | None:
        """As a number, also from text such as `100 Hz`; None if it is not one."""
        value = self.value(*names)
        if isinstance(value, str):
            found = re.match(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?", value)
            value = float(found[0]) if found else None
        return value if value is not None and np.isfinite(value) else None
