"""What a fit works with: free parameters, lights in projective space, targets."""
