"""Levenberg-Marquardt with bounds, its driver, the gauge, and the search for lights."""
