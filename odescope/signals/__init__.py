"""Filtered values and derivatives of what was measured, with the noise level and cutoff that were found."""
