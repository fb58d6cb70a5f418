"""What a record leaves open of what its inputs do between samples, and what that adds to the errors of a model.

docs/method.md, Inputs between samples.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from odescope.arrays import FloatArray
from odescope.likelihood.fit import Fit
from odescope.likelihood.holds import fall, holds_of, refitted, under
from odescope.likelihood.search_space import SearchSpace
from odescope.recordings.coordinate import Hold

RUNNING: dict[Hold, Hold] = {"linear": "band-limited", "band-limited": "linear"}  # smooth inputs hardly differ in it
TOLD = 1.5  # times the standard error that is known under one hold: what is added up to that needs no word


@dataclass(frozen=True, eq=False)
class Undecided:
    """What is added to the covariance (p, p) of the parameters, and the inputs that may as well have another hold."""

    covariance: FloatArray
    others: dict[str, Hold]


def undecided_holds(space: SearchSpace, found: Fit, open_: Collection[str], width: float, scale: float) -> Undecided:
    """Return what holds that a record does not decide between add to the errors of a model.

    The gain of a smooth input takes up most of what differs between linear and band-limited, which its likelihood
    hardly shows: the errors are those about the model of a coefficient that has either value, each as often as its
    likelihood says.

    Args:
        space: of the model.
        found: the model.
        open_: the names of the inputs whose holds are open.
        width: of the defects.
        scale: residual variance over that of the noise.
    """
    added, others = np.zeros_like(found.covariance), dict[str, Hold]()
    for j, (name, hold) in enumerate(zip(space.frame.inputs, holds_of(space), strict=True)):
        if name not in open_ or hold not in RUNNING:
            continue
        other = refitted((space, found), under(space, j, RUNNING[hold]), width)
        if other is None or not np.array_equal(other[1].free, found.free):
            continue
        share = float(expit(0.5 * fall(other, (space, found))))
        apart = other[1].theta[found.free] - found.theta[found.free]
        added += share * np.outer(apart, apart)
        if (share * apart**2 > (TOLD**2 - 1.0) * scale * found.variances).any():
            others[name] = RUNNING[hold]
    return Undecided(added, others)
