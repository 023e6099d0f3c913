"""The settings that `--stillness` and the options of its rules make."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.settings import STILLNESS, Settings, with_stillness


def stillness_settings(profile: Settings, values: dict[str, Any]) -> Settings:
    """The profile's settings with the rule of stillness that the user wants, and its numbers.

    Raises:
        UsageError: a number means nothing to the rule.
    """
    name, threshold_g, seconds = (
        values[option] for option in ("stillness", "stillness_threshold_g", "segment_seconds")
    )
    chosen = profile if name is None else with_stillness(profile, name)
    if threshold_g is not None:
        if chosen.stillness_threshold_g is None:
            raise UsageError(
                f"--stillness {chosen.stillness} has no threshold of max - min",
                hint="leave --stillness-threshold-g out, or use --stillness both or range",
            )
        chosen = replace(chosen, stillness_threshold_g=threshold_g)
    return chosen if seconds is None else _with_windows(chosen, seconds)


def _with_windows(chosen: Settings, seconds: float) -> Settings:
    """The settings with windows of another length, which then has no other lower bound."""
    if chosen.adaptive is None:
        return replace(chosen, segment_seconds=seconds)
    if seconds < STILLNESS["adaptive"]["segment_seconds"]:
        raise UsageError(
            "--stillness adaptive needs windows of at least 1 s", hint="give --segment-seconds 1 or more"
        )
    return replace(chosen, segment_seconds=seconds, adaptive=replace(chosen.adaptive, min_samples=2))
