"""States of simulated machines: what is stated of them holds, and what was assumed of them is judged rightly."""

from dataclasses import replace

import numpy as np
import pytest
from built_models import build
from observer_cases import PENDULUM, PERIOD, log, push, swing

from odescope.errors import InputError
from odescope.model.scores import Likelihood, ModelScores
from odescope.model.simulation import simulate
from odescope.observer.estimate import estimate_states
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.record import Record


def coverage(run, states, width=1.96):
    """Share of samples whose interval holds the truth, a state, once the start is forgotten."""
    inside = np.abs(run.states - states) <= width * run.std
    return inside[run.settling :].mean(axis=0)


@pytest.mark.parametrize("smooth", [False, True], ids=["filter", "smoother"])
@pytest.mark.parametrize(
    ("noise", "process"),
    [(0.2, 0.0), *(pytest.param(*n, marks=pytest.mark.slow) for n in ((0.01, 0.3), (0.01, 0.0), (0.2, 0.3)))],
)
def test_intervals_hold_the_truth_as_often_as_they_say(noise, process, smooth):
    """Without process noise all errors of a record go back to two numbers: it takes many records."""
    found = []
    for seed in range(12 if process else 60):
        rng = np.random.default_rng(seed)
        t, states = swing(rng, 300, process)
        estimates = estimate_states(PENDULUM, log(rng, t, states, noise), {"phi": noise}, {"phi_ddot": process}, smooth)
        found.append(coverage(estimates.runs[0], states))
    assert np.all(np.mean(found, axis=0) > 0.90)
    assert np.all(np.mean(found, axis=0) < 0.98)


def test_a_velocity_that_was_never_measured_is_known_better_than_by_differences():
    rng = np.random.default_rng(3)
    t, states = swing(rng, 1000, 0.3)
    record = log(rng, t, states, 0.02)
    errors = [np.gradient(record.column("phi"), PERIOD) - states[:, 1]]
    for smooth in (False, True):
        (run,) = estimate_states(PENDULUM, record, {"phi": 0.02}, {"phi_ddot": 0.3}, smooth).runs
        errors.append(run.column("phi_dot") - states[:, 1])
    difference, filtered, smoothed = (float(np.std(e[20:])) for e in errors)
    assert filtered < 0.2 * difference
    assert smoothed < 0.8 * filtered


def test_process_noise_is_found_from_the_innovations():
    rng = np.random.default_rng(0)
    runs = [swing(rng, 1000, 0.3) for _ in range(3)]
    records = [log(rng, t, states, 0.02) for t, states in runs]
    found = estimate_states(PENDULUM, records, {"phi": 0.02}, "fit")
    assert found.noise.process["phi_ddot"] == pytest.approx(0.3, rel=0.2)
    assert found.consistency.band[0] < found.consistency.squared < found.consistency.band[1]


def test_a_log_without_process_noise_is_not_given_any():
    rng = np.random.default_rng(1)
    t, states = swing(rng, 600)
    record = log(rng, t, states, 0.02)
    found = estimate_states(PENDULUM, record, {"phi": 0.02}, "fit")
    assert found.noise.process == {"phi_ddot": 0.0}
    assert found.consistency.consistent
    assert "none" in repr(found)


def test_a_model_that_does_not_follow_its_own_record_has_its_process_noise_fitted():
    scores = ModelScores(
        likelihood=Likelihood(
            follows=True,  # with the process noise that was found
            residual_variance=9.0,
            gap=None,
            finished=True,
            starts=1,
            process_noise={"phi_ddot": 0.5},
            trail=(),
            hints=(),
        )
    )
    model = replace(PENDULUM, scores=scores, provenance={"channels": {"phi": {"noise": 0.02, "cutoff_hz": 3.0}}})
    rng = np.random.default_rng(2)
    t, states = swing(rng, 800, 0.3)
    found = estimate_states(model, log(rng, t, states, 0.02))
    assert found.noise.measurement == {"phi": 0.02}
    assert found.noise.process["phi_ddot"] == pytest.approx(0.3, rel=0.3)


