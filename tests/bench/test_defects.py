"""Every defect does what it says, to a motor whose readings are otherwise nearly exact."""

from dataclasses import fields, replace

import numpy as np
import pytest
from bench_cases import FINE, finely, ran, rig_of, unexplained
from defects import DEFECTS, RANGES, Defects, drawn, logged

SEED = 0
NOISE = 1e-7


def suffering(name, fine=False):
    """Return a rig, the defect, its run and its log."""
    rig = rig_of("motor", SEED, noise=(NOISE,), step=(1e-3,))
    rig = finely(rig) if fine else rig
    suffered = drawn(name, rig, np.random.default_rng(SEED))
    run = ran(rig, suffered)
    return rig, suffered, run, logged(rig, suffered, run, 1, np.random.default_rng(SEED))


def within(value, name, field, slack=0.0):
    low, high = RANGES[name][field]
    return low * (1.0 - slack) <= value <= high * (1.0 + slack)


def test_the_motor_of_these_tests_has_an_angle_with_a_zero():
    assert rig_of("motor", SEED).coordinates["q"].angle


def test_a_jittering_clock_moves_stamps_and_nothing_else():
    rig, _, run, log = suffering("clock jitter")
    np.testing.assert_allclose(np.diff(run.t), rig.period)
    assert within(np.std(log["t"] - run.t) / rig.period, "clock jitter", "clock", 0.1)
    assert (np.diff(log["t"]) > 0).all()
    np.testing.assert_allclose(log["q"], run.states[:, 0], atol=10 * NOISE)


def test_jittering_samples_are_taken_when_their_stamps_say():
    rig, suffered, run, log = suffering("sampling jitter", fine=True)
    np.testing.assert_array_equal(log["t"], run.t)
    steps = np.diff(log["t"]) / rig.period
    assert 0.2 * suffered.sampling < steps.std() < suffered.sampling
    np.testing.assert_allclose(log["q"], run.states[:, 0], atol=10 * NOISE)
    # Central differences over uneven intervals are off to first order; the law still shows.
    assert np.median(np.abs(unexplained(rig, suffered, run))) < 0.02


def test_a_first_interval_is_long():
    rig, _, _, log = suffering("first interval")
    steps = np.diff(log["t"]) / rig.period
    assert within(steps[0], "first interval", "first")
    np.testing.assert_allclose(steps[1:], 1.0)


def test_late_rows_repeat_what_was_measured_and_not_what_was_commanded():
    _, _, run, log = suffering("late reads")
    same = np.diff(log["q"]) == 0.0
    assert within(same.mean(), "late reads", "late", 0.1)
    assert (np.diff(log["v"])[same] != 0.0).all()
    wrong = np.abs(log["q"] - run.states[:, 0]) > 10 * NOISE
    assert wrong.sum() <= same.sum()


def test_rows_are_dropped_here_and_there():
    _, _, run, log = suffering("dropped rows")
    assert within(1.0 - len(log["t"]) / len(run.t), "dropped rows", "dropped", 0.3)
    kept = np.searchsorted(run.t, log["t"])
    np.testing.assert_allclose(log["q"], run.states[kept, 0], atol=10 * NOISE)
    np.testing.assert_array_equal(log["v"], run.inputs[kept, 0])
    assert np.diff(kept).max() < 6


def test_a_gap_is_one_stretch():
    rig, _, run, log = suffering("gap")
    steps = np.diff(log["t"]) / rig.period
    assert (steps > 1.5).sum() == 1
    assert within(steps.max() / len(run.t), "gap", "gap", 0.05)


def test_an_encoder_rounds_to_its_steps():
    rig, suffered, run, log = suffering("quantisation")
    step = suffered.steps * rig.step[0]
    np.testing.assert_allclose(log["q"] / step, np.round(log["q"] / step), atol=1e-9)
    off = np.abs(log["q"] - run.states[:, 0])
    assert 0.9 * step / 2 < off.max() <= step / 2 + 1e-12


def test_an_input_acts_late():
    rig, suffered, _, _ = suffering("input delay", fine=True)
    suffered = replace(suffered, delay=FINE * suffered.delay)
    run = ran(rig, suffered)
    late = np.interp(run.t - suffered.delay * rig.period, run.t, run.inputs[:, 0])
    assert np.quantile(np.abs(unexplained(rig, suffered, run, late)), 0.98) < 5e-3
    assert np.quantile(np.abs(unexplained(rig, suffered, run)), 0.98) > 2e-2


def test_an_input_is_held_and_logged_so():
    rig, suffered, run, log = suffering("held input", fine=True)
    blocks = log["v"][: len(log["v"]) // suffered.held * suffered.held].reshape(-1, suffered.held)
    assert (blocks == blocks[:, :1]).all()
    assert np.unique(blocks[:, 0]).size > 0.9 * len(blocks)
    # Differences over the end of a block see two commands.
    assert np.median(np.abs(unexplained(rig, suffered, run))) < 5e-3


def test_zeros_and_constants_are_in_the_truth():
    rig, suffered, run, log = suffering("offsets", fine=True)
    assert within(abs(suffered.zero[0]), "offsets", "zero")
    assert within(abs(suffered.beside[0]) / rig.strength["v"], "offsets", "beside")
    np.testing.assert_allclose(log["q"], run.states[:, 0], atol=10 * NOISE)
    assert np.quantile(np.abs(unexplained(rig, suffered, run)), 0.98) < 5e-3
    for name in ("zero", "beside"):
        without = replace(suffered, **{name: (0.0,)})
        assert np.median(np.abs(unexplained(rig, without, run))) > 2e-2


def test_outliers_are_few_and_far():
    _, _, run, log = suffering("outliers")
    off = np.abs(log["q"] - run.states[:, 0]) / NOISE
    far = off > 6.0
    assert within(far.mean(), "outliers", "outliers", 0.5)
    assert off.max() < 55.0
    assert np.median(off[far]) > 15.0


def test_process_noise_is_a_torque_as_large_as_it_says():
    rig, suffered, run, _ = suffering("process noise", fine=True)
    size = np.std(unexplained(rig, suffered, run))
    quiet = replace(suffered, torque=0.0)
    assert np.quantile(np.abs(unexplained(rig, quiet, ran(rig, quiet))), 0.98) < 5e-3
    truth = rig.truth((0.0,)).model
    gain = abs(next(t.coefficient for t in truth.relations[0].terms if t.text == "v"))
    numeric = np.gradient(run.states[:, 1], run.t)
    # A central difference averages two draws.
    assert size * numeric.std() == pytest.approx(suffered.torque * rig.strength["v"] * gain / np.sqrt(2), rel=0.2)


def test_all_is_all_and_one_is_one():
    rig = rig_of("motor", SEED)
    none = Defects((0.0,), (0.0,))
    whole = drawn("all", rig, np.random.default_rng(0))
    assert all(getattr(whole, f.name) != getattr(none, f.name) for f in fields(Defects))
    for name in DEFECTS[:-1]:
        one = drawn(name, rig, np.random.default_rng(0))
        differ = {f.name for f in fields(Defects) if getattr(one, f.name) != getattr(none, f.name)}
        assert differ == set(RANGES[name])
