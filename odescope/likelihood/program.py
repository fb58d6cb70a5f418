"""Mechanisms compiled for the kernel: where every coefficient stands, and a tape of the terms and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.derivative import derivative
from odescope.library.mechanism import Mechanism
from odescope.library.product import Product
from odescope.library.tape import Tape, write_tape
from odescope.recordings.coordinate import Coordinate, following_states, state_names


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

    def own(self, mechanism: Mechanism) -> bool:
        """Whether a mechanism is a relation's own target, bare and alone."""
        first, *rest = mechanism.parts
        return not rest and first.product == Product(self.targets[first.relation])


class Places(NamedTuple):
    """Where the kernel finds what: one entry a part, but for grad (K, 3): part, state, slot of the derivative.

    mechanism: whose part it is, share: of its coefficient; slot: of the term on the tape; owner: the relation; factor:
    the target's number, -1 for 1; following and measured as in `Frame`.
    """

    mechanism: IntArray
    share: FloatArray
    slot: IntArray
    owner: IntArray
    factor: IntArray
    grad: IntArray
    following: IntArray
    measured: IntArray


@dataclass(frozen=True, eq=False)
class Program:
    """Mechanisms compiled for the kernel."""

    mechanisms: tuple[Mechanism, ...]
    tape: Tape
    places: Places
    targets: int

    @staticmethod
    def of(mechanisms: Sequence[Mechanism], frame: Frame) -> Program:
        """Return the program of these mechanisms."""
        owned = [(number, part) for number, mechanism in enumerate(mechanisms) for part in mechanism.parts]
        gradients = []
        for k, (_, part) in enumerate(owned):
            for i, state in enumerate(frame.states):
                if state in part.product.term.names:
                    combination = derivative(part.product.term, state)
                    if combination.parts:
                        gradients.append((k, i, combination))
        tape = write_tape(frame.variables, [*(p.product.term for _, p in owned), *(g for _, _, g in gradients)])
        slot, rest = tape.outputs[: len(owned)], tape.outputs[len(owned) :]
        grad = np.array([(k, i, place) for (k, i, _), place in zip(gradients, rest, strict=True)], dtype=np.int64)
        number = {target: k for k, target in enumerate(frame.targets)}
        factor = [-1 if p.product.factor is None else number[p.product.factor] for _, p in owned]
        places = Places(
            mechanism=np.array([m for m, _ in owned], dtype=np.int64),
            share=np.array([p.share for _, p in owned], dtype=np.float64),
            slot=slot,
            owner=np.array([p.relation for _, p in owned], dtype=np.int64),
            factor=np.array(factor, dtype=np.int64),
            grad=grad.reshape(-1, 3),
            following=frame.following,
            measured=frame.measured,
        )
        return Program(tuple(mechanisms), tape, places, len(frame.targets))

    @property
    def following(self) -> IntArray:
        """As in `Frame`."""
        return self.places.following
