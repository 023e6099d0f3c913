"""Recordings that are named columns: what their names, units and attributes say, and their rows as chunks."""
