"""The sizes of a model's states in their units, by which an integration tells what is next to nothing."""

from __future__ import annotations

import numpy as np

from odescope.arrays import FloatArray
from odescope.model.model import Model

NEGLIGIBLE = 1e-6  # of the largest initial state: one that is smaller says nothing of the size of its state
LEAST = 1e-290  # with a tolerance that is still a number


def small_sizes(model: Model, initial: FloatArray | None = None) -> FloatArray:
    """Return the sizes (n,) of states where these are below 1, and 1 where they are not.

    That of a state is the largest value that it had in the data of the model. Where nothing is known of these it is its
    initial value, of one that starts at or about zero the largest of all, which may have another unit.

    Args:
        model: its domain may lack some.
        initial: (n,) in the order of the states.
    """
    begin = np.zeros(len(model.states)) if initial is None else np.abs(initial)
    largest = float(begin.max()) or 1.0
    guess = np.where(begin > NEGLIGIBLE * largest, begin, largest)
    known = [max(map(abs, model.domain[s])) if s in model.domain else 0.0 for s in model.states]
    sizes = np.where(np.array(known) > 0.0, known, guess)
    small: FloatArray = np.clip(np.nan_to_num(sizes, nan=1.0), LEAST, 1.0)
    return small
