"""One reaction in two balances: its rate, found in one of them, is that of the other."""

import msgspec
import numpy as np
import pytest
from reactors import STUDY, reactor

from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.relation import Relation, RelationTerm
from odescope.pipeline.identification import identify
from odescope.pipeline.shared_rates import _rates
from odescope.study.options import Candidates


@pytest.mark.parametrize(("least", "several"), [(0.1, True), (-0.6, False)])
def test_a_rate_without_a_pole_on_the_data_is_a_candidate_with_constants_of_its_own(least, several):
    scope = Scope.of(["S", "P", "D"])
    terms = {"1": 1.0, "S": 1.6, "P": 1.1}
    left = [RelationTerm(Product("P_dot", parse_term(text, scope)), c) for text, c in terms.items()]
    flow = [RelationTerm(Product(None, parse_term(f"D*P*{text}", scope)), c) for text, c in terms.items()]
    rate = RelationTerm(Product(None, parse_term("S", scope)), -1.7)
    found = list(_rates(Relation((*left, *flow, rate)), "P_dot", {"below_P"}, {"S": least, "P": 0.2, "D": 0.0}))
    assert [text for text, _ in found] == (["S/(1 + below_P_2*P + below_S*S)"] if several else [])
    for _, spans in found:
        assert spans["below_S"] == pytest.approx((1.6 / 1.3, 1.6 * 1.3))


def test_a_rate_with_one_amount_below_it_saturates_as_chemists_write_it():
    scope = Scope.of(["S", "P", "D"])
    left = [RelationTerm(Product("P_dot", parse_term(text, scope)), c) for text, c in {"1": 1.0, "S": 1.6}.items()]
    rate = RelationTerm(Product(None, parse_term("S", scope)), -1.7)
    ((text, spans),) = _rates(Relation((*left, rate)), "P_dot", {"half_P"}, {"S": 0.1, "P": 0.2, "D": 0.0})
    assert text == "S/(half_S + S)"
    assert spans == {"half_S": pytest.approx((1.0 / 1.6 / 1.3, 1.3 / 1.6))}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_rate_that_the_product_inhibits_is_one_in_both_balances(seed):
    model = identify(msgspec.structs.replace(STUDY, library=Candidates()), reactor(seed)).model
    constants = {p.name: p for p in model.parameters}
    for name, truth in (("below_P", 0.7 / 0.64), ("below_S", 1.0 / 0.64)):
        assert constants[name].value == pytest.approx(truth, rel=0.02)
    substrate, product = model.relations
    assert [len(substrate.terms), len(product.terms)] == [4, 3]
    rates = [next(t.coefficient for t in r.terms if "/" in t.text or "**-1" in t.text) for r in (substrate, product)]
    assert np.abs(rates) == pytest.approx([1.1 / 0.64] * 2, rel=0.02)
    assert rates[0] == pytest.approx(-rates[1], rel=0.005)
