"""A page as a browser takes it: elements, texts and data, by Python's own parser."""

from __future__ import annotations

import base64
import hashlib
import json
from dataclasses import dataclass, field
from html.parser import HTMLParser
from itertools import pairwise
from typing import Any

EMPTY = {"meta", "input", "br", "hr", "col", "link", "img"}
"""Elements of HTML that have no end."""


@dataclass
class Element:
    name: str
    attributes: dict[str, str | None]
    parent: Element | None
    children: list[Element] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """All that it says, its children included."""
        return "".join(self.texts)

    def within(self, *names: str) -> list[Element]:
        """Its descendants of these names, in their order."""
        found = []
        for child in self.children:
            found += [child] if child.name in names else []
            found += child.within(*names)
        return found


class PageParser(HTMLParser):
    """Builds the elements, and fails where one is not closed."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.root = Element("", {}, None)
        self._here = self.root

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert len(dict(attrs)) == len(attrs), f"<{tag}> has an attribute twice"
        made = Element(tag, dict(attrs), self._here)
        self._here.children.append(made)
        if tag not in EMPTY:
            self._here = made

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._here.children.append(Element(tag, dict(attrs), self._here))

    def handle_endtag(self, tag: str) -> None:
        assert tag == self._here.name, f"</{tag}> ends <{self._here.name}>"
        assert self._here.parent is not None
        self._here = self._here.parent

    def handle_data(self, data: str) -> None:
        here: Element | None = self._here
        while here is not None:
            here.texts.append(data)
            here = here.parent

    def close(self) -> None:
        super().close()
        assert self._here is self.root, f"<{self._here.name}> is not closed"


def elements(page: str) -> Element:
    """The root of a page."""
    parser = PageParser()
    parser.feed(page)
    parser.close()
    return parser.root


def data_of(root: Element) -> Any:
    """What the script of a page is given."""
    (held,) = [one for one in root.within("script") if one.attributes.get("type") == "application/json"]
    return json.loads(held.text)


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


def hash_source(text: str) -> str:
    """How a policy names an inline style or script."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def policy_of(root: Element) -> dict[str, str]:
    """The directives of the page's Content-Security-Policy."""
    (meta,) = [
        one for one in root.within("meta") if one.attributes.get("http-equiv") == "Content-Security-Policy"
    ]
    parts = (meta.attributes["content"] or "").split("; ")
    return dict(part.split(" ", 1) for part in parts)


def check_page(root: Element) -> None:
    """What holds for every page: complete in itself, labelled, headings in order, ids unique."""
    everything = [root, *root.within(*_names(root))]
    ids = [one.attributes["id"] for one in everything if one.attributes.get("id")]
    assert len(ids) == len(set(ids))
    for one in everything:
        for name, value in one.attributes.items():
            assert not name.startswith("on"), f"<{one.name} {name}>"
            assert name != "style", f"<{one.name} style> is not allowed by the policy"
            if name in ("href", "src", "action", "data", "srcset", "xlink:href"):
                assert value is not None and (value[0] in "#." or "/" not in value), value
                assert ":" not in value.split("/")[0], value
        for reference in ("aria-labelledby", "aria-describedby"):
            assert set((one.attributes.get(reference) or "").split()) <= set(ids)
    assert not root.within("link", "iframe", "object", "embed", "base", "form")
    levels = [int(one.name[1]) for one in root.within("h1", "h2", "h3", "h4")]
    assert levels[0] == 1 and levels.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    for svg in root.within("svg"):
        named = svg.attributes.get("aria-labelledby") or svg.attributes.get("aria-label")
        assert svg.attributes.get("aria-hidden") == "true" or (svg.attributes.get("role") and named)
    policy = policy_of(root)
    assert policy["default-src"] == "'none'"
    (style,) = root.within("style")
    assert policy["style-src"] == hash_source(style.text)
    scripts = [one for one in root.within("script") if "type" not in one.attributes]
    assert [policy.get("script-src")] == ([hash_source(one.text) for one in scripts] or [None])


def _names(root: Element) -> set[str]:
    return {root.name} | {name for child in root.children for name in _names(child)}
