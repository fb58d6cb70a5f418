"""Relations compiled for the kernel: where every coefficient stands, and a tape of the terms and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from odescope.arrays import IntArray
from odescope.library.derivative import derivative
from odescope.library.product import Product
from odescope.library.tape import Tape, write_tape
from odescope.recordings.coordinate import Coordinate, following_states, state_names


@dataclass(frozen=True)
class Part:
    """Where a coefficient stands: in one relation, before one product."""

    relation: int
    product: Product


@dataclass(frozen=True, eq=False)
class Frame:
    """What the relations are about; the same for all structures.

    Shapes: following (n,) is for each state the state that is its derivative, or -1 - (number of its target); measured
    (c,) the states that are measured.
    """

    states: tuple[str, ...]
    targets: tuple[str, ...]
    inputs: tuple[str, ...]
    following: IntArray
    measured: IntArray

    @staticmethod
    def of(coordinates: Sequence[Coordinate], inputs: Sequence[str]) -> Frame:
        """Return the frame of these coordinates and inputs."""
        states = state_names(coordinates)
        measured = np.array([states.index(c.name) for c in coordinates], dtype=np.int64)
        targets = tuple(c.target for c in coordinates)
        return Frame(states, targets, tuple(inputs), following_states(coordinates), measured)

    @property
    def variables(self) -> tuple[str, ...]:
        """States, then inputs: the rows that a tape reads."""
        return (*self.states, *self.inputs)

    def held(self, part: Part) -> bool:
        """Whether a part is the relation's own bare target, whose coefficient is 1 and no parameter."""
        return part.product == Product(self.targets[part.relation])


class Places(NamedTuple):
    """Where the kernel finds what: one entry a part, but for grad (K, 3): part, state, slot of the derivative.

    slot: of the term on the tape; owner: the relation; factor: the target's number, -1 for 1; following and measured
    as in `Frame`.
    """

    slot: IntArray
    owner: IntArray
    factor: IntArray
    grad: IntArray
    following: IntArray
    measured: IntArray


@dataclass(frozen=True, eq=False)
class Program:
    """Parts compiled for the kernel."""

    parts: tuple[Part, ...]
    tape: Tape
    places: Places
    targets: int

    @staticmethod
    def of(parts: Sequence[Part], frame: Frame) -> Program:
        """Return the program of these parts."""
        gradients = []
        for k, part in enumerate(parts):
            for i, state in enumerate(frame.states):
                if state in part.product.term.names:
                    combination = derivative(part.product.term, state)
                    if combination.parts:
                        gradients.append((k, i, combination))
        tape = write_tape(frame.variables, [*(p.product.term for p in parts), *(g for _, _, g in gradients)])
        slot, rest = tape.outputs[: len(parts)], tape.outputs[len(parts) :]
        grad = np.array([(k, i, place) for (k, i, _), place in zip(gradients, rest, strict=True)], dtype=np.int64)
        number = {target: k for k, target in enumerate(frame.targets)}
        factor = [-1 if p.product.factor is None else number[p.product.factor] for p in parts]
        places = Places(
            slot=slot,
            owner=np.array([p.relation for p in parts], dtype=np.int64),
            factor=np.array(factor, dtype=np.int64),
            grad=grad.reshape(-1, 3),
            following=frame.following,
            measured=frame.measured,
        )
        return Program(tuple(parts), tape, places, len(frame.targets))

    @property
    def following(self) -> IntArray:
        """As in `Frame`."""
        return self.places.following
