"""Typed access to the tables of a layout file, with errors that name the key."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import UsageError

LARGEST_BYTES = 1 << 40


class Keys:
    """One table of a layout. What was never asked for is unknown, and `finish` says so."""

    def __init__(self, table: Mapping[str, Any], path: Path, name: str) -> None:
        self._table = table
        self._path = path
        self._name = name
        self._known: set[str] = set()

    def __contains__(self, key: str) -> bool:
        return key in self._table

    def error(self, key: str, message: str, hint: str | None = None) -> UsageError:
        """An error about one key."""
        place = f"{self._name}.{key}" if self._name else f"[{key}]"
        return UsageError(f"layout: {place} {message}", path=self._path, hint=hint)

    def raw(self, key: str) -> Any:
        """The value as TOML gave it, None where absent."""
        self._known.add(key)
        return self._table.get(key)

    def finish(self) -> None:
        """Refuse keys that nothing asked for."""
        for key in self._table:
            if key not in self._known:
                near = difflib.get_close_matches(key, self._known, 1)
                known = (
                    f"did you mean {near[0]}?" if near else f"known here: {', '.join(sorted(self._known))}"
                )
                raise self.error(key, "is not a known key", known)

    def table(self, key: str) -> Keys:
        """A table that must be there."""
        found = self.optional_table(key)
        if found is None:
            raise self.error(key, "is missing")
        return found

    def optional_table(self, key: str) -> Keys | None:
        """A table, or None where absent."""
        value = self.raw(key)
        if value is None:
            return None
        if not isinstance(value, Mapping):
            raise self.error(key, f"must be a table, not {value!r}")
        return Keys(value, self._path, f"{self._name}.{key}" if self._name else key)

    def number(self, key: str, low: float = -math.inf, high: float = math.inf) -> float:
        """A number that must be there."""
        value = self.optional_number(key, low, high)
        if value is None:
            raise self.error(key, "is missing")
        return value

    def optional_number(self, key: str, low: float = -math.inf, high: float = math.inf) -> float | None:
        """A finite number within low..high, or None where absent."""
        value = self.raw(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e300:
            raise self.error(key, f"must be a number, not {value!r}")
        if not low <= value <= high:
            raise self.error(key, f"is {value}, which is not within {low:g} to {high:g}")
        return float(value)

    def whole(self, key: str, default: int | None, low: int = 0) -> int:
        """A whole number from `low` on; `default` None: it must be there."""
        value = self.raw(key)
        if value is None:
            value = default
        if value is None:
            raise self.error(key, "is missing")
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, f"must be a whole number, not {value!r}")
        if value is not default and not low <= value <= LARGEST_BYTES:
            raise self.error(key, f"is {value}; it must be at least {low}, and a size that a file can have")
        return value

    def text(self, key: str) -> str | None:
        """A text, or None where absent."""
        value = self.raw(key)
        if value is not None and not isinstance(value, str):
            raise self.error(key, f"must be a text in quotes, not {value!r}")
        return value

    def choice(self, key: str, allowed: tuple[str, ...], default: str | None) -> str:
        """One of a few words; `default` None: it must be there."""
        value = self.text(key) or default
        if value is None:
            raise self.error(key, "is missing")
        if value not in allowed:
            raise self.error(key, f"is {value!r}", f"allowed: {', '.join(allowed)}")
        return value

    def pair(self, key: str) -> tuple[int, int]:
        """Two whole numbers that must be there."""
        value = self.raw(key)
        if value is None:
            raise self.error(key, "is missing")
        whole = isinstance(value, list) and [type(item) for item in value] == [int, int]
        if not whole or not 0 <= value[0] < value[1]:
            raise self.error(key, f"must be two byte numbers [first, after the last], not {value!r}")
        return value[0], value[1]
