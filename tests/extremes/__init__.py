"""The catalogue of stiff and extreme cases: run as tests, printed as docs/extremes.md."""

from extremes import covered, derivatives, files, fits, rays, shading, spawned, views

PARTS = [rays, spawned, shading, covered, views, derivatives, fits, files]
