"""Runs of rigs sampled so finely that differences of their states are accelerations."""

from dataclasses import replace

import numpy as np
from defects import drawn, ride, sampled
from laws import accelerations, shifted
from rigs import RIGS

FINE = 10.0  # times finer than the rig's own samples
SAMPLES = 1501


def rig_of(name, seed=0, **changes):
    return replace(RIGS[name](np.random.default_rng(seed)), **changes)


def finely(rig, times=FINE):
    return replace(rig, period=rig.period / times)


def ran(rig, suffered, seed=0, samples=SAMPLES):
    rng = np.random.default_rng(seed)
    return ride(rig, suffered, sampled(rig, suffered, samples, rng), rng)


def clean(rig):
    return drawn("clean", rig, np.random.default_rng(0))


def unexplained(rig, suffered, run, acting=None):
    """Numeric accelerations less those of the truth, over the latter's root mean square; (T, rows that slide)."""
    truth = rig.truth(suffered.beside)
    columns = np.column_stack([run.states, run.inputs if acting is None else acting]).T[:, 1:-1]
    numeric = (run.states[2:] - run.states[:-2]).T / (run.t[2:] - run.t[:-2])
    wanted = accelerations(truth.model, shifted(columns, suffered.zero))
    rubbed = {text for law in rig.laws.values() for _, text, _ in law}
    rates = [k for k, n in enumerate(truth.model.states) if n.endswith("_dot") or f"sign({n})" in rubbed]
    slides = (np.abs(columns[rates]) > 0.05).all(axis=0)
    off = numeric[-len(truth.targets) :] - wanted
    return off[:, slides] / np.sqrt(np.mean(wanted**2, axis=1, keepdims=True))
