"""Whether what the best relation of a target leaves behaves as a state that was not measured."""

from __future__ import annotations

import numpy as np

from odescope.arrays import FloatArray
from odescope.regression.problem import Problem
from odescope.selection.score import residuals

FOLLOWS = 0.75  # least part of its rate by which a residual counts as a state


def own_dynamics(problem: Problem, xi: FloatArray) -> float:
    """Return the part of the rate of a relation's residual that follows from the residual, the states and the inputs.

    A state that was not measured obeys an equation of its own, to first order a linear one: its rate follows from
    itself and from what was recorded. The rate of an input that was not recorded does not, nor does that of noise.
    Fitted on the first half of the blocks, or of the one there is, and tried on the second.

    Args:
        problem: of the target.
        xi: (m,) coefficients of the relation.
    """
    signals = problem.signals
    targets = [signals.row(t) for t in signals.targets]
    rates, causes = [], []
    for k, block in enumerate(problem.blocks):
        left = residuals(problem, xi[None], problem.evaluated(k))[0][0]
        columns = np.delete(signals.columns[block.record][:, block.start : block.stop], targets, axis=0)
        # Over central differences, at the samples between.
        rates.append(0.5 * (left[2:] - left[:-2]))
        causes.append(np.vstack([np.ones(len(left)), left, columns])[:, 1:-1])
    rate, cause = np.concatenate(rates), np.concatenate(causes, axis=1)
    half = len(rate) // 2
    scale = np.maximum(np.linalg.norm(cause[:, :half], axis=1), 1e-300)
    found = np.linalg.lstsq((cause[:, :half].T / scale), rate[:half], rcond=None)[0] / scale
    tried, centred = rate[half:] - found @ cause[:, half:], rate[half:] - rate[half:].mean()
    power = float(centred @ centred)
    return 1.0 - float(tried @ tried) / power if power > 0.0 else 0.0
