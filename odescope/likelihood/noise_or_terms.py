"""Whether a record that a model follows to within its noise is described better by fewer terms and process noise.

Noise that is hardly more than the measurement's, as of an input that was recorded with some, is followed by terms that
mean nothing: each earns its price, and what they leave is white. docs/method.md, Process noise.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from odescope.arrays import FloatArray
from odescope.likelihood.held_out import thinned
from odescope.likelihood.noise_levels import estimate_noise, marginal_cost, with_noise
from odescope.likelihood.path import ModelPath
from odescope.likelihood.process_noise import PIECES
from odescope.likelihood.search import Outcome
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import Segments


def cost_without_process_noise(space: SearchSpace, outcome: Outcome) -> float:
    """Return the penalised marginal cost of a model that follows its record, on the cut that `space` has.

    Infinite where it cannot be followed there.
    """
    segments = space.segments
    strict = with_noise(space, segments.noise * np.sqrt(outcome.scale), segments.spread * outcome.width)
    found = strict.again(outcome.fit, segments.initial, strict.segments.spread)
    if found is None:
        return np.inf
    return marginal_cost(strict, found) + space.price(found)


def cost_with_process_noise(space: SearchSpace, theta: FloatArray) -> float:
    """Return the same of a model with process noise of the size that makes it likeliest.

    Args:
        space: data cut into short segments, and candidates.
        theta: (mechanisms,) coefficients to begin with.
    """
    begun = space.begin(theta, space.segments.spread)
    if begun is None:
        return np.inf
    there, found, cost = estimate_noise(space, begun)
    return cost + there.price(found)


def few_with_process_noise(
    cut: Callable[[int], Segments], space: SearchSpace, outcome: Outcome, path: ModelPath
) -> FloatArray | None:
    """Return the coefficients of the short model on a path if process noise makes it likelier than all terms.

    Args:
        cut: cuts the data into segments of so many averages.
        space: candidates.
        outcome: the end of a search for a model that follows the record without process noise.
        path: from that to the shortest.
    """
    knee = path.at_knee().choice.fit
    if np.array_equal(knee.present, path.steps[0].fit.present):
        return None
    pieces = space.on(thinned(cut(PIECES[0])))
    all_terms = min(cost_without_process_noise(pieces, outcome), cost_with_process_noise(pieces, outcome.fit.theta))
    return knee.theta if cost_with_process_noise(pieces, knee.theta) < all_terms else None
