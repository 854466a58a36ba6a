"""Acceleration structures: candidate spheres for each ray, in scenes of very many spheres."""
