"""What a record leaves open of what its inputs do between samples, and what that adds to the errors of a model.

docs/method.md, Inputs between samples.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
from scipy.special import softmax

from odescope.arrays import FloatArray
from odescope.likelihood.fit import Fit
from odescope.likelihood.holds import Trial, as_late, fall, holds_of, refitted, under
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
    hardly shows; of one that acts late a delay half a sample longer takes up most of what differs from held. The errors
    are those about the model of a coefficient that has each value as often as its likelihood says.

    Args:
        space: of the model.
        found: the model.
        open_: the names of the inputs whose holds are open.
        width: of the defects.
        scale: residual variance over that of the noise.
    """
    added, others = np.zeros_like(found.covariance), dict[str, Hold]()
    delayed = {m.place for m in (space.mechanisms[k] for k in found.present.tolist()) if m.kind == "delay"}
    for j, (name, hold) in enumerate(zip(space.frame.inputs, holds_of(space), strict=True)):
        if name not in open_ or not (hold in RUNNING or name in delayed):
            continue
        known = tuple(h for h in get_args(Hold) if h != hold) if name in delayed else (RUNNING[hold],)
        trials = {h: _refitted(space, found, j, h, width) for h in known}
        able = {h: t for h, t in trials.items() if t is not None and np.array_equal(t[1].free, found.free)}
        shares = softmax([0.0, *(0.5 * fall(t, (space, found)) for t in able.values())])[1:]
        doubt = 0.0
        for (rival, (_, fitted)), share in zip(able.items(), shares, strict=True):
            apart = fitted.theta[found.free] - found.theta[found.free]
            added += share * np.outer(apart, apart)
            more = float(np.max(share * apart**2 / np.maximum(scale * found.variances, 1e-300)))
            if more > max(doubt, TOLD**2 - 1.0):
                doubt, others[name] = more, rival
    return Undecided(added, others)


def _refitted(space: SearchSpace, found: Fit, j: int, hold: Hold, width: float) -> Trial | None:
    """Return a model under another hold of an input, which acts when it does now; None where it is lost.

    Args:
        space: of the model.
        found: the model.
        j: number of the input.
        hold: of the input.
        width: of the defects.
    """
    begun = replace(found, theta=as_late(space, j, found.theta, found.present, hold))
    return refitted((space, begun), under(space, j, hold), width)
