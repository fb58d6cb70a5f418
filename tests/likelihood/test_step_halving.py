"""Steps of the integration that are halved until that moves no coefficient."""

from dataclasses import replace

import numpy as np
from process_cases import LINEAR, PRESENT, TERMS, cut, fitted, kicked, space, spring
from small_systems import SPRING, drive, in_bare_gauge

from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.fit import Fit
from odescope.likelihood.steps import FINEST, halve_steps


def coarse(sigma):
    """Return the space of a spring sampled so rarely that one step a sample is far too long."""
    step, count = 0.5, 400
    nodes = drive(count, step)
    states = kicked(SPRING, LINEAR, nodes, np.zeros((count, 2)), [0.5, 0.0], step)
    measured = states[:, :1] + sigma * np.random.default_rng(0).standard_normal((count, 1))
    return space(SPRING, cut(states, measured, nodes, sigma, [0.01, 0.05], (count,), 25, step), 1)


def test_steps_are_halved_until_that_moves_no_coefficient():
    it = coarse(0.005)
    gap = 0.01 * it.segments.spread
    rough = fitted(it, gap=gap)
    finer, found = halve_steps(it, rough, gap)
    assert 1 < finer.evaluator.substeps <= FINEST
    best = replace(it, evaluator=Evaluator(it.segments, 32)).fit(LINEAR, PRESENT, found.x0, gap)

    end = in_bare_gauge(it, best)

    def moved(fit: Fit):
        return np.abs((in_bare_gauge(it, fit).theta - end.theta)[TERMS] / end.errors[TERMS]).max()

    assert moved(rough) > 5.0
    assert moved(found) < 0.1


def test_steps_that_are_short_enough_stay_and_so_does_the_fit():
    it = spring(0)
    found = fitted(it)
    same, kept = halve_steps(it, found, it.segments.spread)
    assert same is it
    assert kept is found
