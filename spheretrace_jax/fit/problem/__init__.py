"""The least-squares problem of a fit, its compression, and the labels of its unknowns."""
