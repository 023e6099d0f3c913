"""The page of one recording: a stand-in, with its outcome and message alone."""

from __future__ import annotations

from typing import Any

from accelcal_cli.pages.rendering import rendered


def page(report: dict[str, Any], quality: dict[str, Any] | None) -> str:
    """The whole page as HTML."""
    return rendered("recording.html", report=report, quality=quality)
