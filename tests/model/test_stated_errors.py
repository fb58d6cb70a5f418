"""Standard errors in brackets behind the digits that they are of."""

import re
from dataclasses import replace

import pytest
from built_models import build
from test_cautions import model

from odescope.model.display import stated_mathml
from odescope.model.relation import Relation
from odescope.model.rounding import rounded, with_last_digits
from odescope.recordings.coordinate import Coordinate, Input


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


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (-6.95599e10, 1.9e9, ("-6.96e+10", "1.9e+09")),
        (1.43904e-8, 5.7e-10, ("1.439e-08", "5.7e-10")),
        (-0.003990213, 6.3e-8, ("-0.00399021", "6.3e-08")),
        (2.5e12, 3e12, ("2.5e+12", "3e+12")),  # no digit of it is sure
        (9.96e10, 1e9, ("9.96e+10", "1e+09")),
    ],
)
def test_beside_a_power_of_ten_a_number_has_the_digits_that_its_error_leaves(value, error, shown):
    assert rounded(value, error) == shown


def test_a_solved_relation_keeps_its_errors():
    found = model()
    text = [
        re.sub(r"<[^>]*>|&#x206.;|\u2061|\u2062", "", stated_mathml(e, found.shown_relations)) for e in found.equations
    ]
    assert "2.00(10)" in text[0]
    assert "1.000(10)" in text[0]
    assert "4.00(10)" in text[1]


def test_errors_stay_where_a_product_of_the_target_is_divided_out():
    z, current = Coordinate("z", order=2), Input("i")
    law = build([z], [current], [("z_ddot", "z**2", 1.0), (None, "i**2", 2e-4), (None, "z**2", -9.81)])
    (relation,) = law.relations
    sure = (replace(t, std_error=e) for t, e in zip(relation.terms, (None, 1e-6, 0.01), strict=True))
    found = replace(law, relations=(Relation(tuple(sure)),))
    (text,) = (stated_mathml(e, found.shown_relations) for e in found.equations)
    assert "9.810(10)" in re.sub(r"<[^>]*>", "", text)
