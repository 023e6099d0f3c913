"""Judging a calibration by data that it did not see."""
