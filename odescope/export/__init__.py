"""Models as text, LaTeX, Python code and JSON."""
