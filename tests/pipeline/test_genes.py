"""Two genes that repress each other, and their products, which noise takes below zero."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

STUDY = Study(
    data=Data(time="t"),
    coordinates={"x": Measured(), "y": Measured()},
    inputs={"u": Driven(hold="zero"), "w": Driven(hold="zero")},
)


def log(rng, names, rates, start, steps, step, noise):
    """Return what is read of rates of states under inputs (i, N) that stay from sample to sample, by names of both."""
    t = step * np.arange(steps.shape[1])

    def rate(now, z):
        return rates(z, steps[:, min(int(now / step + 1e-9), len(t) - 1)])

    z = solve_ivp(rate, (0.0, t[-1]), start, t_eval=t, rtol=1e-8, atol=1e-10, max_step=0.5 * step).y
    read = z + noise * z.std(axis=1, keepdims=True) * rng.standard_normal(z.shape)
    return dict(zip(f"t{names}", (t, *read, *steps), strict=True))


def toggle(seed):
    """Return a log of x' = u + 8/(1 + y**3) - x, y' = w + 6/(1 + x**2) - 0.8 y."""
    rng = np.random.default_rng(seed)
    steps = np.repeat(rng.exponential(1.0, (2, 30)) * (rng.random((2, 30)) < 0.5), 50, axis=1)

    def rates(z, made):
        (x, y), (u, w) = z, made
        return [u + 8.0 / (1.0 + y**3) - x, w + 6.0 / (1.0 + x**2) - 0.8 * y]

    return log(rng, "xyuw", rates, [4.0, 1.0], steps, 0.1, 0.02)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_what_noise_takes_below_zero_has_the_rates_of_hill(seed):
    read = toggle(seed)
    assert min(read["x"].min(), read["y"].min()) < 0.0
    model = identify(STUDY, read).model
    x, y = ({t.text: t for t in r.terms} for r in model.relations)
    assert max(len(x), len(y)) <= 5  # what represses, or a constant less what activates
    assert {"x_dot", "x", "u"} <= set(x)
    assert {"y_dot", "y", "w"} <= set(y)
    for terms, name, value in ((x, "x", 1.0), (x, "u", -1.0), (y, "y", 0.8), (y, "w", -1.0)):
        assert abs(terms[name].coefficient - value) < 4.0 * terms[name].std_error
    orders = {p.name: p for p in model.parameters if p.name.startswith("order")}
    for name, value in {"order_y": 3.0, "order_x": 2.0}.items():
        assert abs(orders[name].value - value) < 4.0 * orders[name].std_error


def induced(seed):
    """Return a log of x' = 0.1 + 3 u/(1 + y**2) - x, y' = 3 w/(1 + x**3) - 0.8 y."""
    rng = np.random.default_rng(seed)
    steps = np.array([np.repeat(rng.uniform(0.3, 3.0, 1200 // n), n) for n in (60, 80)])

    def rates(z, made):
        (x, y), (u, w) = z, made
        return [0.1 + 3.0 * u / (1.0 + y**2) - x, 3.0 * w / (1.0 + x**3) - 0.8 * y]

    return log(rng, "xyuw", rates, [1.0, 1.0], steps, 0.1, 0.01)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_an_inducer_multiplies_the_rate_of_its_gene(seed):
    model = identify(STUDY, induced(seed)).model
    x, y = model.relations
    assert len(x.terms) <= 5
    assert len(y.terms) <= 4
    orders = {p.name: p for p in model.parameters if p.name.startswith("order")}
    for name, value in {"order_y": 2.0, "order_x": 3.0}.items():
        assert abs(orders[name].value - value) < 4.0 * orders[name].std_error


def quorum(seed):
    """Return a log of A' = 0.2 + 5 A**4/(81 + A**4) - 1.6 A + u, G' = 3 A**2/(4 + A**2) - 0.5 G."""
    rng = np.random.default_rng(seed)
    steps = np.repeat(rng.exponential(1.5, 50) * (rng.random(50) < 0.5), 50)[None]

    def rates(z, made):
        (A, G), (u,) = z, made
        return [0.2 + 5.0 * A**4 / (81.0 + A**4) - 1.6 * A + u, 3.0 * A**2 / (4.0 + A**2) - 0.5 * G]

    return log(rng, "AGu", rates, [0.3, 0.3], steps, 0.1, 0.015)


ONE_BY_ONE = pytest.mark.xfail(strict=True, reason="quotients in all three balances: no function alone is nearer")
LOST = pytest.mark.xfail(strict=True, reason="the rate of G, a logistic function and powers imitate that of A")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [pytest.param(0, marks=LOST), 1, 2])
def test_two_relations_have_functions_of_one_variable_with_constants_of_their_own(seed):
    study = Study(
        data=Data(time="t"), coordinates={"A": Measured(), "G": Measured()}, inputs={"u": Driven(hold="zero")}
    )
    model = identify(study, quorum(seed)).model
    made = {t.text: t for t in model.relations[0].terms}
    assert len(made) == 5
    assert {"A_dot", "1", "A", "u"} <= set(made)
    orders = [p for p in model.parameters if p.name.startswith("order")]
    order = max(orders, key=lambda p: p.value)
    assert abs(order.value - 4.0) < 4.0 * order.std_error


def ring(seed):
    """Return a log of x' = u + 4/(0.66 + z**3) - 0.6 x, with y' by x and z' by y alike: a ring of three genes."""
    rng = np.random.default_rng(seed)
    steps = np.repeat(rng.exponential(1.0, 40) * (rng.random(40) < 0.5), 50)[None]

    def rates(s, made):
        (x, y, z), (u,) = s, made
        return [u + 4.0 / (0.66 + z**3) - 0.6 * x, 3.7 / (0.66 + x**3) - 0.5 * y, 4.5 / (0.66 + y**3) - 0.7 * z]

    return log(rng, "xyzu", rates, [3.0, 1.0, 0.5], steps, 0.08, 0.005)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=ONE_BY_ONE), pytest.param(2, marks=ONE_BY_ONE)])
def test_three_genes_in_a_ring_repress_each_other(seed):
    coordinates = {name: Measured() for name in "xyz"}
    model = identify(
        Study(data=Data(time="t"), coordinates=coordinates, inputs={"u": Driven(hold="zero")}), ring(seed)
    ).model
    assert [len(r.terms) for r in model.relations] == [4, 3, 3]
    orders = [p for p in model.parameters if p.name.startswith("order")]
    assert len(orders) == 3
    assert all(abs(p.value - 3.0) < 4.0 * p.std_error for p in orders)
