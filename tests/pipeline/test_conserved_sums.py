"""One batch, whose totals stay: several laws say the same of it, and the shortest is given."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope import Data, Measured, Study, identify


def second_order(t, x):
    """Return the rates of A + B -> C."""
    rate = 0.8 * x[0] * x[1]
    return -rate, -rate, rate


def epidemic(t, x):
    """Return the rates of S + I -> 2 I, I -> R."""
    caught, healed = 0.9 * x[0] * x[1], 0.3 * x[1]
    return -caught, caught - healed, healed


def enzyme(t, x):
    """Return the rates of E + S <-> C -> E + P."""
    bound, freed, done = 2.0 * x[0] * x[1], 0.3 * x[2], 0.7 * x[2]
    return freed + done - bound, freed - bound, bound - freed - done, done


LAWS = {
    "second order": (second_order, "ABC", (1.0, 0.7, 0.0), 6.0, [{"A*B"}, {"A*B"}, {"A*B"}]),
    "epidemic": (epidemic, "SIR", (0.95, 0.05, 0.0), 20.0, [{"I*S"}, {"I", "I*S"}, {"I"}]),
    "enzyme": (enzyme, "ESCP", (0.5, 1.0, 0.0, 0.0), 12.0, [{"C", "E*S"}, {"C", "E*S"}, {"C", "E*S"}, {"C"}]),
}


@pytest.mark.parametrize(
    ("name", "noise"), [("second order", 0.0), ("enzyme", 0.0), ("epidemic", 0.01), ("second order", 0.01)]
)
def test_of_laws_that_say_the_same_the_shortest_is_given(name, noise):
    rates, names, x0, duration, law = LAWS[name]
    t, rng = np.linspace(0.0, duration, 200), np.random.default_rng(0)
    run = solve_ivp(rates, (0.0, duration), x0, t_eval=t, rtol=1e-9, atol=1e-12).y
    run = run + noise * run.std(axis=1)[:, None] * rng.standard_normal(run.shape)
    study = Study(data=Data(time="t"), coordinates={n: Measured(order=1) for n in names})
    result = identify(study, {"t": t} | dict(zip(names, run, strict=True)))
    terms = [{q.text for q in r.terms} - {f"{n}_dot"} for r, n in zip(result.model.relations, names, strict=True)]
    assert terms == law
    assert any("have one value, several laws say the same" in note for note in result.notes) or name == "epidemic"
