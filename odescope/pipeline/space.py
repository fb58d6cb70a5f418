"""Candidates that go by the distance from the origin: they have a pole there, and stay where the motion stays away.

docs/method.md, Library.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.candidates import Library
from odescope.library.expression import Term
from odescope.library.spatial import from_origin, in_space
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.study.library_options import Form
from odescope.study.options import Mechanisms

AWAY = 0.05  # of the largest distance from the origin that the least is, at least
NEARLY = 0.01  # of the samples at either end that may be wrong


def near_origin(coordinates: Sequence[Coordinate], records: Records) -> tuple[frozenset[str], ...]:
    """Return the names of the components of every position that comes near the origin.

    Args:
        coordinates: that may be components of positions.
        records: what was measured of them.
    """
    found = list[frozenset[str]]()
    for names in ([c.name for c in group] for group in in_space(coordinates)):
        distances = np.concatenate([_distances(run, names) for run in records])
        low, high = np.quantile(distances, (NEARLY, 1.0 - NEARLY)) if len(distances) else (0.0, 0.0)
        if not low > AWAY * high:
            found.append(frozenset(names))
    return tuple(found)


def _distances(run: Record, names: Sequence[str]) -> FloatArray:
    """Return the distances from the origin where all components were measured."""
    there = np.all([run.counted(name) > 0.0 for name in names], axis=0)
    distances: FloatArray = np.linalg.norm([run.column(name)[there] for name in names], axis=0)
    return distances


def without_poles(libraries: Sequence[Library], near: Collection[frozenset[str]]) -> tuple[Library, ...]:
    """Return libraries without terms that go by the distance from an origin that the motion comes near to.

    Args:
        libraries: of the targets.
        near: see `near_origin`.
    """
    return tuple(Library(tuple(t for t in of if _sound(t, near)), of.removed) for of in libraries)


def mechanisms_without_poles(
    mechanisms: Mapping[Form, Mechanisms], near: Collection[frozenset[str]]
) -> dict[Form, Mechanisms]:
    """Return mechanisms without those that go by the distance from an origin that the motion comes near to.

    Args:
        mechanisms: of every form, with those that were left out.
        near: see `near_origin`.
    """
    return {
        form: (tuple(m for m in found if all(_sound(p.product.term, near) for p in m.parts)), left_out)
        for form, (found, left_out) in mechanisms.items()
    }


def _sound(term: Term, near: Collection[frozenset[str]]) -> bool:
    return from_origin(term) not in near
