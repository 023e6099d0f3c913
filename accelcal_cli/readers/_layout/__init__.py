"""Layout files of raw dumps."""
