"""The truth of every rig against its equations of motion by hand, and its runs against both."""

import numpy as np
import pytest
from bench_cases import FINE, clean, finely, ran, rig_of, unexplained
from laws import accelerations, equations, holds, rows_of
from rigs import RIGS
from travel import travel


@pytest.mark.parametrize("name", RIGS)
@pytest.mark.parametrize("seed", range(3))
def test_the_laws_give_the_accelerations_of_the_equations_by_hand(name, seed):
    rig, rng = rig_of(name, seed), np.random.default_rng(seed)
    constants = rng.uniform(-1.0, 1.0, len(rig.strength))
    truth = rig.truth(constants)
    count = len(truth.model.states)
    columns = rng.uniform(0.1, 3.0, (count + len(constants), 50))
    if name != "tanks":
        columns *= rng.choice((-1.0, 1.0), columns.shape)
    by_hand = np.array([rig.rate(c[:count], c[count:] + constants) for c in columns.T]).T
    np.testing.assert_allclose(accelerations(truth.model, columns), by_hand[-len(truth.targets) :], rtol=1e-9)
    targets, nowhere = by_hand[-len(truth.targets) :], np.zeros(len(rig.coordinates))
    wild = rng.standard_normal(targets.shape)
    also = rows_of(truth, [rig.displaced(law, constants) for law in rig.also])
    for row in (*equations(truth.model.relations), *also):
        assert holds(truth.model, row, nowhere, columns, targets, wild)
        assert not holds(truth.model, row, nowhere, columns, wild, targets)


@pytest.mark.parametrize("name", RIGS)
def test_runs_obey_the_truth(name):
    # The slow reference of the stage wants seconds.
    rig = finely(rig_of(name), 2.0 if name == "stage" else FINE)
    suffered = clean(rig)
    off = unexplained(rig, suffered, ran(rig, suffered))
    assert off.shape[1] > 300
    # A difference over a samples' kink of the input or of the friction is off; few are.
    assert np.quantile(np.abs(off), 0.98) < 5e-3


@pytest.mark.parametrize("held", [0, 4])
@pytest.mark.parametrize("delay", [0.0, 0.037])
def test_inputs_act_as_they_are_held_and_delayed(held, delay):
    """The states of x' = u + w are the integral of both, in closed form."""
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.005, 0.02, 60))
    signal, beside = rng.standard_normal((60, 1)), rng.standard_normal((60, 1))
    states, commands = travel(lambda _, u: u, t, lambda k, _: signal[k], np.array([0.5]), beside, delay, held)
    wanted = signal[np.arange(60) // held * held] if held else signal
    np.testing.assert_array_equal(commands, wanted)
    fine = np.linspace(t[0], t[-1], 400_001)
    late = np.maximum(fine - delay, t[0])
    acts = wanted[np.searchsorted(t, late, side="right") - 1, 0] if held else np.interp(late, t, wanted[:, 0])
    whole = np.concatenate([[0.0], np.cumsum(0.5 * (acts[1:] + acts[:-1]) * np.diff(fine))])
    aside = np.concatenate([[0.0], np.cumsum(beside[:-1, 0] * np.diff(t))])
    np.testing.assert_allclose(states[:, 0], 0.5 + np.interp(t, fine, whole) + aside, atol=2e-5)


def test_a_stage_sticks_under_a_force_below_its_dry_friction():
    rig = rig_of("stage")
    (_, _, dry, _), t = rig.laws["x_ddot"], np.arange(200) * 0.004
    pull = np.array([0.5 * dry[2]])
    states, _ = travel(rig.rate, t, lambda k, _: pull, np.zeros(2), np.zeros((200, 1)))
    assert 0.0 < states[:, 1].max() < 1e-3
