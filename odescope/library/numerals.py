"""Raised numerals, for exponents in text."""

from __future__ import annotations

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def raised(number: int) -> str:
    """Return a whole number in superscript."""
    return str(number).translate(_RAISED)
