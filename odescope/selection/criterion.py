"""What a term has to earn before it is believed."""

from __future__ import annotations

import numpy as np

from odescope.arrays import FloatArray


def penalty(samples: float, share: FloatArray | float) -> FloatArray:
    """Return what each term has to earn, in units of -2 log likelihood: ln(samples) - 2 ln(share).

    The first is that of Bayes' information criterion; the second pays for the choice among many candidates, 2 ln(m)
    where each of m has the same share of the prior.

    Args:
        samples: number of independent samples, N.
        share: of the prior probability, one entry a candidate; all shares together are 1.
    """
    earned: FloatArray = np.log(samples) - 2.0 * np.log(np.asarray(share, dtype=np.float64))
    return earned