def test_what_a_model_without_process_noise_leaves_over_is_noise_of_the_sensors():
    left = Likelihood(
        follows=True,
        residual_variance=4.0,
        gap=0.0,
        finished=True,
        starts=1,
        process_noise=None,
        trail=(),
        hints=(),
    )
    provenance = {"channels": {"phi": {"noise": 0.01, "cutoff_hz": 3.0}}}
    model = replace(PENDULUM, scores=ModelScores(likelihood=left), provenance=provenance)
    rng = np.random.default_rng(7)
    t, states = swing(rng, 400)
    found = estimate_states(model, log(rng, t, states, 0.02))
    assert found.noise.measurement == {"phi": pytest.approx(0.02)}
    assert found.noise.process == {"phi_ddot": 0.0}
    assert found.consistency.squared == pytest.approx(1.0, abs=0.2)


def test_noise_that_is_wrong_and_a_model_that_is_wrong_are_told():
    rng = np.random.default_rng(4)
    t, states = swing(rng, 800)
    record = log(rng, t, states, 0.02)
    too_sure = estimate_states(PENDULUM, record, {"phi": 0.01}).consistency
    assert too_sure.squared == pytest.approx(4.0, rel=0.15)
    assert not too_sure.consistent
    assert too_sure.coordinates[0].white
    stiffer = build(
        PENDULUM.coordinates,
        PENDULUM.inputs,
        [("phi_ddot", "1", 1.0), (None, "sin(phi)", 12.0), (None, "u*cos(phi)", -2.0)],
    )
    wrong = estimate_states(stiffer, record, {"phi": 0.02}).consistency
    assert not wrong.coordinates[0].white
    assert wrong.squared > 10.0


def test_samples_that_are_missing_widen_the_intervals_and_change_nothing_else():
    rng = np.random.default_rng(5)
    t, states = swing(rng, 600, 0.3)
    counts = np.ones(600)
    counts[200:260] = 0.0
    record = log(rng, t, states, 0.02, counts)
    spoilt = record.values.copy()
    spoilt[200:260, 0] = 77.0  # what a filled-in value is must not matter
    found = [
        estimate_states(PENDULUM, replace(record, values=values), {"phi": 0.02}, {"phi_ddot": 0.3}).runs[0]
        for values in (record.values, spoilt)
    ]
    assert np.array_equal(found[0].std, found[1].std)
    np.testing.assert_allclose(found[0].states, found[1].states, atol=1e-6)
    assert np.all(np.isnan(found[0].innovations[200:260]))
    assert found[0].std[259, 0] > 3.0 * found[0].std[199, 0]
    assert np.abs(found[0].states - states)[200:260, 0].max() < 4.0 * found[0].std[259, 0]


def test_an_angle_may_be_wrapped():
    rng = np.random.default_rng(6)
    t = PERIOD * np.arange(400)
    states = simulate(PENDULUM, t, push(t)[:, None], np.array([0.5, 8.0])).states  # it turns over
    assert np.ptp(states[:, 0]) > 7.0
    record = log(rng, t, states, 0.02)
    plain = estimate_states(PENDULUM, record, {"phi": 0.02}).runs[0]
    turned = record.values.copy()
    turned[100:, 0] -= 2.0 * np.pi
    other = estimate_states(PENDULUM, replace(record, values=turned), {"phi": 0.02}).runs[0]
    np.testing.assert_allclose(other.innovations[100:], plain.innovations[100:], atol=1e-4)


def test_a_block_that_sticks_is_followed():
    """Dry friction: a block between a spring and a force rests for a sixth of the time."""
    block = build(
        [Coordinate("x", order=2)],
        [Input("u")],
        [
            ("x_ddot", "1", 1.0),
            (None, "x_dot", 0.3),
            (None, "sign(x_dot)", 2.0),
            (None, "x", 1.0),
            (None, "u", -1.0),
        ],
    )
    held, errors = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        t = 0.01 * np.arange(1200)
        u = 3.0 * np.sin(1.1 * t + seed) + 1.5 * np.sin(2.7 * t)
        states = simulate(block, t, u[:, None], np.array([0.0, 0.5])).states
        assert np.mean(np.abs(states[:, 1]) < 1e-9) > 0.02
        x = states[:, 0] + 0.01 * rng.standard_normal(len(t))
        record = Record(t, np.column_stack([x, u]), ("x", "u"))
        (run,) = estimate_states(block, record, {"x": 0.01}, {"x_ddot": 0.1}, smooth=True).runs
        held.append(coverage(run, states))
        errors.append(np.sqrt(np.mean((run.states - states)[run.settling :] ** 2, axis=0)))
    assert np.all(np.mean(held, axis=0) > 0.85)
    assert np.all(np.mean(errors, axis=0) < [0.004, 0.02])  # of velocities up to 3


