"""Where files are cut short: at some places in every run of the suite, at every byte nightly."""

from __future__ import annotations

import pytest

PAGE = 128
"""All pages and sectors that are cut here are multiples of it."""

every_byte = pytest.mark.parametrize(
    "step", [pytest.param(13, id="some"), pytest.param(1, id="all", marks=pytest.mark.nightly)]
)


def cuts(data: bytes, step: int, first: int = 0) -> list[int]:
    """Lengths below that of `data`: every step-th, and all beside the end of a line or page."""
    return [
        size
        for size in range(first, len(data))
        if size % step == 0 or size % PAGE in (0, 1, PAGE - 1) or b"\n" in data[size - 1 : size + 1]
    ]
