"""Columns of the tables of a study's page, as its script (study.js) reads them.

They are short, since a page may have thousands of rows: numbers to four digits, and texts that differ in
little stand there once.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from datetime import datetime
from typing import Any

from markupsafe import Markup

NUMBER = re.compile(r"\d+(?:\.\d+)?")
"""A number in a message."""


def column(key: str, label: str, kind: str, width: float, values: Sequence[Any]) -> dict[str, Any]:
    """A column so many rem wide, whose values are of a kind that the script knows; one for each row."""
    return {"key": key, "label": label, "kind": kind, "width": width, "values": values}


def choice(key: str, width: float, values: Sequence[str], order: Sequence[str] = ()) -> dict[str, Any]:
    """A column of few different texts: their list, and the place of each value in it."""
    there = set(values)
    names = [*(name for name in order if name in there), *sorted(there - set(order))]
    place = {name: index for index, name in enumerate(names)}
    return column(key, key, "choice", width, [place[one] for one in values]) | {"names": names}


def number(
    key: str, label: str, width: float, values: Iterable[float | None], kind: str = "number"
) -> dict[str, Any]:
    """A column of numbers to four significant digits."""
    return column(key, label, kind, width, [_short(value) for value in values])


def _short(value: float | None) -> float | int | None:
    if value is None:
        return None
    short = float(f"{value:.4g}")
    return int(short) if short.is_integer() else short


def minutes(key: str, label: str, width: float, starts: Sequence[str | None]) -> dict[str, Any]:
    """A column of times, by the clock that they were written down by, in minutes since 1970."""
    return column(key, label, "minutes", width, [_minutes(start) for start in starts])


def _minutes(start: str | None) -> int | None:
    try:
        moment = datetime.fromisoformat((start or "")[:16])
    except ValueError:
        return None
    return int((moment.replace(tzinfo=None) - datetime(1970, 1, 1)).total_seconds() // 60)


def messages(key: str, label: str, width: float, told: Sequence[str]) -> dict[str, Any]:
    """A column of messages: the texts without their numbers once, and the numbers of each.

    Thousands of messages differ in their numbers alone. A value is [which text, its numbers ...]; 0 for none.
    """
    texts: dict[str, int] = {}
    values: list[Any] = []
    for message in told:
        place = texts.setdefault(NUMBER.sub("\0", message), len(texts)) if message else 0
        values.append([place, *NUMBER.findall(message)] if message else 0)
    return column(key, label, "message", width, values) | {"names": [text.split("\0") for text in texts]}


def embedded(value: Any) -> Markup:
    """JSON that can stand in a script element: nothing in it ends the element or a line of script."""
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    for char in "<>&\u2028\u2029":
        text = text.replace(char, f"\\u{ord(char):04x}")
    return Markup(text)
