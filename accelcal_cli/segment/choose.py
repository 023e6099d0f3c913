"""The rule of stillness that the settings name."""

from __future__ import annotations

from accelcal_cli.core.settings import Settings
from accelcal_cli.segment.adaptive import AdaptiveRule
from accelcal_cli.segment.blocks import Rule
from accelcal_cli.segment.rules import still_rule


def chosen_rule(settings: Settings, lsb_per_g: float, length: int) -> Rule:
    """A rule for windows of so many samples of counts."""
    if settings.adaptive is not None:
        return AdaptiveRule(length, lsb_per_g, settings.adaptive)
    return still_rule(
        settings.stillness_axes, settings.stillness_threshold_g, settings.stillness_deviation_g, lsb_per_g
    )


def window_length(settings: Settings, rate_hz: float) -> int:
    """Samples in a window."""
    fewest = 1 if settings.adaptive is None else settings.adaptive.min_samples
    return max(fewest, round(settings.segment_seconds * rate_hz))
