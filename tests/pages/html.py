"""HTML read strictly: what a browser would mend in silence is an error here."""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass, field
from html.parser import HTMLParser
from itertools import pairwise

VOID = {"meta", "br", "hr", "img", "input", "link"}
SHAPES = {"path", "circle", "rect", "line"}
"""Elements of SVG that may be closed where they begin."""
URLS = {"href", "src", "srcset", "action", "formaction", "data", "poster", "xlink:href", "background", "ping"}


@dataclass
class Element:
    """An element of a page: its attributes, its own text, and what it lies in."""

    tag: str
    attributes: dict[str, str]
    parent: Element | None
    text: str = ""
    children: list[Element] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)

    def all(self, *tags: str) -> list[Element]:
        """What lies in it, at any depth."""
        found = [one for child in self.children for one in (child, *child.all())]
        return [one for one in found if not tags or one.tag in tags]

    def whole(self) -> str:
        """Its text and that of all that lies in it."""
        return "".join(self.texts)

    def one(self, tag: str, **attributes: str) -> Element:
        """The only element of a tag with these attributes (`kind` for `class`, `name` for `id`)."""
        asked = {{"kind": "class", "name": "id"}.get(key, key): value for key, value in attributes.items()}
        (found,) = [one for one in self.all(tag) if asked.items() <= one.attributes.items()]
        return found


class Strict(HTMLParser):
    """Builds the tree of a page, and fails where an element is not closed in its place."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.root = self.here = Element("", {}, None)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        names = [name for name, _ in attrs]
        assert len(names) == len(set(names)), f"<{tag}> has an attribute twice"
        made = Element(tag, {name: value or "" for name, value in attrs}, self.here)
        self.here.children.append(made)
        if tag not in VOID:
            self.here = made

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag in VOID | SHAPES, f"<{tag}/>"
        here = self.here
        self.handle_starttag(tag, attrs)
        self.here = here

    def handle_endtag(self, tag: str) -> None:
        assert self.here.tag == tag, f"</{tag}> closes <{self.here.tag}>"
        assert self.here.parent is not None
        self.here = self.here.parent

    def handle_data(self, data: str) -> None:
        self.here.text += data
        here: Element | None = self.here
        while here is not None:
            here.texts.append(data)
            here = here.parent

    def handle_comment(self, data: str) -> None:
        raise AssertionError(f"a comment: {data}")


def parsed(text: str) -> Element:
    """The tree of a page; AssertionError where it is not well formed."""
    parser = Strict()
    parser.feed(text)
    parser.close()
    assert parser.here is parser.root, f"<{parser.here.tag}> is not closed"
    return parser.root


def policy(root: Element) -> str:
    """The page's Content-Security-Policy."""
    (found,) = [
        one.attributes["content"]
        for one in root.all("meta")
        if one.attributes.get("http-equiv") == "Content-Security-Policy"
    ]
    return found


def digest(text: str) -> str:
    """A text's hash as a policy names it."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def check(text: str) -> Element:
    """What holds for every page of ours; returns its tree."""
    assert text.startswith("<!doctype html>\n") and 'content="accelcal ' in text[:256]
    assert all(char.isprintable() or char == "\n" for char in text)
    root = parsed(text)
    check_tree(root)
    for one in root.all("svg"):
        first, second = (child for child in one.children[:2])
        assert (one.attributes["role"], first.tag, second.tag) == ("img", "title", "desc")
        assert one.attributes["aria-labelledby"].split() == [first.attributes["id"], second.attributes["id"]]
        assert first.text and second.text
    return root


def check_tree(root: Element, *, linked: bool = False) -> None:
    """What holds for every page: complete in itself, labelled, headings in order, ids unique.

    Args:
        linked: it has links to other pages beside it.
    """
    check_policy(root)
    names = [one.attributes["id"] for one in root.all() if "id" in one.attributes]
    assert len(names) == len(set(names))
    assert not root.all("link", "iframe", "object", "embed", "base", "form")
    for one in root.all():
        assert "style" not in one.attributes and not any(name.startswith("on") for name in one.attributes)
        for name in URLS & one.attributes.keys():
            url = one.attributes[name]
            if linked and not url.startswith("#"):
                assert (url[0] == "." or "/" not in url) and ":" not in url.split("/")[0], url
            else:
                assert url.startswith("#") and url[1:] in names
        for name in ("aria-labelledby", "aria-describedby"):
            assert set(one.attributes.get(name, "").split()) <= set(names)
    levels = [int(one.tag[1]) for one in root.all() if one.tag in ("h1", "h2", "h3", "h4")]
    assert levels[0] == 1 and levels.count(1) == 1
    assert all(later <= before + 1 for before, later in pairwise(levels))


def check_policy(root: Element) -> None:
    """Nothing is allowed but the style and the script that are in the page."""
    (style,) = root.all("style")
    scripts = [one for one in root.all("script") if one.attributes.get("type") != "application/json"]
    rules = dict(one.strip().partition(" ")[::2] for one in policy(root).split(";"))
    assert rules["default-src"] == "'none'" and rules["style-src"] == digest(style.text)
    assert rules.get("script-src", "") == " ".join(digest(one.text) for one in scripts)
    assert (rules["base-uri"], rules["form-action"]) == ("'none'", "'none'")
    assert "url(" not in style.text and "@import" not in style.text
