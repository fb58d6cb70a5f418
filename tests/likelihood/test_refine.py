"""The stage from proposals to the model, against the maximum likelihood of the whole record found by SciPy."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares

from odescope.library.mechanism import candidates_of
from odescope.likelihood.refine import refine
from odescope.likelihood.search import LikelihoodSearch
from odescope.likelihood.settings import Start, Starts
from odescope.model.assembled import coefficients_of
from odescope.model.relation import Relation, RelationTerm
from odescope.pipeline.joint_models import forward
from odescope.recordings.readers import records_from
from odescope.regression.problem import pose
from odescope.signals.differentiators import Spectral
from odescope.signals.estimate import estimate_signals
from odescope.study.options import Data, Driven, Measured, Study

TRUTH = {"x_ddot": 1.0, "x": 4.0, "x_dot": 0.3, "u": -1.0}
NOISE = 0.02


STEP, COUNT = 0.02, 1500


def solved(stiffness, friction, gain, start, u, held):
    """Return the exact states of x'' = -stiffness x - friction x' - gain u, by one matrix exponential."""
    whole = np.zeros((4, 4))
    whole[0, 1], whole[1, :3], whole[2, 3] = 1.0, [-stiffness, -friction, -gain], 1.0
    power = expm(STEP * whole)
    rises = np.zeros(len(u)) if held else np.append(np.diff(u), 0.0) / STEP
    states = [np.array(start)]
    for now, rise in zip(u[:-1], rises, strict=False):
        states.append(power[:2, :2] @ states[-1] + power[:2, 2] * now + power[:2, 3] * rise)
    return np.array(states)


def oscillator(held, seed):
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(COUNT)
    if held:
        u = np.repeat(4.0 * rng.standard_normal(COUNT // 25), 25)
    else:
        u = 4 * np.sin(1.3 * t) + 3 * np.cos(2.9 * t + 1) + 2 * np.sin(4.3 * t + 2)
    x = solved(4.0, 0.3, -1.0, [1.0, 0.5], u, held)[:, 0]
    return {"t": t, "x": x + NOISE * rng.standard_normal(COUNT), "u": u}


def posed(held, seed):
    study = Study(
        data=Data(time="t"),
        coordinates={"x": Measured(order=2)},
        inputs={"u": Driven(hold="zero" if held else "linear")},
    )
    columns = oscillator(held, seed)
    records = records_from(columns, study.layout())
    coordinates, inputs = study.measured(), study.driven()
    signals = estimate_signals(
        records, coordinates, inputs, study.signals.differentiator, study.signals.margin, study.signals.decimate
    )
    problem = pose(signals, "x_ddot", 2, study.candidates("x_ddot"), study.regression.rows)
    return columns, records, signals, problem


def start(problem, coefficients):
    names = {t.text: k for k, t in enumerate(problem.terms)}
    terms = []
    for text, c in coefficients.items():
        k = names[text]
        terms.append(RelationTerm(problem.terms[k], c))
    return (Relation(tuple(terms)),)


def refined(held, coefficients, seed=2, budget=60.0):
    columns, records, signals, problem = posed(held, seed)
    mechanisms = candidates_of([problem.terms], signals.targets)
    begun, other = (coefficients_of(mechanisms, r) for r in (start(problem, coefficients), [forward(problem)]))
    options = LikelihoodSearch(budget=budget)
    starts = Starts([Start(begun), Start(other)], Start(begun))
    found = refine(records, signals, mechanisms, starts, Spectral(), options)
    return columns, signals, found


def whole_record(columns, held, sigma):
    """Return coefficients of x, x_dot, u and their standard errors, by exact solutions of the linear equation."""

    def error(z):
        return (solved(*z[:3], z[3:], columns["u"], held)[:, 0] - columns["x"]) / sigma

    found = least_squares(error, [4.0, 0.3, -1.0, 1.0, 0.5], "3-point", method="lm")
    return found.x[:3], np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))[:3]


STARTS = {
    "the truth": TRUTH,
    "a term dropped": {"x_ddot": 1.0, "x": 4.2, "u": -1.0},
    "a term invented": TRUTH | {"x**3": 0.05},
}


@pytest.mark.parametrize("held", [False, True], ids=["linear", "zero-hold"])
@pytest.mark.parametrize("name", STARTS)
def test_the_stage_ends_in_the_maximum_likelihood_of_the_whole_record(name, held):
    columns, signals, found = refined(held, STARTS[name])
    assert found is not None
    assert found.follows
    terms = {t.text: t for t in found.relations[0].terms}
    assert set(terms) == set(TRUTH)
    assert terms["x_ddot"].coefficient == 1.0
    assert terms["x_ddot"].std_error is None
    sigma = signals.channels[0].noise
    assert sigma == pytest.approx(NOISE, rel=0.1)
    estimate, errors = whole_record(columns, held, sigma)
    for text, value, error in zip(("x", "x_dot", "u"), estimate, errors, strict=True):
        # Averages of blocks lose next to nothing of what the samples say.
        assert abs(terms[text].coefficient - value) < 0.35 * error
        assert terms[text].std_error == pytest.approx(error * np.sqrt(found.outcome.scale), rel=0.06)
        assert abs(terms[text].coefficient - TRUTH[text]) < 4 * error


def test_the_stage_repeats_to_the_last_bit():
    one, two = (refined(False, STARTS["a term invented"])[2] for _ in range(2))
    assert one.relations == two.relations
    assert one.outcome.trail == two.outcome.trail


def test_a_start_with_a_pole_in_the_data_does_not_raise_or_warn():
    _, _, found = refined(False, TRUTH | {"x_ddot*x": -1.0 / np.quantile(oscillator(False, 2)["x"], 0.8)})
    assert found is not None  # the forward selection begins without it
    assert {t.text for t in found.relations[0].terms} == set(TRUTH)


def test_a_start_that_blows_up_does_not_raise_or_warn():
    _, _, found = refined(False, TRUTH | {"x": -1e9, "x_dot": -1e9})
    assert found is not None
    assert {t.text for t in found.relations[0].terms} == set(TRUTH)


def test_with_its_budget_spent_the_best_so_far_is_returned():
    _, _, found = refined(False, TRUTH, budget=1e-9)
    assert found is not None
    assert not found.finished
    assert not found.late
