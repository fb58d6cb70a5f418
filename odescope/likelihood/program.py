"""Mechanisms compiled for the kernel: where every coefficient stands, and a tape of the terms and their derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.derivative import derivative
from odescope.library.expression import Combination, Term
from odescope.library.mechanism import Mechanism
from odescope.library.product import Product
from odescope.library.tape import Tape, write_tape
from odescope.recordings.coordinate import Coordinate, following_states, state_names

LARGEST = 8.0  # power of e that a constant may be larger than without its mechanism


@dataclass(frozen=True, eq=False)
class Frame:
    """What the relations are about; the same for all structures.

    Shapes: following (n,) is for each state the state that is its derivative, or -1 - (number of its target); measured
    (c,) the states that are measured; `constants` are those within functions, by name, each with the value that it has
    where the record does not ask for another.
    """

    states: tuple[str, ...]
    targets: tuple[str, ...]
    inputs: tuple[str, ...]
    following: IntArray
    measured: IntArray
    constants: Mapping[str, float]

    @staticmethod
    def of(
        coordinates: Sequence[Coordinate], inputs: Sequence[str], constants: Mapping[str, float] | None = None
    ) -> Frame:
        """Return the frame.

        Args:
            coordinates: what was measured.
            inputs: what drove it, by name.
            constants: those within functions, each with its value.
        """
        states = state_names(coordinates)
        measured = np.array([states.index(c.name) for c in coordinates], dtype=np.int64)
        targets = tuple(c.target for c in coordinates)
        return Frame(states, targets, tuple(inputs), following_states(coordinates), measured, constants or {})

    @property
    def variables(self) -> tuple[str, ...]:
        """States, then inputs."""
        return (*self.states, *self.inputs)

    def value(self, constant: str, coefficient: float) -> float:
        """Return the value of a constant: its own times e to the coefficient of its mechanism, but no less."""
        return self.constants[constant] * float(np.exp(np.clip(coefficient, 0.0, LARGEST)))

    def own(self, mechanism: Mechanism) -> bool:
        """Whether a mechanism is a relation's own target, bare and alone."""
        alone = len(mechanism.parts) == 1
        return alone and all(p.product == Product(self.targets[p.relation]) for p in mechanism.parts)


class Places(NamedTuple):
    """Where the kernel finds what: one entry a part, but for grad (K, 3): part, state, slot of the derivative.

    mechanism: whose part it is, share: of its coefficient; slot: of the term on the tape; owner: the relation; factor:
    the target's number, -1 for 1; following and measured as in `Frame`. within (Q, 3): part, slot of its derivative
    with respect to an input that may be late or to a constant, and slot of what this gains with its mechanism's
    coefficient, which is `wanted` (Q,).
    """

    mechanism: IntArray
    share: FloatArray
    slot: IntArray
    owner: IntArray
    factor: IntArray
    grad: IntArray
    within: IntArray
    wanted: IntArray
    following: IntArray
    measured: IntArray


@dataclass(frozen=True, eq=False)
class Program:
    """Mechanisms compiled for the kernel."""

    mechanisms: tuple[Mechanism, ...]
    frame: Frame
    tape: Tape
    places: Places
    targets: int

    @staticmethod
    def of(mechanisms: Sequence[Mechanism], frame: Frame) -> Program:
        """Return the program of these mechanisms."""
        owned = [(number, part) for number, mechanism in enumerate(mechanisms) for part in mechanism.parts]
        terms = [p.product.term for _, p in owned]
        late = any(m.kind == "delay" for m in mechanisms)
        # What an input gains with its delay stands beside the inputs, under names that no input has.
        rows = [*frame.variables, *(f"{name}'" for name in frame.inputs if late), *frame.constants]
        gradients = _slopes(terms, dict(enumerate(frame.states)))
        free = {k: m.place for k, m in enumerate(mechanisms) if m.kind in ("delay", "constant")}
        within = _slopes(terms, free)
        tape = write_tape(rows, [*terms, *(g for _, _, g in gradients), *(g for _, _, g in within)])
        slot, slopes, inner = np.split(tape.outputs, [len(owned), len(owned) + len(gradients)])
        grad = [(k, i, place) for (k, i, _), place in zip(gradients, slopes, strict=True)]
        gain = {k: rows.index(f"{place}'" if mechanisms[k].kind == "delay" else place) for k, place in free.items()}
        number = {target: k for k, target in enumerate(frame.targets)}
        factor = [-1 if p.product.factor is None else number[p.product.factor] for _, p in owned]
        places = Places(
            mechanism=np.array([m for m, _ in owned], dtype=np.int64),
            share=np.array([p.share for _, p in owned], dtype=np.float64),
            slot=slot,
            owner=np.array([p.relation for _, p in owned], dtype=np.int64),
            factor=np.array(factor, dtype=np.int64),
            grad=np.array(grad, dtype=np.int64).reshape(-1, 3),
            within=np.array(
                [(k, place, gain[m]) for (k, m, _), place in zip(within, inner, strict=True)], dtype=np.int64
            ).reshape(-1, 3),
            wanted=np.array([m for _, m, _ in within], dtype=np.int64),
            following=frame.following,
            measured=frame.measured,
        )
        return Program(tuple(mechanisms), frame, tape, places, len(frame.targets))

    @property
    def following(self) -> IntArray:
        """As in `Frame`."""
        return self.places.following

    @cached_property
    def offsets(self) -> IntArray:
        """The mechanism that is the offset of each measured state, -1 for none, (c,)."""
        places = {m.place: k for k, m in enumerate(self.mechanisms) if m.kind == "offset"}
        return np.array([places.get(self.frame.states[s], -1) for s in self.frame.measured], dtype=np.int64)

    @cached_property
    def _late(self) -> dict[str, int]:
        return {m.place: k for k, m in enumerate(self.mechanisms) if m.kind == "delay"}

    def delays(self, theta: FloatArray) -> tuple[float, ...] | None:
        """Return the delay of every input, in seconds; None where no mechanism says so."""
        if not self._late:
            return None
        return tuple(float(theta[self._late[name]]) if name in self._late else 0.0 for name in self.frame.inputs)

    def constants(self, theta: FloatArray) -> FloatArray:
        """Return the values of the frame's constants, (constants,)."""
        moved = {m.place: theta[k] for k, m in enumerate(self.mechanisms) if m.kind == "constant"}
        return np.array([self.frame.value(name, moved.get(name, 0.0)) for name in self.frame.constants])


def _slopes(terms: Sequence[Term], names: Mapping[int, str]) -> list[tuple[int, int, Combination]]:
    """Return the derivatives of terms that are not zero: number of the term, number of the name, derivative."""
    found = []
    for k, term in enumerate(terms):
        for number, name in names.items():
            if name in term.names:
                combination = derivative(term, name)
                if combination.parts:
                    found.append((k, number, combination))
    return found
