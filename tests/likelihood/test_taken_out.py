"""Terms that stand outside of a fraction: a feed beside a rate that saturates."""

import numpy as np
import pytest
from reactors import STUDY, reactor
from scipy.optimize import minimize

from odescope.likelihood.taken_out import _projected, _Proportion
from odescope.pipeline.identification import identify


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_what_flows_out_stands_beside_the_rate(seed):
    _, equation = identify(STUDY, reactor(seed)).model.equations
    assert {t.text: c for c, t in equation.outside.parts} == pytest.approx({"D*P": -1.0}, rel=0.002)
    assert {t.text: c for c, t in equation.numerator.parts} == pytest.approx({"S": 1.1 / 0.64}, rel=0.02)
    truth = {"1": 1.0, "P": 0.7 / 0.64, "S": 1.0 / 0.64}
    assert {t.text: c for c, t in equation.denominator.parts} == pytest.approx(truth, rel=0.02)


def test_the_nearest_coefficients_in_proportion_are_those_of_least_distance():
    rng = np.random.default_rng(0)
    theta = np.array([1.0, 1.0, 1.57, 1.56, 0.69, 0.71])
    free = np.arange(1, 6)  # the first is held
    root = 0.02 * rng.standard_normal((5, 5))
    covariance = root @ root.T + 1e-5 * np.eye(5)
    proportions = [_Proportion(1, 0, 2, 3), _Proportion(1, 0, 4, 5)]
    found, narrowed, cost = _projected(theta, free, covariance, proportions)
    weights = np.linalg.inv(covariance)

    def distance(z):
        return (z - theta[free]) @ weights @ (z - theta[free])

    ties = [{"type": "eq", "fun": lambda z, i=i, b=b: z[0] * z[b] - z[i]} for i, b in ((1, 2), (3, 4))]
    best = minimize(distance, theta[free], constraints=ties, options={"ftol": 1e-15, "maxiter": 500})
    assert found[free] == pytest.approx(best.x, rel=1e-6)
    assert cost == pytest.approx(best.fun, rel=1e-6)
    assert np.all(np.diag(narrowed) <= np.diag(covariance))
    assert np.linalg.matrix_rank(narrowed, tol=1e-10) == 3
