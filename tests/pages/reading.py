"""The page of a study as a browser takes it: its elements, and the data of its script."""

from __future__ import annotations

import json
from typing import Any

from tests.pages.html import Element, check_tree


def data_of(root: Element) -> Any:
    """What the script of a page is given."""
    (held,) = [one for one in root.all("script") if one.attributes.get("type") == "application/json"]
    return json.loads(held.whole())


def cell_texts(table: dict[str, Any], key: str) -> list[Any]:
    """A column of a table of the page, as it is shown: an independent reading of its encoding."""
    (column,) = [one for one in table["columns"] if one["key"] == key]
    if column["kind"] == "choice":
        return [column["names"][value] for value in column["values"]]
    if column["kind"] == "message":
        return [_message(column["names"], value) for value in column["values"]]
    return list(column["values"])


def _message(names: list[list[str]], value: Any) -> str:
    if value == 0:
        return ""
    parts, numbers = names[value[0]], value[1:]
    return parts[0] + "".join(number + part for number, part in zip(numbers, parts[1:], strict=True))


def check_page(root: Element) -> None:
    """What holds for every page that links to others."""
    check_tree(root, linked=True)
    for svg in root.all("svg"):
        named = svg.attributes.get("aria-labelledby") or svg.attributes.get("aria-label")
        assert svg.attributes.get("aria-hidden") == "true" or (svg.attributes.get("role") and named)
