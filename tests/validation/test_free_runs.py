"""Free runs from the start of recordings: at rest, with late inputs, of very many or very long ones."""

from dataclasses import replace

import numpy as np
import pytest

from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.driven_record import DrivenRecord
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.record import Record, Records
from odescope.validation import free_runs as tested
from odescope.validation.free_runs import free_run_score, free_runs, growth
from odescope.validation.validate import MANY, validate

NOISE, PERIOD = 0.01, 0.02


def tank(delay=0.0, decay=0.5):
    """x' = u(t - delay) - decay x."""
    scope = Scope.of(("x", "u"))
    terms = [RelationTerm(Product("x_dot"), 1.0)]
    terms += [RelationTerm(Product(None, parse_term(t, scope)), c) for t, c in (("u", -1.0), ("x", decay))]
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


def test_how_errors_grow_is_told_of_runs_that_part():
    """Of a wrong model in closed form: a start off by e is off by e exp(-decay t) after t."""
    (true,) = scored(tank(), [record(0, 500)])
    assert true.growth is None
    (damped,) = scored(tank(decay=5.0), [record(0, 500)])
    assert not damped.stays
    assert damped.growth == pytest.approx(1.0)  # it is nowhere further off than at its start
    unstable = tank(decay=-0.5)
    (runs_away,) = free_runs(unstable, Records.of([record(0, 500)]))
    assert growth(unstable, runs_away, 8.0) == pytest.approx(np.exp(0.5 * 8.0), rel=1e-3)
    falls = tank(decay=-40.0)
    (lost,) = scored(falls, [record(0, 500)])
    assert lost.ended
    assert lost.growth == pytest.approx(np.exp(40.0 * lost.valid_time), rel=1e-3)


def test_of_very_many_some_are_run_and_of_long_ones_the_first_part(monkeypatch):
    monkeypatch.setattr(tested, "MOST_RECORDINGS", 3)
    monkeypatch.setattr(tested, "MOST_SAMPLES", 600)
    found = scored(tank(), [record(k, 400) for k in range(7)])
    assert [score.recording for score in found] == [1, 4, 7]
    assert all(score.duration == pytest.approx(199 * PERIOD) for score in found)
    assert all(score.recorded == pytest.approx(399 * PERIOD) for score in found)


@pytest.mark.parametrize("delay", [1.96, -1.0])
def test_a_run_that_starts_within_a_recording_has_what_was_recorded_around_it(delay):
    """Pieces of two seconds: of a late input one sample was left to compare with; an early one stood still."""
    log = record(0, 2000, delay=delay)
    wrong, counts = tank(delay, decay=5.0), np.ones((2000, 2))
    counts[log.t > log.t[-1] + delay, 0] = 0.0  # there the log itself does not hold what acts
    log = replace(log, counts=counts)
    (good,), (bad,) = ([r for r in validate(m, log).rows if r.prediction == MANY] for m in (tank(delay), wrong))
    assert good.rmse == pytest.approx(NOISE, rel=0.15)
    assert good.valid_time == good.duration
    assert good.fit > 95.0
    assert bad.rmse > 5.0 * NOISE


def test_only_the_begin_of_a_recording_is_left_out_for_a_late_input():
    log = record(0, 2000, delay=1.0)
    whole = DrivenRecord.of(tank(1.0), log)
    assert whole.known == pytest.approx(1.0 / PERIOD, abs=1)
    assert whole.part(20, 100).known == whole.known - 20
    assert whole.part(100, 200).known == 0
    compared = whole.compared(tank(1.0)).counted("x")
    assert np.array_equal(compared == 0.0, np.arange(2000) < whole.known)
    piece = whole.part(100, 200).driven
    acts = np.interp(piece.t, log.t + 1.0, log.column("u"))
    np.testing.assert_allclose(piece.begin[:, 0], acts[:-1], rtol=0, atol=1e-12)
    assert piece.sample[piece.sample >= 0].tolist() == list(range(100))
