"""Where two JSON documents differ."""

from __future__ import annotations

from typing import Any

import pytest

from accelcal_cli.verify import differing


@pytest.mark.parametrize(
    ("one", "other", "places"),
    [
        ({"a": [1, {"b": 2.5}]}, {"a": [1, {"b": 2.5}]}, []),
        ({"a": [1, {"b": 2.5}]}, {"a": [1, {"b": 2.25}]}, ["a[1].b"]),
        ({"a": 1, "b": 2}, {"b": 3, "c": 4}, ["a", "b", "c"]),
        ({"a": [1, 2]}, {"a": [1]}, ["a"]),
        ({"a": None}, {}, ["a"]),
        ({"a": 1}, {"a": 1.0}, ["a"]),
        ({"a": 1}, {"a": True}, ["a"]),
        ({"a": 0.0}, {"a": -0.0}, ["a"]),
        ({"a": {}}, {"a": []}, ["a"]),
        ({"a": 0.1}, {"a": 0.1 + 2**-56}, ["a"]),
    ],
)
def test_places_are_named(one: Any, other: Any, places: list[str]) -> None:
    assert list(differing(one, other)) == places
