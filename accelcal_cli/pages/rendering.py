"""Templates made into pages: escaped, self-contained, with a policy that lets nothing in from outside.

Whatever a file says of itself reaches a page through `finalize` and autoescape alone: control characters and
marks that turn the direction of text are shown, not obeyed, and nothing is treated as HTML.
"""

from __future__ import annotations

import base64
import hashlib
import re
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from accelcal_cli.core.errors import printable
from accelcal_cli.core.version import __version__

if TYPE_CHECKING:
    from jinja2 import Environment

Rows = list[list[str]]


@dataclass(frozen=True, slots=True)
class PageTable:
    """A table: caption, names of columns, rows of cells, and the numbers of columns that hold words."""

    caption: str
    head: list[str]
    rows: Rows
    words: tuple[int, ...] = (0,)


def resource(name: str) -> str:
    """Read the text of a file of this package."""
    return files("accelcal_cli.pages").joinpath(name).read_text("utf-8")


def rendered(template: str, *, style: str | None = None, script: str | None = None, **values: Any) -> str:
    """Render a page with its style and its script inside, which its policy allows by their hashes alone.

    Args:
        style, script: names of files of this package; the style is added to that of all pages.
    """
    css = resource("base.css") + (resource(style) if style else "")
    code = resource(script) if script else ""
    policy = ["default-src 'none'", "img-src data:", "base-uri 'none'", "form-action 'none'"]
    policy += [f"style-src {_hash(css)}", *([f"script-src {_hash(code)}"] if code else [])]
    page = _environment().get_template(template)
    return page.render(
        policy="; ".join(policy), style=Markup(css), script=Markup(code), version=__version__, **values
    )


def rendered_fragment(**values: Any) -> str:
    """Render a part of somebody else's page; its style holds for nothing else there, and is always light."""
    css = resource("base.css")
    colours = css.partition(":root {")[2].partition("}")[0].replace("color-scheme: light dark;", "")
    rules = [line for line in css.splitlines() if line.startswith(("svg ", ".verdict"))]
    own = re.sub(r"(^|} |, )(svg |\.verdict)", r"\1.accelcal \2", "\n".join(rules), flags=re.MULTILINE)
    own += "\n.accelcal svg { max-width: 760px; }"
    page = _environment().get_template("fragment.html")
    return page.render(colours=Markup(colours), style=Markup(own), **values)


def shown(value: Any) -> Any:
    """Show control characters and marks of direction in a text; leave our own Markup as it is."""
    if not isinstance(value, str) or isinstance(value, Markup) or value.isprintable():
        return value
    return printable(value)


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined  # slow, and help never renders

    return Environment(
        loader=FunctionLoader(lambda name: resource(f"templates/{name}")),
        autoescape=True,
        optimized=False,  # each template is rendered once
        finalize=shown,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
