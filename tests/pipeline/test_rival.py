"""Laws without a bare target, in noise: where a search for them begins, and that they are found."""

from types import SimpleNamespace

import numpy as np
import pytest

from odescope import Driven, Measured, Study, identify
from odescope.pipeline.joint_models import forward, rival
from odescope.recordings.readers import records_from
from odescope.regression.problem import pose
from odescope.selection.ranking import criteria
from odescope.signals.estimate import estimate_signals
from odescope.study.library_options import Candidates
from odescope.study.options import Data

T = 0.01 * np.arange(3001)
LAW = {"q_ddot*sin(q)", "q_dot**2*cos(q)", "q_dot*sin(q)", "cos(q)", "u"}


def crank(seed, bare=False):
    """Return a log of q'' + .8 q' = 9 cos(q) - u, or of sin(q) q'' + cos(q) q'^2 + .8 sin(q) q' = 9 cos(q) - u.

    The motion is given, a few sines; the input is what it asks for.
    """
    rng = np.random.default_rng(seed)
    q, rate, rise = np.full_like(T, 1.57), np.zeros_like(T), np.zeros_like(T)
    for w in rng.uniform(0.8, 5.0, 5):
        size, phase = 0.7 / w, rng.uniform(0.0, 2.0 * np.pi)
        q, rate, rise = (
            q + size * np.sin(w * T + phase),
            rate + size * w * np.cos(w * T + phase),
            rise - size * w**2 * np.sin(w * T + phase),
        )
    if bare:
        u = 9.0 * np.cos(q) - rise - 0.8 * rate
    else:
        u = 9.0 * np.cos(q) - np.sin(q) * (rise + 0.8 * rate) - np.cos(q) * rate**2
    return {"t": T, "q": q + 0.01 * q.std() * rng.standard_normal(len(T)), "u": u}


def study():
    return Study(
        data=Data(time="t"),
        coordinates={"q": Measured(order=2, angle=True)},
        inputs={"u": Driven()},
        library=Candidates(form="relations"),
    )


def posed(log):
    """Return the regression problem of the acceleration."""
    it = study()
    records, coordinates, inputs = records_from(log, it.layout()), it.measured(), it.driven()
    signals = estimate_signals(
        records, coordinates, inputs, it.signals.differentiator, it.signals.margin, it.signals.decimate
    )
    return pose(signals, "q_ddot", 2, it.candidates("q_ddot"), it.regression.rows)


@pytest.mark.parametrize("seed", [0, 1, 4, 9])
def test_a_law_without_a_bare_target_has_a_rival_that_predicts_better_than_any_bare_selection(seed):
    problem = posed(crank(seed))
    found = rival(problem, ())
    assert {t.text for t in found.terms if t.factor} == {"q_ddot*sin(q)"}
    assert found.terms[0].coefficient == 1.0
    place = {term: j for j, term in enumerate(problem.terms)}
    both = [tuple(sorted(place[t.product] for t in r.terms)) for r in (found, forward(problem))]
    better, bare = criteria(problem, both)
    assert better < bare


@pytest.mark.parametrize("seed", [1, 4, 6, 8])
def test_where_regression_finds_a_law_with_a_bare_target_there_is_none(seed):
    found = identify(study(), crank(seed, bare=True))
    (search,) = found.searches
    assert rival(search.problem, search.ranked.candidates) is None
    assert {t.text for t in found.model.relations[0].terms} == {"q_ddot", "q_dot", "cos(q)", "u"}
    assert found.refinement.starts == 1


def test_there_is_none_where_regression_found_better():
    problem = posed(crank(0))
    alone = rival(problem, ())
    place = {term: j for j, term in enumerate(problem.terms)}
    (own,) = criteria(problem, [tuple(sorted(place[t.product] for t in alone.terms))])
    worse, better = (SimpleNamespace(criterion=own + d) for d in (1.0, -1.0))
    assert rival(problem, [worse]) == alone
    assert rival(problem, [worse, better]) is None


@pytest.mark.slow
def test_the_law_is_found_where_a_search_from_the_proposal_ends_clear_elsewhere():
    found = identify(study(), crank(9))
    (relation,) = found.model.relations
    assert {t.text for t in relation.terms} == LAW
    assert found.refinement.follows
    truth = {"q_ddot*sin(q)": 1.0, "q_dot**2*cos(q)": 1.0, "q_dot*sin(q)": 0.8, "cos(q)": -9.0, "u": 1.0}
    for term in relation.terms[1:]:
        assert abs(term.coefficient - truth[term.text]) < 4.0 * term.std_error
