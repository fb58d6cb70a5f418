"""Fractions of one variable as polynomials and saturations, against the fractions themselves."""

import numpy as np

from odescope.library.expression import ONE, Name, Term
from odescope.likelihood.saturating import partial_fractions

S, X = np.random.default_rng(0).uniform(0.1, 3.0, (2, 50))
HALF = 0.7


def term(**powers):
    return Term.of((Name(n), p) for n, p in powers.items())


def value(parts):
    return sum(c * np.prod([{"S": S, "X": X}[a.name] ** p for a, p in t.factors], axis=0) for t, c in parts.items())


def test_partial_fractions_say_what_the_fraction_says():
    above = {ONE: 0.3, term(S=1): -1.2, term(S=3): 0.4, term(X=1): 0.9, term(S=2, X=1): -0.5}
    whole, saturated = partial_fractions(above, "S", HALF)
    found = value(whole) + value(saturated) * S / (HALF + S)
    assert np.abs(found - value(above) / (HALF + S)).max() < 1e-12


def test_what_the_denominator_divides_has_no_saturation():
    """Dilution beside Monod's law: D (a - S) (K + S) and mu S X, over K + S."""
    above = {term(X=1): 2.0 * HALF, term(X=1, S=1): 2.0 - HALF, term(X=1, S=2): -1.0, term(S=1): 0.5}
    whole, saturated = partial_fractions(above, "S", HALF)
    assert np.isclose(whole[term(X=1)], 2.0)
    assert np.isclose(whole[term(X=1, S=1)], -1.0)
    assert abs(saturated[term(X=1)]) < 1e-12
    assert np.isclose(saturated[ONE], 0.5)
    assert abs(whole[ONE]) < 1e-12
