"""Sums that stay constant, in data and by reactions; and what is said of energies in the end."""

import numpy as np
import pytest

from odescope.library.reactions import reactions
from odescope.model.worth import OPEN
from odescope.pipeline.physics import _drift, constants_of
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.signals.differentiators import Spectral
from odescope.signals.estimate import estimate_signals

SPECIES = tuple(Coordinate(name) for name in "SECP")
NOISE = 0.01


def measured(leak=0.0, noises=(NOISE, NOISE)):
    """S + E <-> C -> P + E, twice, each with its noise; E leaks at a rate."""
    rng, t, runs = np.random.default_rng(1), 0.02 * np.arange(500), []
    for noise, start in zip(noises, ([2.0, 0.8, 0.0, 0.0], [3.0, 0.5, 0.3, 0.0]), strict=True):
        s, states = np.array(start), []
        for _ in t:
            states.append(s)
            for _ in range(4):
                bind, split, turn = s[0] * s[1], 0.4 * s[2], 0.8 * s[2]
                change = [split - bind, split + turn - bind - leak * s[1], bind - split - turn, turn]
                s = s + 0.005 * np.array(change)
        values = np.array(states) + noise * rng.standard_normal((len(t), 4))
        runs.append(Record(t, values, tuple("SECP"), (None,) * 4))
    records = Records(tuple(runs))
    return records, estimate_signals(records, SPECIES, (), Spectral())


TRUE = reactions(SPECIES, (), named=["S + E <-> C", "C -> P + E"], composition=None)


@pytest.fixture(scope="module")
def closed():
    return measured()


def test_what_the_data_and_the_reactions_keep_constant(closed):
    found = constants_of(*closed, TRUE)
    assert [(c.sum, c.by_model) for c in found] == [("E + C", True), ("S + C + P", True)]
    assert found[0].values == pytest.approx((0.8, 0.8), abs=0.005)


@pytest.mark.parametrize("noises", [(0.002, 0.02), (0.02, 0.002)])
def test_a_recording_that_is_noisier_moves_no_sum(noises):
    found = constants_of(*measured(noises=noises), TRUE)
    assert [(c.sum, c.by_model, bool(c.values)) for c in found] == [("E + C", True, True), ("S + C + P", True, True)]


def test_without_reactions_the_data_alone_speak(closed):
    assert [c.by_model for c in constants_of(*closed, ())] == [None, None]


def test_a_reaction_that_breaks_what_the_data_keep(closed):
    wrong = (*TRUE, *reactions(SPECIES, (), named=["E ->"], composition=None)[4:])
    assert [(c.sum, c.by_model) for c in constants_of(*closed, wrong)] == [("E + C", False), ("S + C + P", True)]


def test_what_the_reactions_keep_and_the_data_do_not():
    found = constants_of(*measured(leak=0.05), TRUE)
    assert ("E + C", (), True) in [(c.sum, c.values, c.by_model) for c in found]


@pytest.mark.parametrize("leak", [0.1, 0.05, 0.02])
def test_how_far_a_sum_moves_that_reactions_would_keep(leak):
    records, signals = measured(leak)
    moved = {c.sum: c.drift for c in constants_of(records, signals, TRUE) if not c.values}
    # Smoothed another way: over the record, means of 25 samples.
    smooth = [[np.convolve(r.column(n), np.ones(25) / 25, "valid") for n in "EC"] for r in records]
    total = np.sqrt(np.mean([np.var(e + c) for e, c in smooth]))
    assert moved["E + C"] == pytest.approx(total / max(np.std(v) for r in smooth for v in r), rel=0.15)
    assert moved["E + C"] > OPEN


def test_a_short_record_of_much_noise_moves_no_sum():
    rng, t = np.random.default_rng(5), np.arange(12.0)
    drifts = []
    for _ in range(60):
        s = 2.0 * np.exp(-0.3 * t)
        values = np.column_stack([s, 2.0 - s]) + 0.1 * rng.standard_normal((12, 2))
        columns = [np.ascontiguousarray(values.T)]
        drifts.append(_drift(columns, np.ones(2), np.full((1, 2), 0.1)))
    assert np.mean(np.array(drifts) > OPEN) <= 0.05


def test_positions_are_no_amounts(closed):
    records, _ = closed
    positions = tuple(Coordinate(name, 2) for name in "SECP")
    assert constants_of(records, estimate_signals(records, positions, (), Spectral()), ()) == ()
