"""The catalogue of stiff and extreme cases: run as tests, printed as docs/extremes.md."""

from . import files, fits

PARTS = [fits, files]
