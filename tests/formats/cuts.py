"""Where files are cut short: at some places in every run of the suite, at every byte nightly."""

from __future__ import annotations

import pytest

PAGE = 128
"""All pages and sectors that are cut here are multiples of it; tables have none."""

every_byte = pytest.mark.parametrize(
    "step", [pytest.param(53, id="some"), pytest.param(1, id="all", marks=pytest.mark.nightly)]
)


def cuts(data: bytes, step: int, first: int = 0) -> list[int]:
    """Lengths below that of `data`: every step-th, and some beside the end of a line or page."""
    sizes = range(first, len(data))
    near = [one for one in sizes if one % PAGE in (0, 1, PAGE - 1) or b"\n" in data[one - 1 : one + 1]]
    return sorted({*near[::3], *(one for one in sizes if one % step == 0)})


def table_cuts(data: bytes, step: int, *beside: int) -> list[int]:
    """Lengths from 1 to below that of `data`: few, or all with step 1, and those beside some places."""
    few = range(1, len(data), 4 * step if step > 1 else 1)
    near = {place + shift for place in (*beside, len(data)) for shift in (-1, 0, 1)}
    return sorted({*few, *near} & {*range(1, len(data))})
