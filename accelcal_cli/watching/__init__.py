"""Calibration of a recording while it grows (docs/watch.md)."""
