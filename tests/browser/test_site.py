"""The documentation site in a real browser: it needs no network, fits a phone, and axe-core finds nothing."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.browser.conftest import Opened

SITE = Path(os.environ.get("ACCELCAL_SITE") or Path(__file__).resolve().parents[2] / "build/docs")
"""The site as `make docs` builds it."""
PAGES = ("index", "first-recording", "reference/commands", "reference/python", "reference/files")
"""The home page, a tutorial, and the generated pages: commands, functions, and keys of the schemas."""

CUT_OFF = """[...document.querySelectorAll(".bd-article :is(h1, h2, h3) *")]
  .filter(one => one.getBoundingClientRect().right > innerWidth).map(one => one.textContent)"""
"""Finds parts of headings that end beyond the window."""

pytestmark = pytest.mark.skipif(not (SITE / "index.html").exists(), reason="needs the site: make docs")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("name", PAGES)
def test_a_page_of_the_site_can_be_read(
    opened: Callable[..., Opened], axe: str, shots: Path, name: str, width: int, scheme: str
) -> None:
    made = opened(None, color_scheme=scheme)
    page: Any = made.page
    page.set_viewport_size({"width": width, "height": 900})
    page.goto((SITE / f"{name}.html").as_uri())
    page.screenshot(path=shots / f"site-{name.replace('/', '-')}-{width}-{scheme}.png")
    assert page.evaluate("document.documentElement.dataset.theme") == scheme
    wide, seen = page.evaluate("[document.documentElement.scrollWidth, document.documentElement.clientWidth]")
    assert wide <= seen, "the page has to be moved sideways"
    assert page.evaluate(CUT_OFF) == []
    page.evaluate(axe)
    found = page.evaluate("axe.run(document, {resultTypes: ['violations'], preload: false})")["violations"]
    assert [(one["id"], [node["target"] for node in one["nodes"]][:5]) for one in found] == []
    assert [url for url in made.requests if not url.startswith(("file:", "data:"))] == []
    faults = [one for one in made.complaints if not one.startswith(("log:", "debug:", "info:"))]
    assert faults == []
