"""Benchmarks: error against run time, and scaling with the size of a scene."""
