"""A model beside its derivatives with respect to the states, as the observer's kernel takes them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.derivative import slope
from odescope.library.tape import Instructions, write_tape
from odescope.model.model import Model
from odescope.recordings.coordinate import following_states


class LinearisedModel(NamedTuple):
    """Equations A y = b and their derivatives.

    `instructions` compute from states, inputs and values of K signs the slots `outputs` (T * T + T,) of A, row by row,
    then b. following (n,) says for each state which state is its derivative, or -1 - (number of its target). edges
    (K, n + 1) are what the signs are of. gradient (G, 3) names what depends on a variable: entry of A and b, variable
    (states, then signs), slot of the derivative.
    """

    instructions: Instructions
    outputs: IntArray
    following: IntArray
    edges: FloatArray
    gradient: IntArray


def linearise(model: Model) -> LinearisedModel:
    """Return a model with the derivatives of its relations."""
    plain = model.switched
    signs = plain.names[len(model.variables) :]
    found = [
        (entry, number, slope(combination, name))
        for entry, combination in enumerate(plain.entries)
        for number, name in enumerate((*model.states, *signs))
    ]
    held = [(entry, number, part) for entry, number, part in found if part.parts]
    tape = write_tape(plain.names, [*plain.entries, *(part for _, _, part in held)])
    outputs, slots = np.split(tape.outputs, [len(plain.entries)])
    places = [(entry, number, int(slot)) for (entry, number, _), slot in zip(held, slots, strict=True)]
    return LinearisedModel(
        tape.instructions,
        outputs,
        following_states(model.coordinates),
        plain.edges,
        np.array(places, dtype=np.int64).reshape(-1, 3),
    )
