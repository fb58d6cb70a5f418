"""One rate in several balances: a function that one relation holds is tried in the others, with the same constants."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.library.expression import ONE, Name, Term
from odescope.library.product import Product
from odescope.likelihood.alternatives import _Work, alternative
from odescope.likelihood.imitation import Placed
from odescope.likelihood.standing import Standing
from odescope.likelihood.suspicion import Suspicion
from odescope.pipeline.identification import identify
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study

pytestmark = pytest.mark.slow

T = np.arange(0.0, 16.0, 0.1)
HALF = 0.6
IN_X = (Suspicion(0, "x", "powers", (ONE,), 3),)
BESIDE = ("u",), ("y",)
IN_BOTH = (*IN_X, Suspicion(1, "x", "powers", (ONE,), 3))


def recorded(start, seed):
    """Return a log of x' = u - r, y' = r - y / 2 with r = tanh(x / HALF), at 1 % noise."""
    rng = np.random.default_rng(seed)
    u = 0.5 + 0.5 * np.sin(0.9 * T + start[0]) * np.cos(0.23 * T)

    def rate(now, state):
        r = np.tanh(state[0] / HALF)
        return np.interp(now, T, u) - r, r - 0.5 * state[1]

    x, y = solve_ivp(rate, (T[0], T[-1]), start, t_eval=T, rtol=1e-9, atol=1e-11, max_step=0.2).y
    noise = 0.01 * rng.standard_normal((2, len(T)))
    return {"t": T, "x": x + x.std() * noise[0], "y": y + y.std() * noise[1], "u": u}


@pytest.fixture(scope="module")
def refinement():
    study = Study(
        data=Data(time="t"),
        coordinates={"x": Measured(), "y": Measured()},
        inputs={"u": Driven(hold="linear")},
        library=Candidates(terms=("1", "x", "x**2", "x**3", "y", "u", "x_dot", "y_dot"), suspect=False),
    )
    return identify(study, [recorded((1.5, 0.1), 0), recorded((0.2, 1.0), 1)]).refinement


def terms(space, theta, relation):
    """Return coefficients of a relation by term."""
    parts = ((p, theta[k]) for k in np.flatnonzero(theta) for p in space.mechanisms[k].parts)
    return {p.product.text: value for p, value in parts if p.relation == relation}


def test_a_function_that_was_suspected_of_one_relation_is_found_in_another(refinement):
    plain = len(refinement.space.mechanisms)
    found = alternative(refinement, IN_X, plain, 5.0, {})
    assert {str(m) for m in found.mechanisms} == {
        "tanh(scale_x**-1*x) in x_dot",
        "tanh(scale_x**-1*x) in y_dot",
    }
    assert found.start.constants["scale_x"] == pytest.approx(HALF, rel=0.05)
    assert np.abs(found.start.coefficients[plain:]) == pytest.approx([1.0, 1.0], rel=0.05)
    assert "tanh(x/scale_x)" in found.tried[0]


def test_another_function_comes_in_all_relations_at_once(refinement):
    work = _Work.of(refinement, IN_BOTH, 5.0)
    theta = work.padded(refinement.fit.theta)
    before = replace(refinement.fit, theta=theta)
    saturation = next(c for c in work.choices[0] if "half_x" in c.terms[0].text)
    placed = tuple(Placed(saturation, {"half_x": HALF}) for _ in IN_BOTH)
    for relation in (0, 1):
        base = [work.number[relation, Product(None, Term(((Name(n), 1),)))] for n in BESIDE[relation]]
        imitated = work.imitated(relation, before, base, False)
        theta = work.written(relation, theta, base, placed[:1], imitated)
    standing = Standing(work.tightened(theta), placed, before)
    work, standing = work.pooled(standing)
    ended = work.together(standing)
    for relation in (0, 1):
        assert "tanh(scale_x**-1*x)" in terms(work.space, ended.fit.theta, relation)
    assert work.moves().penalised(ended.fit) < work.moves().penalised(standing.fit)


def test_a_product_of_two_functions_is_none_of_one_variable(refinement):
    work = _Work.of(refinement, IN_BOTH, 5.0)
    work = replace(work, families={"x": work.families["x"]})
    of_x = next(f for f in work.families["x"] if "scale_x" in f.term.names)
    beside = Term(((Name("y"), 1),))
    assert work.split(of_x.term * beside, "x") == (of_x, beside)
    constants = {**work.space.frame.constants, "rate_y": work.space.frame.constants["scale_x"]}
    other = replace(work, space=replace(work.space, frame=replace(work.space.frame, constants=constants)))
    assert other.split(of_x.term * Term(((Name("rate_y"), 1), (Name("y"), 1))), "x") is None
