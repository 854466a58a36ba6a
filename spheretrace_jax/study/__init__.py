"""Evidence: how well derivatives, pictures and fits agree with the truth."""
