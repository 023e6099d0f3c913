"""The documentation site: `make docs` builds it in build/docs, without a network.

Reference pages are made from the program itself by tools/docs_reference.py whenever the site is built.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]

import docs_reference  # noqa: E402

from accelcal_cli.core.version import __version__  # noqa: E402

project = "accelcal"
author = "accelcal developers"
copyright = f"2026, {author}"
version = release = __version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
source_suffix = {".md": "myst-nb", ".ipynb": "myst-nb"}
exclude_patterns = ["_build"]
nb_execution_mode = "off"
myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist"]
myst_heading_anchors = 4
smartquotes = False
suppress_warnings = ["myst.header"]
default_role = "code"
autodoc_typehints = "description"
napoleon_numpy_docstring = False
copybutton_prompt_text = "$ "

html_theme = "pydata_sphinx_theme"
html_title = f"accelcal {version.partition('+')[0]}"  # a commit would not fit on a phone
html_theme_options = {
    "navbar_center": [],
    "navbar_end": ["theme-switcher"],
    "navbar_persistent": ["search-button"],
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
    "navigation_with_keys": False,
}
html_sidebars = {"**": ["pages.html"]}
templates_path = ["_templates"]
html_show_sourcelink = False
html_context = {"default_mode": "auto"}
html_static_path = ["_static"]
html_css_files = ["site.css"]

OUTSIDE = re.compile(r"\[([^\]]*)\]\((\.\./[^)#]*)(#[^)]*)?\)")
"""A link to a file of the repository that is not a page of the site."""
ANCHOR = re.compile(r'<a id="([^"]+)"></a>')
PAGES = {"../CHANGELOG.md": "reference/changelog.md", "../README.md": "index.md"}


def _read(_: Sphinx, name: str, source: list[str]) -> None:
    """Show links to other files of the repository as their paths: the site has no copy of them."""

    def shown(link: re.Match[str]) -> str:
        text, path, anchor = link[1], link[2], link[3] or ""
        if path in PAGES:
            return f"[{text}]({PAGES[path]})"
        if path.endswith((".png", ".svg")):
            return link[0]
        inside = path.removeprefix("../")
        return f"{text}" if inside in text else f"{text} (`{inside}{anchor}`)"

    if "/" not in name:
        source[0] = ANCHOR.sub(r"(\1)=\n", OUTSIDE.sub(shown, source[0]))


def _whole(_app: Sphinx, what: str, _name: str, _object: object, _options: object, lines: list[str]) -> None:
    """Let napoleon take the words before a colon for words, and not for the type of an attribute."""
    if lines and what in ("attribute", "data", "property"):
        lines[0] = f": {lines[0]}"


def setup(app: Sphinx) -> None:
    """Write the reference pages before they are read."""
    app.connect("autodoc-process-docstring", _whole, priority=1)  # before napoleon
    app.connect("builder-inited", lambda app: docs_reference.write(Path(app.srcdir) / "reference"))
    app.connect("source-read", _read)
