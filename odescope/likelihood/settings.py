"""Parameters beside coefficients: offsets of sensors, delays of inputs, and the widths of dry friction.

Each is a mechanism without parts, which a search adds and drops like a term. docs/method.md, Parameters beside
coefficients.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from odescope.arrays import FloatArray
from odescope.library.expression import ONE, Atom, Call, Combination, Name, Power, Term
from odescope.library.mechanism import Kind, Mechanism, merged
from odescope.library.product import Product
from odescope.library.tape import evaluate, write_tape
from odescope.model.relation import FoundParameter
from odescope.model.scores import DelayScore, OffsetScore
from odescope.recordings.coordinate import Coordinate, Hold, Input
from odescope.signals.estimate import Signals

SHARP = 0.001  # width of dry friction, in root mean squares of the velocity, that is as good as a jump


@dataclass(frozen=True)
class FoundSettings:
    """What was found beside coefficients: offsets by coordinate, delays by input, and constants within functions.

    Only what the record asks for is here; delays are in seconds, and come on top of those that were known. `holds` says
    of inputs what they do between samples.
    """

    offsets: Mapping[str, OffsetScore]
    delays: Mapping[str, DelayScore]
    parameters: tuple[FoundParameter, ...]
    holds: Mapping[str, Hold]

    def coordinates(self, coordinates: Sequence[Coordinate]) -> tuple[Coordinate, ...]:
        """Return the coordinates with their offsets."""
        return tuple(
            msgspec.structs.replace(c, offset=self.offsets[c.name].offset) if c.name in self.offsets else c
            for c in coordinates
        )

    def inputs(self, inputs: Sequence[Input]) -> tuple[Input, ...]:
        """Return the inputs with their delays and holds."""
        delays = {name: found.delay for name, found in self.delays.items()}
        return tuple(
            msgspec.structs.replace(i, delay=i.delay + delays.get(i.name, 0.0), hold=self.holds.get(i.name, i.hold))
            for i in inputs
        )


def with_settings(
    mechanisms: Sequence[Mechanism], signals: Signals, late: Collection[str]
) -> tuple[tuple[Mechanism, ...], dict[str, float]]:
    """Return the mechanisms with dry friction of a finite width and the settings after them, and the widths.

    sign(v) jumps where v passes zero, and no integrator and no derivative stands that: it becomes tanh(v/w), w a
    constant of its own for every argument.

    Args:
        mechanisms: the candidates.
        signals: where the sizes of velocities are seen.
        late: names of the inputs whose delays are open.
    """
    arguments = {a.text: a for m in mechanisms for p in m.parts for a in _signs(p.product.term)}
    widths, constants = dict[str, Atom](), dict[str, float]()
    for number, (text, argument) in enumerate(sorted(arguments.items()), start=1):
        plain = text if text.isidentifier() else str(number)
        name = f"width_{plain}"
        while name in signals.names:
            name += "_"
        widths[text] = Name(name)
        constants[name] = _width(argument, signals)
    smooth = [_smooth(m, widths) for m in mechanisms] if widths else list(mechanisms)
    known = frozenset[str]().union(*(m.names for m in smooth))
    angles = [c.name for c in signals.coordinates if c.angle and not c.cyclic and c.name in known]
    inputs = [i.name for i in signals.inputs if i.name in late and i.name in known]
    settings: list[tuple[Kind, str]] = [("offset", a) for a in angles]
    settings += [("delay", i) for i in inputs]
    settings += [("constant", c) for c in constants]
    return (*smooth, *(Mechanism(kind, f"{kind} {place}", place, (), 0.0) for kind, place in settings)), constants


def _width(argument: Combination, signals: Signals) -> float:
    """Return the width, two digits of it, that is next to nothing for this argument."""
    values = evaluate(write_tape(signals.names, [argument]), signals.joined())[0]
    return float(f"{max(SHARP * float(np.sqrt(np.mean(values**2))), 1e-300):.2g}")


def _signs(term: Term) -> list[Combination]:
    """Return the arguments of all signs in a term."""
    calls = [atom for atom, _ in term.factors if isinstance(atom, Call)]
    inner = [a for call in calls for _, t in call.argument.parts for a in _signs(t)]
    return [*(call.argument for call in calls if call.function == "sign"), *inner]


def _smooth(mechanism: Mechanism, widths: Mapping[str, Atom]) -> Mechanism:
    """Return a mechanism with tanh(v/w) for every sign(v)."""
    parts = (replace(p, product=Product(p.product.factor, _smoothed(p.product.term, widths))) for p in mechanism.parts)
    return replace(mechanism, parts=tuple(parts))


def _smoothed(term: Term, widths: Mapping[str, Atom]) -> Term:
    factors: list[tuple[Atom, Power]] = []
    for atom, power in term.factors:
        if isinstance(atom, Call):
            inner = Combination.of((c, _smoothed(t, widths)) for c, t in atom.argument.parts)
            smooth = Call(atom.function, inner)
            if atom.function == "sign":
                width = widths[atom.argument.text]
                smooth = Call("tanh", Combination.of((c, t.over(width)) for c, t in inner.parts))
            factors.append((smooth, power))
        else:
            factors.append((atom, power))
    return Term.of(factors)


def with_values(mechanism: Mechanism, values: Mapping[str, float | None]) -> Mechanism:
    """Return a mechanism with numbers for its constants, and sign(v) again where nothing is known of the width.

    Args:
        mechanism: whose terms may name constants.
        values: of all constants, by name; None for one that the record does not ask for.
    """
    if not mechanism.names & set(values):
        return mechanism
    parts = []
    for p in mechanism.parts:
        share, term = _substituted(p.product.term, values)
        parts.append(replace(p, product=Product(p.product.factor, term), share=p.share * share))
    return replace(mechanism, parts=merged(parts))


def _substituted(term: Term, values: Mapping[str, float | None]) -> tuple[float, Term]:
    """Return a term with numbers for some names, as a number times a term."""
    share, rest = 1.0, ONE
    for atom, power in term.factors:
        if isinstance(atom, Call):
            jump = any(values.get(name, 0.0) is None for name in atom.argument.names)
            inner = [(c, *_substituted(t, values)) for c, t in atom.argument.parts]
            argument = Combination.of((c * k, t) for c, k, t in inner)
            rest *= Term(((Call("sign" if jump and atom.function == "tanh" else atom.function, argument), power),))
        elif atom.name in values:
            value = values[atom.name]
            share *= 1.0 if value is None else value**power
        else:
            rest *= Term(((atom, power),))
    return share, rest


def settings_of(
    mechanisms: Sequence[Mechanism],
    theta: FloatArray,
    covariance: FloatArray,
    constants: Mapping[str, float | None],
    holds: Mapping[str, Hold],
) -> FoundSettings:
    """Return what mechanisms without parts say, with what inputs do between samples.

    Args:
        mechanisms: those that are present.
        theta: (k,) their coefficients.
        covariance: (k, k) of these.
        constants: values of all constants, by name; None for one that the record does not ask for.
        holds: by input.
    """
    offsets, delays, parameters = dict[str, OffsetScore](), dict[str, DelayScore](), list[FoundParameter]()
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    for m, value, error in zip(mechanisms, theta.tolist(), errors.tolist(), strict=True):
        if m.kind == "constant":
            size = constants[m.place] or 0.0
            parameters.append(FoundParameter(m.place, size, size * error, _holding(m.place, mechanisms, constants)))
        elif m.kind == "offset":
            offsets[m.place] = OffsetScore(value, error)
        elif m.kind == "delay":
            delays[m.place] = DelayScore(value, error)
    return FoundSettings(offsets, delays, tuple(parameters), holds)


def _holding(name: str, mechanisms: Sequence[Mechanism], constants: Mapping[str, float | None]) -> tuple[str, ...]:
    """Return the terms, with numbers, that hold a constant, each once."""
    holding = [replace(m, parts=tuple(p for p in m.parts if name in p.product.term.names)) for m in mechanisms]
    texts = [p.product.term.text for m in holding for p in with_values(m, constants).parts]
    return tuple(dict.fromkeys(texts))
