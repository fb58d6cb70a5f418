"""One reaction in two balances: its rate, found in one of them, is that of the other."""

import msgspec
import numpy as np
import pytest
from reactors import STUDY, reactor

from odescope.pipeline.identification import identify
from odescope.study.options import Candidates


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
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
