"""Checks of a scene: derivatives, rounding, conditioning."""
