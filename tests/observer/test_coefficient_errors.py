"""Models whose coefficients are only estimated: the standard deviations of states allow for it."""

from dataclasses import replace

import numpy as np
import pytest
from built_models import build
from observer_cases import PENDULUM, log, swing

from odescope.model.relation import Relation
from odescope.observer.coefficient_errors import noise_of_coefficients
from odescope.observer.estimate import estimate_states
from odescope.observer.run import ReadyRecord
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record


def estimated(model, error, rng=None):
    """The model with coefficients that are off by a share of about `error`, and say so."""
    relations = []
    for relation in model.relations:
        lead, *rest = relation.terms
        drawn = [1.0 + (0.0 if rng is None else error * rng.standard_normal()) for _ in rest]
        terms = [
            replace(t, coefficient=t.coefficient * f, std_error=error * abs(t.coefficient))
            for t, f in zip(rest, drawn, strict=True)
        ]
        relations.append(Relation((lead, *terms)))
    return replace(model, relations=tuple(relations))


def test_states_of_an_estimated_model_are_not_stated_too_sharply():
    """Against the same model taken for exact, whose error is many of its standard deviations."""
    ratios = {"stated": [], "exact": []}
    for seed in range(12):
        rng = np.random.default_rng(seed)
        t, states = swing(rng, 600)
        record = log(rng, t, states, 0.01)
        model = estimated(PENDULUM, 2e-3, rng)
        for name, process in (("stated", None), ("exact", {})):
            (run,) = estimate_states(model, record, {"phi": 0.01}, process, smooth=True).runs
            ratios[name].append(np.sqrt(np.mean(((run.states - states) / run.std)[run.settling :] ** 2)))
    assert np.mean(ratios["exact"]) > 2.0
    assert 0.3 < np.mean(ratios["stated"]) < 1.2


def test_the_density_is_that_of_a_closed_form():
    """x'' = -w^2 x with a standard error e of w^2: x'' is off by e x, root mean square e a / sqrt(2), memory 1 / w."""
    w, error, size = 3.0, 0.01, 0.7
    model = estimated(
        build([Coordinate("x", order=2)], [], [("x_ddot", "1", 2.0), (None, "x", 2.0 * w**2)]), error / w**2
    )
    t = 2.0 * np.pi / w * np.arange(1200) / 60.0
    x = size * np.cos(w * t) + 1e-6 * np.random.default_rng(0).standard_normal(len(t))
    found = noise_of_coefficients([ReadyRecord.of(model, Record(t, x[:, None], ("x",)))])
    assert found["x_ddot"] == pytest.approx(error * size / np.sqrt(2.0) / np.sqrt(w), rel=0.02)
    exact = noise_of_coefficients([ReadyRecord.of(estimated(model, 0.0), Record(t, x[:, None], ("x",)))])
    assert exact == {"x_ddot": 0.0}
