"""Where data leave the domain of a model: the ranges of states and inputs in the data that it came from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from odescope.arrays import FloatArray
from odescope.model.model import Model

MARGIN = 0.02  # of a range, by which noise alone may leave it
RARE = 1e-3  # of the samples outside: fewer are not worth a word


def outside_domain(model: Model, columns: Mapping[str, Sequence[FloatArray]]) -> Iterator[str]:
    """Yield a sentence for every state and input that is often outside the model's domain.

    The value of an angle and that of a cyclic coordinate may be anything: the equations do not hold them, or not their
    whole turns.

    Args:
        model: its domain may lack some.
        columns: samples (N,) of every recording, by name.
    """
    free = {c.name for c in model.coordinates if c.angle or c.cyclic}
    for name, samples in columns.items():
        if name in free or name not in model.domain:
            continue
        low, high = model.domain[name]
        values, slack = np.concatenate(list(samples)), MARGIN * (high - low)
        if not len(values):  # a rate that an observer never came to know
            continue
        outside = float(np.mean((values < low - slack) | (values > high + slack)))
        if outside > RARE:
            ends = (float(values.min()), float(values.max()), low, high)
            first, last, low_end, high_end = _as_texts(ends)
            part = "all" if outside == 1.0 else f"{min(100.0 * outside, 99.0):.2g} %"
            yield (
                f"{name} is from {first} to {last}, and {part} of it outside the data of the model,"
                f" {low_end} to {high_end}"
            )


def _as_texts(values: Sequence[float]) -> list[str]:
    """Return numbers with four digits, and as many more as all have alike, as seconds that count from 1970."""
    alike = max(map(abs, values)) / (max(values) - min(values))
    digits = 4 + max(int(np.log10(alike)), 0)
    return [f"{v:.{digits}g}" for v in values]
