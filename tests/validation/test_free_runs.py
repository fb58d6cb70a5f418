"""Free runs from the start of recordings: at rest, with late inputs, of very many or very long ones."""

import numpy as np
import pytest

from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.record import Record, Records
from odescope.validation import free_runs as tested
from odescope.validation.free_runs import free_run_score, free_runs

NOISE, PERIOD = 0.01, 0.02


def tank(delay=0.0):
    """x' = u(t - delay) - 0.5 x."""
    scope = Scope.of(("x", "u"))
    terms = [RelationTerm(Product("x_dot"), 1.0)]
    terms += [RelationTerm(Product(None, parse_term(t, scope)), c) for t, c in (("u", -1.0), ("x", 0.5))]
    return Model((Coordinate("x", 1),), (Input("u", delay=delay),), (Relation(tuple(terms)),))


def level(t, begin, delay=0.0):
    """Response to u = sin 2 t, begun before the record did, in closed form."""
    s = t - delay
    return begin * np.exp(-0.5 * t) + (0.5 * np.sin(2.0 * s) - 2.0 * np.cos(2.0 * s)) / 4.25


def record(seed, count, begin=1.0, delay=0.0, still=False):
    t = PERIOD * np.arange(count)
    rng = np.random.default_rng(seed)
    clean = np.zeros(count) if still else level(t, begin, delay)
    u = np.zeros(count) if still else np.sin(2.0 * t)
    return Record(t, np.column_stack([clean + NOISE * rng.standard_normal(count), u]), ("x", "u"), (None, None))


def scored(model, records, noise=NOISE):
    records = Records.of(records)
    runs = free_runs(model, records)
    return [free_run_score(model, of, {"x": noise}, records.runs[of.number - 1].duration) for of in runs]


def test_a_true_model_stays_with_every_recording_from_its_start():
    for score in scored(tank(), [record(k, 500, begin=k) for k in range(3)]):
        assert score.stays
        assert score.duration == pytest.approx(499 * PERIOD)
        assert score.coordinates["x"].rmse == pytest.approx(NOISE, rel=0.15)


def test_at_rest_the_noise_is_all_there_is_to_predict():
    """A fit in per cent of noise is none; the run stays all the same, but not where the noise is not known."""
    (score,) = scored(tank(), [record(0, 500, still=True)])
    assert score.stays
    assert abs(score.coordinates["x"].fit) < 5.0
    (unknown,) = scored(tank(), [record(0, 500, still=True)], noise=0.0)
    assert not unknown.stays


def test_what_acted_before_the_record_began_is_not_held_against_the_model():
    """The input is late by a second: what it did in the second before the record is not known."""
    (score,) = scored(tank(delay=1.0), [record(0, 1000, delay=1.0)])
    assert score.stays
    assert score.coordinates["x"].rmse == pytest.approx(NOISE, rel=0.15)


def test_of_very_many_some_are_run_and_of_long_ones_the_first_part(monkeypatch):
    monkeypatch.setattr(tested, "MOST_RECORDINGS", 3)
    monkeypatch.setattr(tested, "MOST_SAMPLES", 600)
    found = scored(tank(), [record(k, 400) for k in range(7)])
    assert [score.recording for score in found] == [1, 4, 7]
    assert all(score.duration == pytest.approx(199 * PERIOD) for score in found)
    assert all(score.recorded == pytest.approx(399 * PERIOD) for score in found)
