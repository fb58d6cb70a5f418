"""Sparse regression on the factor of a library: proposers find supports, the factor computes coefficients."""
