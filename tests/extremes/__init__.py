"""The catalogue of stiff and extreme cases: run as tests, printed as docs/extremes.md."""

from extremes import derivatives, edges, files, fits, intersections, secondary_rays, shading, views

PARTS = [intersections, secondary_rays, shading, edges, views, derivatives, fits, files]
