"""Simulated wrist wear with known sensor errors."""
