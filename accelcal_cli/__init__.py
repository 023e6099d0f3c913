"""Batch calibration of raw actigraph recordings from the stillness they contain."""

__version__ = "0.2.0"
