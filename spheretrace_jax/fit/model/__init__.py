"""The model of a fit: free parameters, light positions in projective space, target pictures."""
