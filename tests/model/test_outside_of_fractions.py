"""Quotients with what stands outside of the fraction."""

import numpy as np
import pytest

from odescope.library.expression import Combination
from odescope.library.parse import Scope, parse_term
from odescope.model.display import quotient_latex, quotient_mathml
from odescope.model.explicit import Quotient

SCOPE = Scope.of(["S", "P", "D", "F"])


def combination(**parts):
    return Combination.of((c, parse_term(text.replace("_", "*"), SCOPE)) for text, c in parts.items())


def valued(quotient, values):
    beside, above, below = (
        sum(c * np.prod([values[atom.text] ** power for atom, power in t.factors]) for c, t in side.parts)
        for side in (quotient.outside, quotient.numerator, quotient.denominator)
    )
    return beside + above / below


def whole():
    below = Combination.of([(1.0, parse_term("1", SCOPE)), *combination(S=1.6, P=1.1).parts])
    return Quotient("S_dot", combination(S=-1.7), below, combination(D_F=1.0, D_S=-0.3)).together


def test_what_stands_in_proportion_to_the_denominator_is_taken_out():
    assert len(whole().numerator.parts) == 7
    assert whole().apart.text == "D*F - 0.3*D*S - 1.7*S/(1.0 + 1.1*P + 1.6*S)"
    rng = np.random.default_rng(0)
    for _ in range(5):
        values = dict(zip("SPDF", rng.uniform(0.1, 2.0, 4).tolist(), strict=True))
        one, other = (valued(q, values) for q in (whole(), whole().apart))
        assert one == pytest.approx(other, rel=1e-12)


def test_what_is_out_of_proportion_stays():
    q = whole()
    off = Combination(tuple((c * (1.0 + 1e-6 * (t.text == "D*F*P")), t) for c, t in q.numerator.parts))
    apart = Quotient(q.target, off, q.denominator).apart
    assert [t.text for _, t in apart.outside.parts] == ["D*S"]
    assert {t.text for _, t in apart.numerator.parts} == {"S", "D*F", "D*F*P", "D*F*S"}


def test_a_fraction_beside_other_terms_keeps_its_sign_in_formulas():
    assert r"- \frac{1.7 \, S}" in quotient_latex(whole().apart)
    assert "<mo>−</mo><mfrac>" in quotient_mathml(whole().apart)
