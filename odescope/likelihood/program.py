"""Mechanisms compiled for the kernel: where every coefficient stands, and a tape of the terms and their derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.constants import Constant
from odescope.library.derivative import derivative, slope
from odescope.library.expression import ONE, Call, Combination, Name, Term
from odescope.library.mechanism import Mechanism
from odescope.library.product import Product
from odescope.library.tape import Tape, write_tape
from odescope.likelihood.centring import Centring
from odescope.likelihood.layers import Layers
from odescope.likelihood.slopes import Effects
from odescope.recordings.coordinate import Coordinate, following_states, state_names

MOST_OFFSET = 0.25 * np.pi  # rad


@dataclass(frozen=True, eq=False)
class Frame:
    """What the relations are about; the same for all structures.

    Shapes: following (n,) is for each state the state that is its derivative, or -1 - (number of its target); measured
    (c,) the states that are measured; `constants` are those within functions, by name, and `centring` says about what
    these act: coefficients are those of the centred terms.
    """

    states: tuple[str, ...]
    targets: tuple[str, ...]
    inputs: tuple[str, ...]
    following: IntArray
    measured: IntArray
    constants: Mapping[str, Constant]
    centring: Centring = field(default_factory=Centring)

    @staticmethod
    def of(
        coordinates: Sequence[Coordinate],
        inputs: Sequence[str],
        constants: Mapping[str, Constant] | None = None,
        centring: Centring | None = None,
    ) -> Frame:
        """Return the frame.

        Args:
            coordinates: what was measured.
            inputs: what drove it, by name.
            constants: those within functions.
            centring: of these; none by default.
        """
        states = state_names(coordinates)
        measured = np.array([states.index(c.name) for c in coordinates], dtype=np.int64)
        targets = tuple(c.target for c in coordinates)
        following, constants = following_states(coordinates), constants or {}
        return Frame(states, targets, tuple(inputs), following, measured, constants, centring or Centring())

    @property
    def variables(self) -> tuple[str, ...]:
        """States, then inputs."""
        return (*self.states, *self.inputs)

    def own(self, mechanism: Mechanism) -> bool:
        """Whether a mechanism is a relation's own target, bare and alone."""
        alone = len(mechanism.parts) == 1
        return alone and all(p.product == Product(self.targets[p.relation]) for p in mechanism.parts)