def test_equations_that_cannot_be_followed_end_the_filter_and_say_so():
    escape = build([Coordinate("x")], [], [("x_dot", "1", 1.0), (None, "x**2", -1.0)])
    t = 0.01 * np.arange(400)
    counts = np.ones((400, 1))
    counts[20:] = 0.0
    counts[399] = 1.0
    x = 1.0 / (1.0 - np.minimum(t, 0.2))  # its pole is at 1 s
    (run,) = (found := estimate_states(escape, Record(t, x[:, None], ("x",), counts=counts), {"x": 1e-3})).runs
    assert 60 < len(run.t) < 110
    assert run.ended is not None
    assert run.ended in repr(found)


def test_a_noise_that_is_not_known_is_asked_for():
    rng = np.random.default_rng(0)
    t, states = swing(rng, 100)
    record = log(rng, t, states, 0.02)
    with pytest.raises(InputError, match=r"how noisy phi is.*--noise phi=0\.01"):
        estimate_states(PENDULUM, record)
    with pytest.raises(InputError, match=r"noise of 'psi', which is no coordinate.*did you mean 'phi'"):
        estimate_states(PENDULUM, record, {"psi": 0.1})
    with pytest.raises(InputError, match=r"positive number, got 0\.0"):
        estimate_states(PENDULUM, record, {"phi": 0.0})
    with pytest.raises(InputError, match=r"noise of phi must be a positive number, got '0\.1'"):
        estimate_states(PENDULUM, record, {"phi": "0.1"})
    with pytest.raises(InputError, match=r"which is no target"):
        estimate_states(PENDULUM, record, {"phi": 0.1}, {"phi_dot": 0.1})


def test_what_sticks_where_a_sample_is_lost_stays_as_well_known_as_it_was():
    """The spread of a velocity that friction holds falls twice as fast as its transition: no step may outrun that."""
    table = build(
        [Coordinate("phi", order=2)],
        [Input("m")],
        [("phi_ddot", "1", 0.05), (None, "phi_dot", 0.02), (None, "sign(phi_dot)", 0.06), (None, "m", -1.0)],
    )
    rng = np.random.default_rng(1)
    t = 0.005 * np.arange(4000)
    m = np.interp(t, np.arange(0.0, 21.0, 0.4), 0.2 * rng.standard_normal(53))
    states = simulate(table, t, m[:, None], np.array([0.0, 0.5])).states
    resting = np.abs(states[:, 1]) < 1e-9
    assert np.mean(resting) > 0.03
    lost = rng.random(len(t)) < 0.1
    values = np.column_stack([states[:, 0] + 0.005 * rng.standard_normal(len(t)), m])
    record = Record(t, values, ("phi", "m"), counts=np.column_stack([np.where(lost, 0.0, 1.0), np.ones(len(t))]))
    found = estimate_states(table, record, {"phi": 0.005}, {"phi_ddot": 0.005})
    (run,) = found.runs
    at = np.flatnonzero(lost & resting & (np.arange(len(t)) > run.settling))
    assert len(at) > 10
    assert run.ended is None
    assert run.column_std("phi_dot")[run.settling :].max() < 0.2
    assert np.all(run.column_std("phi_dot")[at] < 2.0 * run.column_std("phi_dot")[at - 1] + 0.01)
    assert found.consistency.squared < 1.3


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"noise": 0.1}, r"noise must be a number for each coordinate, such as \{'phi': 0.01\}; a float came"),
        ({"process": "foo"}, "process must be 'fit', standard deviations by target, or None; a str came"),
        ({"process": {"phi_ddot": -1.0}}, "noise of phi_ddot must be a number of at least 0, got -1.0"),
    ],
)
def test_noise_that_is_none_is_refused(given, told):
    rng = np.random.default_rng(0)
    t, states = swing(rng, 50)
    with pytest.raises(InputError, match=told):
        estimate_states(PENDULUM, log(rng, t, states, 0.1), **({"noise": {"phi": 0.1}} | given))


def test_a_state_that_is_none_is_told():
    rng = np.random.default_rng(0)
    t, states = swing(rng, 50)
    run = estimate_states(PENDULUM, log(rng, t, states, 0.1), {"phi": 0.1}, {}).runs[0]
    with pytest.raises(InputError, match="no state 'phi_dt'; did you mean 'phi_dot'"):
        run.column("phi_dt")
