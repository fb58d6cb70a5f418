"""Angles of order 1: sines of differences where phases pull at each other, products where a path in space has them."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.errors import InputError
from odescope.pipeline.identification import identify
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study

PHASE, PLACE = Measured(angle=True), Measured()


def log(rates, start, seconds, samples, inputs=None, seed=0):
    """A log of all states with .3 % of noise, and of the inputs."""
    t = np.linspace(0.0, seconds, samples)
    x = solve_ivp(rates, (0.0, seconds), start, t_eval=t, rtol=1e-9, atol=1e-10).y
    x += 0.003 * x.std(axis=1, keepdims=True) * np.random.default_rng(seed).standard_normal(x.shape)
    return {"t": t, **dict(zip("abc", x, strict=False)), **{n: of(t) for n, of in (inputs or {}).items()}}


def found(coordinates, logs, inputs=(), **options):
    study = Study(
        data=Data(time="t"),
        coordinates=coordinates,
        inputs={name: Driven() for name in inputs},
        library=Candidates(**options),
    )
    relations = identify(study, logs).model.relations
    laws = ({t.text: -t.coefficient for t in r.terms if not t.product.bare} for r in relations)
    return dict(zip((f"{name}_dot" for name in coordinates), laws, strict=True))


def three(_, x, k=0.5, rates=(1.0, 1.7, 0.4)):
    return [w + k * sum(np.sin(other - own) for other in x) for w, own in zip(rates, x, strict=True)]


def test_two_phases_pull_at_each_other_by_their_difference():
    def two(_, x):
        return [1.0 + 0.5 * np.sin(x[1] - x[0]), 2.7 + 0.4 * np.sin(x[0] - x[1])]

    law = found({"a": PHASE, "b": PHASE}, [log(two, start, 30.0, 1500) for start in ([0.3, -1.0], [2.0, 0.5])])
    assert {target: set(terms) for target, terms in law.items()} == {
        "a_dot": {"1", "sin(a - b)"},
        "b_dot": {"1", "sin(a - b)"},
    }
    assert law["a_dot"]["sin(a - b)"] == pytest.approx(-0.5, rel=0.02)
    assert law["b_dot"]["sin(a - b)"] == pytest.approx(0.4, rel=0.02)


def test_a_climb_on_a_heading_stays_a_product():
    def climb(t):
        return 0.5 * np.cos(0.8 * t) + 0.3 * np.cos(1.9 * t)

    def turn(t):
        return np.sin(0.5 * t) + 0.4

    def path(t, x):
        return [np.cos(x[1]) * np.sin(x[2]), climb(t), turn(t)]

    logs = [log(path, s, 20.0, 1000, {"q": climb, "w": turn}, k) for k, s in enumerate(([0, 0.2, 0], [1, -0.3, 2]))]
    law = found({"a": PLACE, "b": PHASE, "c": PHASE}, logs, ("q", "w"))
    assert {target: set(terms) for target, terms in law.items()} == {
        "a_dot": {"cos(b)*sin(c)"},
        "b_dot": {"q"},
        "c_dot": {"w"},
    }


@pytest.mark.slow
def test_three_phases_that_lock():
    starts = ([2.5, -2.0, 0.3], [-1.0, 1.5, 3.0])
    law = found(dict.fromkeys("abc", PHASE), [log(three, s, 30.0, 1500, seed=k) for k, s in enumerate(starts)])
    assert {target: set(terms) for target, terms in law.items()} == {
        "a_dot": {"1", "sin(a - b)", "sin(a - c)"},
        "b_dot": {"1", "sin(a - b)", "sin(b - c)"},
        "c_dot": {"1", "sin(a - c)", "sin(b - c)"},
    }


def test_sums_are_for_the_default_library():
    with pytest.raises(InputError, match=r"name sin\(a - b\) in yours"):
        Candidates(sums=True, basis=("sin(a)", "sin(b)"))
