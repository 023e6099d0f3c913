"""Collecting calibration points from still windows."""
