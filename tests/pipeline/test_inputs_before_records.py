"""Inputs that act late, and were others before the record began: nobody wrote what acted in its first moments."""

from itertools import product

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope import Data, Driven, Measured, Study, identify

PERIOD, SAMPLES, NOISE = 0.1, 1500, 0.01
LAWS = {
    "lag": (lambda x, u: [1.5 * u - 0.5 * x[0]], ("x",), {"x_dot": {"x", "u"}}),
    "square": (lambda x, u: [u - 0.4 * x[0] ** 2], ("x",), {"x_dot": {"x**2", "u"}}),
    "two": (
        lambda x, u: [0.8 * u - 0.4 * (x[0] - x[1]), 0.3 * (x[0] - x[1]) - 0.2 * x[1]],
        ("x", "z"),
        {"x_dot": {"x", "z", "u"}, "z_dot": {"x", "z"}},
    ),
    "spring": (lambda x, u: [x[1], 2.0 * u - 4.0 * x[0] - 0.6 * x[1]], ("x",), {"x_ddot": {"x", "x_dot", "u"}}),
}


def log(law, late, seed):
    """Return a log at rest under no input, which then steps: what acts does so `late` samples after it was recorded."""
    rate, names, _ = LAWS[law]
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.2, 2.2, SAMPLES // 25), 25)
    acting = np.r_[np.zeros(late), u[:-late]]
    states = [np.zeros(2 if law in ("two", "spring") else 1)]
    for now in acting[:-1]:
        run = solve_ivp(lambda _, x, now=now: rate(x, now), (0.0, PERIOD), states[-1], rtol=1e-9, atol=1e-10)
        states.append(run.y[:, -1])
    read = np.array(states)[:, : len(names)]
    read = read + NOISE * read.std(axis=0) * rng.standard_normal(read.shape)
    return {"t": PERIOD * np.arange(SAMPLES), "u": u, **dict(zip(names, read.T, strict=True))}


def check(law, late, seed):
    _, names, terms = LAWS[law]
    coordinates = {n: Measured(order=2 if law == "spring" else 1) for n in names}
    study = Study(data=Data(time="t"), coordinates=coordinates, inputs={"u": Driven(hold="zero")})
    result = identify(study, log(law, late, seed))
    model = result.model
    found = {t: {(term.factor, term.term.text) for term in r.terms} for r in model.relations for t in r.targets}
    assert found == {t: {(t, "1"), *((None, text) for text in right)} for t, right in terms.items()}
    assert model.inputs[0].delay == pytest.approx(PERIOD * late, abs=0.05 * PERIOD)
    assert model.scores.likelihood.unknown == pytest.approx(late / SAMPLES, abs=1.01 / SAMPLES)
    assert any("of the record does not count: inputs that act late" in note for note in result.notes)


@pytest.mark.parametrize("late", [3, 9])
def test_the_law_is_found_though_another_input_acted_at_first(late):
    check("lag", late, late)


@pytest.mark.slow
@pytest.mark.parametrize(("law", "late", "seed"), list(product(LAWS, (3, 9), range(3))))
def test_laws_are_found_though_another_input_acted_at_first(law, late, seed):
    check(law, late, seed)
