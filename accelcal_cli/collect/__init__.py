"""Calibration points from still windows."""
