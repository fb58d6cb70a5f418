"""Whether process noise, maybe with fewer terms, describes a record better that a model follows to within its noise.

Noise that is hardly more than the measurement's, as of an input that was recorded with some, is followed by terms that
mean nothing: each earns its price, and what they leave is white. Or by none, with errors that are far too small.
docs/method.md, Process noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from odescope.arrays import FloatArray
from odescope.likelihood.fit import Fit
from odescope.likelihood.held_out import thinned
from odescope.likelihood.noise_levels import LEAST_NOISE, LinearRecord, estimate_noise, with_noise
from odescope.likelihood.path import ModelPath
from odescope.likelihood.process_noise import PIECES
from odescope.likelihood.search import WIDTHS, Outcome
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.searches import SHORT_RECORD
from odescope.likelihood.segments import Segments


def cost_without_process_noise(space: SearchSpace, outcome: Outcome) -> float:
    """Return the penalised marginal cost of a model that follows its record, on the cut that `space` has.

    Each channel has its own noise, or one with process noise would gain by telling them apart. Infinite where the
    record cannot be followed there.
    """
    strict = _Strict.of(space, outcome)
    without = None if strict is None else strict.record.at(strict.logs)
    return np.inf if strict is None or without is None else without.marginal + space.price(strict.fit)


@dataclass(frozen=True, eq=False)
class _Strict:
    """A model without process noise on a cut: its fit, the record around that, and its noise and defects as logs."""

    fit: Fit
    record: LinearRecord
    logs: FloatArray

    @staticmethod
    def of(space: SearchSpace, outcome: Outcome) -> _Strict | None:
        """Return it, None where the record cannot be followed.

        Args:
            space: data cut into segments, and candidates.
            outcome: the end of a search for a model that follows the record without process noise.
        """
        segments = space.segments
        strict = with_noise(space, segments.noise * np.sqrt(outcome.scale), segments.spread * outcome.width)
        found = strict.again(outcome.fit, segments.initial, strict.segments.spread)
        record = None if found is None else LinearRecord.of(strict, found)
        if found is None or record is None:
            return None
        measurement = 0.5 * np.log(record.cost / segments.counted)
        return _Strict(found, record, np.concatenate([measurement, np.log(strict.segments.spread)]))


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


def likelier_with_process_noise(
    cut: Callable[[int], Segments], space: SearchSpace, outcome: Outcome, path: ModelPath
) -> FloatArray | None:
    """Return the coefficients to search from if process noise makes a record likelier, None if it does not.

    Those of the short model on a path if with such noise that is likelier than all terms; else those of all terms. Of
    few samples nobody knows how noise spreads: that they join less closely than those of a law do has to say so, too.

    Args:
        cut: cuts the data into segments of so many averages.
        space: candidates.
        outcome: the end of a search for a model that follows the record without process noise.
        path: from that to the shortest.
    """
    knee = path.at_knee().choice.fit
    shorter = not np.array_equal(knee.present, path.steps[0].fit.present)
    told = space.segments.samples > SHORT_RECORD or outcome.width > WIDTHS[-1]
    if not (shorter or told):
        return None
    pieces = space.on(thinned(cut(PIECES[0])))
    if shorter:
        all_terms = min(cost_without_process_noise(pieces, outcome), cost_with_process_noise(pieces, outcome.fit.theta))
        if cost_with_process_noise(pieces, knee.theta) < all_terms:
            return knee.theta
    price = len(pieces.segments.spread) * float(np.log(pieces.segments.samples))
    return outcome.fit.theta if told and _gain_of_process_noise(pieces, outcome) > price else None


def _gain_of_process_noise(space: SearchSpace, outcome: Outcome) -> float:
    """Return the least fall of the marginal cost with process noise: that about the fit, which stays as it is.

    Args:
        space: data cut into short segments, and candidates.
        outcome: the end of a search for a model that follows the record without process noise.
    """
    strict = _Strict.of(space, outcome)
    if strict is None:
        return 0.0
    record, channels = strict.record, len(space.segments.noise)
    without = record.at(strict.logs)
    begun = record.at(np.concatenate([strict.logs[:channels], np.log(space.segments.spread)]))
    if without is None or begun is None:
        return 0.0
    return without.marginal - record.most_likely(begun, begun.logs + np.log(LEAST_NOISE)).marginal
