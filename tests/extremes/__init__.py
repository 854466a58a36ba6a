"""The catalogue of stiff and extreme cases: run as tests, printed as docs/extremes.md."""

from extremes import covered, derivatives, rays, shading, spawned, views

PARTS = [rays, spawned, shading, views, derivatives, covered]
