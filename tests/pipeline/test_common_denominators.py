"""One denominator in several balances: what lives in a reactor that is filled, and what it lives on."""

import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.relation import Relation, RelationTerm
from odescope.pipeline.common_denominators import _few
from odescope.pipeline.identification import identify
from odescope.pipeline.joint_models import without_common_reciprocal
from odescope.study.options import Data, Driven, Measured, Study

END, PERIOD, NOISE, FED = 40.0, 0.025, 0.005, 20.0


def filled(seed):
    """Return two recordings of a fed batch: growth by Monod's law, and a feed that dilutes."""
    rng, t, logs = np.random.default_rng(seed), np.arange(0.0, END, PERIOD), []
    levels = rng.uniform(0.0, 0.15, (2, 8))
    for own, sugar in zip(levels, rng.uniform(4.0, 8.0, 2), strict=True):

        def rate(now, x, own=own):
            feed, growth = own[min(int(now / 6.0), 7)], 0.4 * x[1] / (0.8 + x[1]) * x[0]
            return growth - feed * x[0] / x[2], -2.0 * growth + feed * (FED - x[1]) / x[2], feed

        x = solve_ivp(rate, (0.0, END), [0.5, sugar, 1.0], t_eval=t, rtol=1e-9, atol=1e-11, max_step=PERIOD).y
        read = x + NOISE * x.std(axis=1, keepdims=True) * rng.standard_normal(x.shape)
        logs.append({"t": t, **dict(zip("XSV", read, strict=True)), "F": own[(t / 6.0).astype(int)]})
    return logs


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_balances_of_a_fed_batch_are_divided_by_the_same(seed):
    """Without the denominator of the other the substrate had a fraction of seventeen terms in three of three."""
    study = Study(data=Data(time="t"), coordinates={n: Measured() for n in "XSV"}, inputs={"F": Driven()})
    relations = identify(study, filled(seed)).model.relations
    held = [{re.sub(r"\(.* \+ S\)", "(K + S)", t.product.text) for t in r.terms} for r in relations]
    assert held in (
        [
            {"X_dot*V", "X_dot*S*V", "S*V*X", "F*X", "F*S*X"},
            {"S_dot*V", "S_dot*S*V", "S*V*X", "F", "F*S", "F*S**2"},
            {"V_dot", "F"},
        ],
        [
            {"X_dot*V", "S*V*X*(K + S)**-1", "F*X"},
            {"S_dot*V", "S*V*X*(K + S)**-1", "F", "F*S"},
            {"V_dot", "F"},
        ],
    )


@pytest.mark.parametrize("seed", range(8))
def test_few_columns_are_those_that_a_target_is_made_of_where_others_look_like_it(seed):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0.5, 4.0, (2, 400))
    columns = np.array([x**i * y**j for i in range(4) for j in range(4 - i)])
    law = dict(zip(rng.choice(len(columns), 3, replace=False).tolist(), rng.uniform(0.5, 2.0, 3), strict=True))
    sizes = np.sqrt(np.mean(columns**2, axis=1))
    target = sum(c / sizes[k] * columns[k] for k, c in law.items())
    found = _few(columns, target + 1e-4 * rng.standard_normal(400), 8)
    assert set(found) == set(law)
    assert all(found[k] == pytest.approx(c / sizes[k], rel=0.01) for k, c in law.items())


def test_of_a_target_that_no_columns_say_none_are_taken():
    columns, target = np.random.default_rng(0).standard_normal((2, 6, 400))
    assert _few(columns, target[0], 6) == {}


def test_what_divides_all_that_a_target_is_multiplied_by_is_multiplied_out():
    scope = Scope.of(["x", "y"])

    def relation(terms):
        return Relation(tuple(RelationTerm(Product(f, parse_term(text, scope)), c) for (f, text), c in terms.items()))

    divided = {("x_dot", "y/x"): 1.0, ("x_dot", "1/x"): 2.0, (None, "y"): -3.0, (None, "1/x"): 4.0}
    plain = {("x_dot", "y"): 1.0, ("x_dot", "1"): 2.0, (None, "x*y"): -3.0, (None, "1"): 4.0}
    assert without_common_reciprocal(relation(divided)) == relation(plain)
    partly = {("x_dot", "1"): 1.0, ("x_dot", "1/x"): 2.0, (None, "y"): -3.0}
    assert without_common_reciprocal(relation(partly)) == relation(partly)
