"""Acceleration structures: which of very many spheres a ray may meet."""
