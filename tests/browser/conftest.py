"""A real Chromium, as `make browser` sets it up; without it these tests are skipped, and say so."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

CHROMIUM, AXE, SHOTS = "ACCELCAL_CHROMIUM", "ACCELCAL_AXE", "ACCELCAL_SCREENSHOTS"
"""Variables that `make browser` sets: the browser, the script of axe-core, and a folder for screenshots."""
QUIET = ("--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update")


@dataclass
class Opened:
    """A page in the browser, and all that it complained of or asked for."""

    page: Any
    complaints: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what needs a browser where `make browser` has not set one up."""
    if CHROMIUM in os.environ:
        return
    here = Path(__file__).parent
    for item in items:
        if here in item.path.parents:
            item.add_marker(pytest.mark.skip(reason="needs a browser: make browser"))


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """The browser."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=os.environ[CHROMIUM], args=[*QUIET])
        yield browser
        browser.close()


@pytest.fixture
def opened(chromium: Any) -> Iterator[Callable[..., Opened]]:
    """Opens files in windows of their own, without a network."""
    contexts = []

    def open_(path: Path | None, **how: Any) -> Opened:
        context = chromium.new_context(viewport={"width": 1280, "height": 900}, offline=True, **how)
        contexts.append(context)
        made = Opened(context.new_page())
        made.page.on("console", lambda one: made.complaints.append(f"{one.type}: {one.text}"))
        made.page.on("pageerror", lambda one: made.complaints.append(str(one)))
        made.page.on("request", lambda one: made.requests.append(one.url))
        if path is not None:
            made.page.goto(path.as_uri())
        return made

    yield open_
    for context in contexts:
        context.close()


@pytest.fixture(scope="session")
def axe() -> str:
    """The source of axe-core."""
    return Path(os.environ[AXE]).read_text("utf-8")


@pytest.fixture(scope="session")
def shots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where screenshots and prints go, to be looked at."""
    folder = Path(os.environ.get(SHOTS) or tmp_path_factory.mktemp("screenshots"))
    folder.mkdir(parents=True, exist_ok=True)
    return folder