class Places(NamedTuple):
    """Where the kernel finds what: one entry a part, but for grad (K, 3): part, state, slot of the derivative.

    mechanism: whose part it is, share: of its coefficient; slot: of the term on the tape; owner: the relation; factor:
    the target's number, -1 for 1; following and measured as in `Frame`. within (Q, 2): part, slot of its derivative
    with respect to the coefficient of a delay or a constant, which is that of the mechanism `wanted` (Q,).
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


class _Friction(NamedTuple):
    """A part with dry friction: its mechanism, the number of its width, its share.

    inertia (mechanisms,) holds the shares of the mechanisms that multiply the target of its relation by a number.
    """

    mechanism: int
    width: int
    share: float
    inertia: FloatArray


@dataclass(frozen=True, eq=False)
class Program:
    """Mechanisms compiled for the kernel."""

    mechanisms: tuple[Mechanism, ...]
    frame: Frame
    tape: Tape
    places: Places
    layers: Layers
    targets: int

    @staticmethod
    @lru_cache(maxsize=256)  # a search fits, judges and weighs the same model one after the other
    def of(mechanisms: tuple[Mechanism, ...], frame: Frame) -> Program:
        """Return the program of these mechanisms."""
        owned = [(number, part) for number, mechanism in enumerate(mechanisms) for part in mechanism.parts]
        terms = [frame.centring.centred(p.product.term) for _, p in owned]
        late = any(m.kind == "delay" for m in mechanisms)
        # What an input gains with its delay stands beside the inputs, under names that no input has.
        rows = [*frame.variables, *(f"{name}'" for name in frame.inputs if late), *frame.constants]
        gradients = _slopes(terms, dict(enumerate(frame.states)))
        free = {k: m for k, m in enumerate(mechanisms) if m.kind in ("delay", "constant")}
        gains = {k: _gain(m, frame) for k, m in free.items()}
        slopes = _slopes(terms, {k: m.place for k, m in free.items()})
        jumps = [_jumps(t, frame) for t in terms]
        dry = list(dict.fromkeys(a for found in jumps for a in found))
        nearing = [slope(a, name) for a in dry for name in frame.variables]
        within = [(k, m, Combination.of((c * gains[m][0], t * gains[m][1]) for c, t in s.parts)) for k, m, s in slopes]
        of_gradients, of_within = [g for *_, g in gradients], [g for *_, g in within]
        written: list[Sequence[Term | Combination]] = [terms, of_gradients, of_within, dry, nearing]
        tape = write_tape(rows, [e for expressions in written for e in expressions])
        slot, outer, inner, z, dz = np.split(tape.outputs, np.cumsum([len(e) for e in written])[:-1])
        grad = [(k, i, place) for (k, i, _), place in zip(gradients, outer, strict=True)]
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
                [(k, place) for (k, _, _), place in zip(within, inner, strict=True)], dtype=np.int64
            ).reshape(-1, 2),
            wanted=np.array([m for _, m, _ in within], dtype=np.int64),
            following=frame.following,
            measured=frame.measured,
        )
        layers = Layers(
            slot=z,
            slope=np.where([bool(n.parts) for n in nearing], dz, -1).reshape(-1, len(frame.variables)),
            part=np.array([(dry.index(a), k) for k, found in enumerate(jumps) for a in found], dtype=np.int64).reshape(
                -1, 2
            ),
        )
        return Program(mechanisms, frame, tape, places, layers, len(frame.targets))

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
        return np.array([c.at(moved.get(name, 0.0)) for name, c in self.frame.constants.items()])

    @cached_property
    def _friction(self) -> list[_Friction]:
        widths = {name: k for k, (name, c) in enumerate(self.frame.constants.items()) if c.optional}
        bare = np.zeros((self.targets, len(self.mechanisms)))
        for m, mechanism in enumerate(self.mechanisms):
            for part in mechanism.parts:
                if part.product == Product(self.frame.targets[part.relation]):
                    bare[part.relation, m] += part.share
        return [
            _Friction(m, widths[name], part.share, bare[part.relation])
            for m, mechanism in enumerate(self.mechanisms)
            for part in mechanism.parts
            for name in widths.keys() & set(part.product.term.names)
        ]

    def decay(self, theta: FloatArray) -> float:
        """Return the rate, in 1/s, at which dry friction slows down what slides within the layer of tanh(v/w), at most.

        Where a target stands with functions alone its rate is taken for none.

        Args:
            theta: (mechanisms,) coefficients; friction that is absent slows nothing down.
        """
        widths, fastest = self.constants(theta) if self._friction else np.zeros(0), 0.0
        for friction in self._friction:
            force, inertia = abs(friction.share * theta[friction.mechanism]), abs(float(friction.inertia @ theta))
            if force > 0.0 and inertia > 0.0:
                fastest = max(fastest, force / inertia / widths[friction.width])
        return fastest

    @cached_property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """The least and the largest coefficients, (mechanisms,): those of constants that any model has are bounded.

        So are offsets: an angle whose zero is further off has sines in the place of cosines.
        """
        limits = np.tile([[-np.inf], [np.inf]], len(self.mechanisms))
        for k, m in enumerate(self.mechanisms):
            if m.kind == "offset":
                limits[:, k] = -MOST_OFFSET, MOST_OFFSET
            if m.kind == "constant" and not self.frame.constants[m.place].optional:
                limits[:, k] = self.frame.constants[m.place].limits
        return limits[0], limits[1]


def effects_of(places: Places, weight: FloatArray, number: IntArray, count: int) -> Effects:
    """Return where the parameters act.

    Args:
        places: of a program.
        weight: (parts,) coefficients, shares included.
        number: (mechanisms,) the parameter that the coefficient of each is, -1 for none.
        count: of parameters.
    """
    own, inner = number[places.mechanism], places.within[:, 0]
    within = np.where(weight[inner] != 0.0, number[places.wanted], -1)
    parameter = np.concatenate([own, within])
    order = np.argsort(parameter, kind="stable")[np.count_nonzero(parameter < 0) :]
    return Effects(
        np.concatenate([np.arange(len(own)), inner])[order],
        np.concatenate([places.slot, places.within[:, 1]])[order],
        np.concatenate([places.share, weight[inner]])[order],
        np.searchsorted(parameter[order], np.arange(count + 1)),
    )


def _gain(mechanism: Mechanism, frame: Frame) -> tuple[float, Term]:
    """Return what an input or a constant gains with the coefficient of its mechanism, as a number times a term."""
    if mechanism.kind == "delay":
        return 1.0, Term(((Name(f"{mechanism.place}'"), 1),))
    constant = frame.constants[mechanism.place]
    return (1.0, Term(((Name(constant.name), 1),))) if constant.relative else (constant.reach, ONE)


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


def _jumps(term: Term, frame: Frame) -> list[Combination]:
    """Return the arguments of the functions in a term that stand for a sign: their widths are optional constants."""
    widths = {name for name, c in frame.constants.items() if c.optional}
    calls = [atom for atom, _ in term.factors if isinstance(atom, Call)]
    return [call.argument for call in calls if call.function == "tanh" and call.argument.names & widths]
