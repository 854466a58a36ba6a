"""Benchmarks: error against run time, and growth with the size of a scene."""
