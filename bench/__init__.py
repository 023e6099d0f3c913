"""Benchmarks: `make bench`. Outside the package and outside the tests."""
