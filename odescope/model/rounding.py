"""Coefficients beside their standard errors, to the same place, the error to two digits."""

from __future__ import annotations

import math

MOST = 6  # digits of a number beside a power of ten


def places(value: float, error: float) -> int | None:
    """Return the decimals that a coefficient and its error are written to; None where powers of ten read better."""
    if not 0.0 < error < abs(value) or not 1e-7 < error < 1e7 or abs(value) >= 1e10:
        return None
    return max(1 - _exponent(error), 0)


def _exponent(value: float) -> int:
    """Return the power of ten of the first of two digits."""
    return int(f"{value:.1e}".partition("e")[2])


def _significant(value: float, error: float | None) -> str:
    """Return a coefficient to six digits, or to the second of its error, if that comes first."""
    if error is None or not 0.0 < error < abs(value) < math.inf:
        return f"{value:.{MOST}g}"
    return f"{value:.{min(_exponent(value) - _exponent(error) + 2, MOST)}g}"


def rounded(value: float, error: float | None) -> tuple[str, str]:
    """Return a coefficient and its standard error as plain text; "" for an error that is not known."""
    decimals = None if error is None else places(value, error)
    if decimals is not None:
        return f"{value:.{decimals}f}", f"{error:.{decimals}f}"
    return _significant(value, error), "" if error is None else f"{error:.2g}"


def with_last_digits(value: float, error: float | None) -> tuple[str, str]:
    """Return a coefficient and its standard error in units of its last digit, as 1.2345 and 23; "" for none of these.

    Where powers of ten would read better, the coefficient stands alone.
    """
    decimals = None if error is None else places(value, error)
    if decimals is None or error is None:
        return _significant(value, error), ""
    return f"{value:.{decimals}f}", f"{round(error * 10.0**decimals)}"
