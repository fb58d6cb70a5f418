"""Measured runs: records, coordinates and inputs; reading, checking and cutting them."""
