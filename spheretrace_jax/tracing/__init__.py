"""The lecture: rays, shapes, shading, shadows, mirrors. Read this folder first."""
