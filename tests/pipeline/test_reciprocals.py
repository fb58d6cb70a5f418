"""Laws with several powers of a reciprocal, which quotients of the default library imitate."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.library.readable import readable
from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study


def bubble(seed):
    """Return a log of Rayleigh and Plesset's R R'' + 1.5 R'**2 = (100 (20/R)**3 - 100 - p) - 16 R'/R."""
    rng, t = np.random.default_rng(seed), 0.05 * np.arange(2400)
    rates, phases = rng.uniform(0.1, 1.2, 4), rng.uniform(0.0, 2.0 * np.pi, 4)

    def p(now):
        return 12.0 * np.sin(np.multiply.outer(now, rates) + phases).sum(axis=-1)

    def rate(now, z):
        R, v = z
        return [v, ((100.0 * (20.0 / R) ** 3 - 100.0 - p(now)) - 16.0 * v / R - 1.5 * v**2) / R]

    z = solve_ivp(rate, (0.0, t[-1]), [21.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-10).y
    return {"t": t, "R": z[0] + 0.003 * z[0].std() * rng.standard_normal(len(t)), "p": p(t)}


def radius(seed):
    """Return a log of r'' = 1/r**3 - 1.1/r**2 - 0.02 r' + u: what goes round in space, and is pushed outwards."""
    rng, t = np.random.default_rng(seed), 0.05 * np.arange(2400)
    u = np.repeat(rng.uniform(-0.08, 0.08, 60), 40)

    def rate(now, z):
        r, v = z
        return [v, r**-3 - 1.1 * r**-2 - 0.02 * v + u[min(int(now / 0.05 + 1e-9), len(t) - 1)]]

    z = solve_ivp(rate, (0.0, t[-1]), [0.75, 0.0], t_eval=t, rtol=1e-9, atol=1e-10, max_step=0.05).y
    return {"t": t, "r": z[0] + 0.003 * z[0].std() * rng.standard_normal(len(t)), "u": u}


LAWS = {
    "bubble": (
        bubble,
        "R",
        {"p": Driven()},
        {"1/R": 100.0, "p/R": 1.0, "R_dot/R**2": 16.0, "R_dot**2/R": 1.5, "1/R**4": -8e5},
    ),
    "radius": (radius, "r", {"u": Driven(hold="zero")}, {"1/r**3": -1.0, "1/r**2": 1.1, "r_dot": 0.02, "u": -1.0}),
}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("name", LAWS)
def test_powers_of_a_reciprocal_are_found(name, seed):
    logged, coordinate, inputs, law = LAWS[name]
    study = Study(data=Data(time="t"), coordinates={coordinate: Measured(order=2)}, inputs=inputs)
    (relation,) = identify(study, logged(seed)).model.relations
    found = {readable(t.term) if t.factor is None else t.text: t for t in relation.terms}
    assert set(found) == {f"{coordinate}_ddot", *law}
    for text, value in law.items():
        assert abs(found[text].coefficient - value) < 4.0 * found[text].std_error
