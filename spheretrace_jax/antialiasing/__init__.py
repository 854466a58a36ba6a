"""Analytic antialiasing: exact areas of edges inside pixels."""
