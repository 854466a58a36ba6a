"""Levenberg-Marquardt with bounds, its driver, and the search for lights."""
