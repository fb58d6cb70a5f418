"""Trajectory likelihood of a model given records, and the structure search on it."""
