"""Consensus among left-hand-side guesses, families of relations that predict alike, and their ranking."""
