"""Damaged files of every kind that the command reads, without end: `make fuzz`."""
