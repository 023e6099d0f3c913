"""This implementation compared with the papers' tables."""
