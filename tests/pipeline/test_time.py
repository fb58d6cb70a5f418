"""A driven pendulum whose log has one defect of time after another: found exactly, and without any option."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

TRUTH = {"sin(theta)": 9.81, "theta_dot": 0.2, "u": -1.0}
STUDY = Study(data=Data(time="t"), coordinates={"theta": Measured(order=2, angle=True)}, inputs={"u": Driven()})
PERIOD, COUNT, NOISE = 0.01, 3000, 1e-3
REGULAR = PERIOD * np.arange(COUNT)


def drive(t):
    return 3.0 * np.sin(1.7 * t) + 2.5 * np.sin(2.9 * t + 1.0) + 2.0 * np.sin(4.3 * t + 2.0)


@cache
def motion():
    def slope(t, y):
        return [y[1], -9.81 * np.sin(y[0]) - 0.2 * y[1] + drive(t)]

    return solve_ivp(slope, (-1.0, 60.0), [2.0, 1.0], "DOP853", dense_output=True, rtol=1e-9, atol=1e-11).sol


def log(taken=REGULAR, stamps=None, seed=0):
    theta = motion()(taken)[0] + NOISE * np.random.default_rng(seed).standard_normal(len(taken))
    return {"t": taken if stamps is None else stamps, "theta": np.angle(np.exp(1j * theta)), "u": drive(taken)}


def rows(kept):
    return {name: column[kept] for name, column in log().items()}


def without(*lost):
    return rows(np.setdiff1d(np.arange(COUNT), np.concatenate(lost)))


def at_half_rate():
    full = log()
    return full | {"theta": np.where(np.arange(COUNT) % 2 == 0, full["theta"], np.nan)}


def doubled_and_swapped():
    rng = np.random.default_rng(4)
    taken = np.sort(np.concatenate([np.arange(COUNT), rng.choice(COUNT, 60, replace=False)]))
    order = np.arange(len(taken))
    swapped = rng.choice(np.arange(1, len(taken) - 1, 3), 40, replace=False)
    order[swapped], order[swapped + 1] = swapped + 1, swapped
    return rows(taken[order])


def random(seed=1):
    return np.random.default_rng(seed)


SOME = random().choice(COUNT, 150, replace=False)
GAP = np.arange(1200, 1215)
LOGS = {  # the tables of a log, and a part of each note that it must lead to
    "clean": (lambda: [log()], []),
    "clock jitter": (
        lambda: [log(stamps=REGULAR + 0.1 * PERIOD * random().standard_normal(COUNT))],
        ["the clock was read with a jitter of 9.9 % of"],
    ),
    "sampling jitter": (
        lambda: [log(REGULAR + PERIOD * random().uniform(-0.3, 0.3, COUNT))],
        ["samples were taken off even times by 17 % of a sample period"],
    ),
    "irregular steps": (
        lambda: [log(np.cumsum(PERIOD * (1.0 + random().uniform(-0.3, 0.3, COUNT))))],
        ["samples of theta, of 3"],
    ),
    "first interval": (lambda: [log(np.r_[-0.7 * PERIOD, REGULAR[1:]])], ["1 samples of theta, of 3001, are missing"]),
    "late stamps": (lambda: [log(stamps=REGULAR + 0.9 * PERIOD * (np.arange(COUNT) % 70 == 3))], []),
    "lost rows": (lambda: [without(SOME)], ["samples of theta, of 3000, are missing (5.00 %), in 14"]),
    "a gap": (lambda: [without(GAP)], ["15 samples of theta, of 3000, are missing (0.50 %), in a gap"]),
    "lost rows and a gap": (lambda: [without(SOME, GAP)], ["of theta, of 3000, are missing"]),
    "a gap that splits": (lambda: [without(np.arange(1200, 1300))], ["recordings were cut at a gap"]),
    "slightly different periods": (
        lambda: [log(1.00007 * REGULAR[:1500]), log(20.0 + 1.000195 * REGULAR[:1500], seed=1)],
        [],
    ),
    "different periods": (
        lambda: [log(REGULAR[:1500]), log(20.0 + 0.75 * REGULAR[:2000], seed=1)],
        ["samples of theta, of"],
    ),
    "a slow recording": (
        lambda: [log(REGULAR[:2500]), log(5.0 + 10.0 * REGULAR[:300], seed=1)],
        [],
    ),
    "half rate": (at_half_rate, ["1499 samples of theta, of 2999"]),
    "doubled and swapped rows": (
        lambda: [doubled_and_swapped()],
        ["of 3060 rows were out of order: sorted", "60 of 3060 rows had the time of another: merged"],
    ),
}


@pytest.mark.parametrize("name", LOGS)
def test_a_pendulum_is_found_whatever_the_clock_did(name):
    tables, told = LOGS[name]
    result = identify(STUDY, tables())
    (relation,) = result.model.relations
    found = {t.term.text: t for t in relation.terms if t.factor is None}
    assert found.keys() == TRUTH.keys()
    for term, value in TRUTH.items():
        assert abs(found[term].coefficient - value) < 4.0 * found[term].std_error < 0.02 * abs(value)
    (channel,) = result.signals.channels
    assert channel.noise == pytest.approx(NOISE, rel=0.1)
    for part in told:
        assert any(part in note for note in result.notes), result.notes
    assert bool(result.notes) == bool(told)
