"""Recordings in many files: archives that hold their parts, and the reader that joins them."""
