from itertools import product

import msgspec
import pytest
from term_oracle import SCOPE

from odescope.errors import InputError
from odescope.library.candidates import Library
from odescope.library.parse import parse_term
from odescope.library.rules import AnyRule, Exclusive, Identity, MaximumDegree, MaximumFactors, Unmultiplied

BASIS = ("x", "phi_dot", "u", "sin(phi)", "cos(phi)")
DEGREE = 4


def exponents():
    """Every product of the basis to the degree, as exponents."""
    return [e for e in product(range(DEGREE + 1), repeat=len(BASIS)) if sum(e) <= DEGREE]


def spelled(powers):
    return parse_term("*".join(f"({b})**{p}" for b, p in zip(BASIS, powers, strict=True) if p) or "1", SCOPE)


WHOLE = ((1, 0, 1, 0, 0), (0, 0, 0, 1, 0))
RULES = [
    (MaximumDegree(("x", "u"), 2), lambda e: e[0] + e[2] <= 2),
    (MaximumDegree(("cos(phi)",), 0), lambda e: e[4] == 0),
    (MaximumDegree(("cos( phi )", "sin(phi)"), 1), lambda e: e[3] + e[4] <= 1),
    (Exclusive(("x", "phi_dot", "u")), lambda e: sum(p > 0 for p in e[:3]) <= 1),
    (Exclusive(("u", "sin(phi)")), lambda e: not (e[2] and e[3])),
    (MaximumFactors(2), lambda e: sum(p > 0 for p in e) <= 2),
    (MaximumFactors(0), lambda e: not any(e)),
    (Identity("sin(phi)"), lambda e: e[3] <= 1),
    (Unmultiplied(("u", "sin( phi )"), ("x*u", "sin(phi)")), lambda e: not (e[2] or e[3]) or e in WHOLE),
]


@pytest.mark.parametrize(("rule", "allowed"), RULES, ids=[str(rule) for rule, _ in RULES])
def test_a_rule_keeps_the_products_it_says(rule, allowed):
    for powers in exponents():
        assert rule.keeps(spelled(powers), SCOPE) == allowed(powers), (powers, str(rule))


def test_rules_together_keep_what_each_keeps_in_any_order():
    library = Library.of(BASIS, SCOPE).powers(DEGREE)
    rules = [rule for rule, _ in RULES if rule != MaximumFactors(0)]
    forward, backward = library.thin(rules, SCOPE), library.thin(rules[::-1], SCOPE)
    assert forward.terms == backward.terms
    expected = {spelled(e) for e in exponents() if all(allowed(e) for r, allowed in RULES if r != MaximumFactors(0))}
    assert set(forward.terms) == expected
    assert 0 < len(expected) < len(library)


@pytest.mark.parametrize("text", ["x*u", "x**2", "1", "x/u"])
def test_a_rule_speaks_of_single_functions(text):
    with pytest.raises(InputError, match="single functions"):
        MaximumDegree((text,), 1).keeps(parse_term("x", SCOPE), SCOPE)


def test_an_unknown_name_in_a_rule_is_an_error():
    with pytest.raises(InputError, match="did you mean 'phi_dot'"):
        Identity("phi_dt").keeps(parse_term("x", SCOPE), SCOPE)


@pytest.mark.parametrize("rule", [rule for rule, _ in RULES], ids=str)
def test_a_rule_survives_a_study_file(rule):
    assert msgspec.toml.decode(msgspec.toml.encode(rule), type=AnyRule) == rule


def test_a_rule_with_an_unknown_key_is_refused():
    with pytest.raises(msgspec.ValidationError, match="degre"):
        msgspec.convert({"kind": "maximum_degree", "of": ["x"], "degre": 2}, AnyRule)
