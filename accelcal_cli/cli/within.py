"""Numbers on the command line."""

from __future__ import annotations

from math import isfinite
from typing import Any

import click


class Within(click.FloatRange):
    """A finite number in a range; click's own range lets NaN pass."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Parse and check."""
        number = float(super().convert(value, param, ctx))
        if not isfinite(number):
            self.fail(f"{value} is not a finite number", param, ctx)
        return number
