"""Candidates of a default library that a record rules out: poles where its motion is, powers of what has two values.

docs/method.md, Library.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from odescope.arrays import FloatArray, robust_deviation
from odescope.library.candidates import Library
from odescope.library.expression import Name, Term
from odescope.library.friction import rubs
from odescope.library.spatial import from_origin, in_space
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.study.library_options import Form
from odescope.study.options import Mechanisms, Study

AWAY = 0.05  # of the largest distance from the origin that the least is, at least
NEARLY = 0.01  # of the samples at either end that may be wrong
TAIL = 0.05  # of the samples at either end, beyond which a state of both signs is found
BOTH = 0.1  # of the larger end that the smaller one is, at least,
FEW = 3  # values of an input, of which higher powers say no more than lower ones
COUNTS = {2: "two", 3: "three"}
BY_NOISE = 2.0  # less so many standard deviations of the noise: noise around zero is no sign

Stays: TypeAlias = Callable[[Term], bool]


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


def of_one_sign(coordinates: Sequence[Coordinate], records: Records) -> tuple[frozenset[str], ...]:
    """Return the name of every state of order 1 that hardly takes both signs, by itself: it is no speed to and fro.

    Args:
        coordinates: that may be speeds.
        records: what was measured of them.
    """
    found = list[frozenset[str]]()
    for name in (c.name for c in coordinates if c.order == 1):
        runs = [run.column(name)[run.counted(name) > 0.0] for run in records]
        values = np.concatenate(runs)
        bends = np.concatenate([v[1:-1] - 0.5 * (v[:-2] + v[2:]) for v in runs])
        low, high = np.quantile(values, (TAIL, 1.0 - TAIL)) if len(values) else (0.0, 0.0)
        noise = robust_deviation(bends) / np.sqrt(1.5) if len(bends) else 0.0
        below, above = -low - BY_NOISE * noise, high - BY_NOISE * noise
        if not min(below, above) > BOTH * max(below, above):
            found.append(frozenset({name}))
    return tuple(found)


def few_values(inputs: Collection[str], records: Records) -> dict[str, int]:
    """Return how many values an input has, by its name, where these are so few that its powers are no more functions.

    Of two values all functions are lines, of three they are parabolas.

    Args:
        inputs: names of those.
        records: what was recorded of them.
    """
    columns = {name: np.unique(np.concatenate([run.column(name) for run in records])) for name in inputs}
    counted = {name: int(np.isfinite(values).sum()) for name, values in columns.items()}
    return {name: count for name, count in counted.items() if 1 < count <= FEW}


def few_candidates(study: Study, degree: int | None, records: Records) -> Iterator[str]:
    """Yield why a library has fewer candidates than the usual.

    Args:
        study: says what the candidates are.
        degree: of the candidates at most, None for the usual one.
        records: what was recorded.
    """
    options = study.library
    if degree != options.own_degree:
        few = f"{records.samples} samples cannot decide between all of the default library"
        yield f"{few}: its candidates are of degree {degree} at most"
    most = options.degree if degree is None else degree
    for name, count in few_values(_among_candidates(study), records).items():
        if count <= most:
            powers = f"{name}**{count}" if count == most else f"{name}**{count} and higher powers"
            yield f"{name} has only {COUNTS[count]} values, of which {powers} would say nothing new: left out"


def not_ruled_out(study: Study, records: Records) -> Stays:
    """Return what says of a candidate term whether it stays: what a user names does in any case.

    Args:
        study: says what the candidates are.
        records: what was measured.
    """
    options, coordinates = study.library, study.measured()
    named = set(Library.of((*options.extra, *(options.basis or ())), study.scope()))
    few = few_values(_among_candidates(study), records)
    near = near_origin(coordinates, records) if options.by_default and options.potential is None else ()
    smooth = of_one_sign(coordinates, records) if options.by_default else ()

    def stays(term: Term) -> bool:
        beyond = any(term.power_of(Name(name)) >= count for name, count in few.items())
        return term in named or not (beyond or from_origin(term) in near or rubs(term) in smooth)

    return stays


def _among_candidates(study: Study) -> list[str]:
    """Return the inputs that products of the library hold as they are."""
    basis = study.library.basis or ()
    return [name for name in study.inputs if study.library.by_default or name in basis]


def mechanisms_that_stay(mechanisms: Mapping[Form, Mechanisms], stays: Stays) -> dict[Form, Mechanisms]:
    """Return mechanisms without those that hold a term that is ruled out.

    Args:
        mechanisms: of every form, with those that were left out.
        stays: see `not_ruled_out`.
    """
    return {
        form: (tuple(m for m in found if all(stays(p.product.term) for p in m.parts)), left_out)
        for form, (found, left_out) in mechanisms.items()
    }
