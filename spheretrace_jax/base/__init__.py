"""Foundations of the package: array types, vectors, safe mathematics, errors."""
