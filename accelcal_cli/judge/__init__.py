"""Judging a calibration by data that the fit did not see."""
