"""Whether a record that a model follows to within its noise is described better by fewer terms and process noise.

Noise that is hardly more than the measurement's, as of an input that was recorded with some, is followed by terms that
mean nothing: each earns its price, and what they leave is white. docs/method.md, Process noise.
"""

from __future__ import annotations

import numpy as np

from odescope.arrays import FloatArray
from odescope.likelihood.held_out import thinned
from odescope.likelihood.noise_levels import estimate_noise, marginal_cost, with_noise
from odescope.likelihood.path import ModelPath
from odescope.likelihood.search import Outcome
from odescope.likelihood.search_space import SearchSpace


def cost_without_process_noise(space: SearchSpace, outcome: Outcome) -> float:
    """Return the penalised marginal cost of a model that follows its record, on the cut that `space` has."""
    segments = space.segments
    strict = with_noise(space, segments.noise * np.sqrt(outcome.scale), segments.spread * outcome.width)
    found = strict.again(outcome.fit, segments.initial, strict.segments.spread)
    if found is None:
        return np.inf
    return marginal_cost(strict, found) + space.price(found)


def few_with_process_noise(space: SearchSpace, outcome: Outcome, path: ModelPath) -> FloatArray | None:
    """Return the coefficients of the short model on a path if process noise makes it likelier than all terms.

    Args:
        space: data cut into short segments, and candidates.
        outcome: the end of a search for a model that follows the record without process noise.
        path: from that to the shortest.
    """
    knee = path.at_knee().choice.fit
    if np.array_equal(knee.present, path.steps[0].fit.present):
        return None
    space = space.on(thinned(space.segments))
    costs = [cost_without_process_noise(space, outcome)]
    for theta in (outcome.fit.theta, knee.theta):
        begun = space.begin(theta, space.segments.spread)
        if begun is None:
            return None
        there, found, cost = estimate_noise(space, begun)
        costs.append(cost + there.price(found))
    return knee.theta if costs[-1] < min(costs[:-1]) else None
