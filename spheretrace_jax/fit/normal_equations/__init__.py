"""The normal equations J^T J and J^T r of a picture, without its Jacobian J."""
