"""Standard errors in brackets behind the digits that they are of."""

import re

import pytest
from test_cautions import model

from odescope.model.display import stated_mathml
from odescope.model.rounding import with_last_digits


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (1.23456, 0.0123, ("1.235", "12")),
        (-32.059, 0.00077, ("-32.05900", "77")),
        (1234.0, 95.0, ("1234", "95")),
        (0.5, 0.7, ("0.5", "")),  # no digit of it is sure
        (2.0, None, ("2", "")),
    ],
)
def test_the_bracket_holds_the_error_of_the_last_digits(value, error, shown):
    digits, bracket = with_last_digits(value, error)
    assert (digits, bracket) == shown
    if bracket:
        decimals = len(digits.partition(".")[2])
        assert int(bracket) * 10.0**-decimals == pytest.approx(error, rel=0.06)


def test_a_solved_relation_keeps_its_errors():
    found = model()
    text = [
        re.sub(r"<[^>]*>|&#x206.;|\u2061|\u2062", "", stated_mathml(e, found.shown_relations)) for e in found.equations
    ]
    assert "2.00(10)" in text[0]
    assert "1.000(10)" in text[0]
    assert "4.00(10)" in text[1]
