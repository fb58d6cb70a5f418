"""Candidate terms: expressions, the tape that evaluates them, libraries of products and the rules that thin them."""
