"""Process noise by maximum likelihood of the innovations.

A model file says how much of its own record a model left unexplained, averaged over a window. What the observer needs
is a spectral density, for the log at hand: that under which its innovations are most likely.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import minimize

from odescope.arrays import FloatArray
from odescope.observer.noise import ObserverNoise
from odescope.observer.run import ReadyRecord, negative_log_likelihood

LONGEST = 8000  # samples in all that are looked at: a spectral density needs no more
DECADES = tuple(range(-6, 1))  # of a target's size, times the root of a sample period: where the search begins
EVALUATIONS = 60  # a target
WORTH = 1.92  # gain of log-likelihood, half of the 95 % point of chi-squared: less is no sign of process noise


def fit_process_noise(recordings: Sequence[ReadyRecord], measurement: Mapping[str, float]) -> dict[str, float]:
    """Return the process noise of every target under which recordings are most likely; all 0 where they ask for none.

    Args:
        recordings: of one model.
        measurement: standard deviation of a sample of each coordinate.
    """
    model = recordings[0].model
    share = min(1.0, LONGEST / sum(len(p.record) for p in recordings))
    parts = [p.part(max(int(share * len(p.record)), 4 * len(model.states))) for p in recordings]
    period = float(np.median(np.concatenate([np.diff(p.record.t) for p in parts])))
    sizes = np.max([p.first.target_sizes for p in recordings], axis=0) * np.sqrt(period)

    def cost(logs: FloatArray) -> float:
        process = dict(zip(model.targets, (sizes * np.exp(logs)).tolist(), strict=True))
        total = sum(negative_log_likelihood(p, ObserverNoise(measurement, process)) for p in parts)
        return float(np.nan_to_num(total, nan=1e300, posinf=1e300))

    without = cost(np.full(len(sizes), -np.inf))
    tried = [np.full(len(sizes), k * np.log(10.0)) for k in DECADES]
    costs = [cost(logs) for logs in tried]
    if min(costs) > without - WORTH:
        return dict.fromkeys(model.targets, 0.0)
    begin = tried[int(np.argmin(costs))]
    simplex = np.vstack([begin, begin + np.eye(len(begin))])
    options = {"maxfev": EVALUATIONS * len(begin), "xatol": 0.02, "fatol": 0.05, "initial_simplex": simplex}
    found = minimize(cost, begin, method="Nelder-Mead", options=options)
    return dict(zip(model.targets, (sizes * np.exp(found.x)).tolist(), strict=True))
