"""Coefficients by least squares in the linear relations at the smoothed states: another place for a fit to begin.

Far from the record a fit to trajectories has many minima. Mechanisms that are shared by relations may end with the
wrong sign in one of them, from which no step of Gauss and Newton leads away; the linear relations have one minimum.
docs/method.md, Structure by likelihood.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.mechanism import scale_groups
from odescope.likelihood.fit import Fit
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.smoothed_targets import rates

PASSES = 2  # weights of relations follow from what the pass before has left of them


def by_least_squares(space: SearchSpace, found: Fit) -> FloatArray | None:
    """Return coefficients (mechanisms,) of what is present that leave the least of the linear relations.

    Every scale group by itself, in the scale of what is known of it, if anything; columns have unit norm. Settings, and
    constants within functions, stay as they are. None where a term has no value at some smoothed state.

    Args:
        space: data and candidates.
        found: the model.
    """
    theta = found.theta.copy()
    for group, columns in _columns(space, found):
        if not np.isfinite(columns).all():
            return None
        weights = 1.0 / np.maximum(_size(columns).max(axis=0), 1e-300)
        known = np.array([space.mechanisms[k].known or 0.0 for k in group])
        for _ in range(PASSES):
            theta[group] = _least(columns * weights[:, None], known)
            left = np.tensordot(theta[group], columns, axes=1)
            weights = 1.0 / np.maximum(_size(left), 1e-9 * _size(columns).max(axis=0))
    return theta


def _columns(space: SearchSpace, found: Fit) -> Iterator[tuple[list[int], FloatArray]]:
    """Yield the mechanisms of each scale group, and what they are in its relations at the smoothed states.

    The latter (mechanisms, relations, N), with targets as differences of the smoothed states have them.
    """
    parts = [(k, p) for k in found.present.tolist() for p in space.mechanisms[k].parts]
    values = space.evaluated([p.product.term for _, p in parts], found.theta)
    targets = dict(zip(space.frame.targets, rates(space), strict=True))
    for group in scale_groups(space.mechanisms, found.present):
        own = list(group)
        relations = sorted({r for k in own for r in space.mechanisms[k].relations})
        columns = np.zeros((len(own), len(relations), values.shape[1]))
        for (k, part), value in zip(parts, values, strict=True):
            if k in own:
                factor = part.product.factor
                by = 1.0 if factor is None else targets[factor]
                columns[own.index(k), relations.index(part.relation)] += part.share * value * by
        yield own, columns


def _size(columns: FloatArray) -> FloatArray:
    """Return root mean squares over samples."""
    size: FloatArray = np.sqrt(np.mean(columns**2, axis=-1))
    return size


def _least(columns: FloatArray, known: FloatArray) -> FloatArray:
    """Return coefficients (p,) of columns (p, relations, N) that leave the least, those that are known as given.

    Args:
        columns: what multiplies them.
        known: (p,) their values, 0 for the others; where all are 0, of norm 1 in units of the columns.
    """
    rows = columns.reshape(len(columns), -1)
    scale = np.maximum(np.linalg.norm(rows, axis=1), 1e-300)
    rows = rows / scale[:, None]
    found, free = known * scale, known == 0.0
    if free.all():
        found = np.linalg.eigh(rows @ rows.T)[1][:, 0]
    else:
        found[free] = np.linalg.lstsq(rows[free].T, -found[~free] @ rows[~free], rcond=None)[0]
    result: FloatArray = found / scale
    return result
