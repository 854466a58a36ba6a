"""Studies: checks of derivatives, pictures and fits, and benchmarks of error against run time."""
