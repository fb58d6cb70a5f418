"""Parameters beside coefficients: offsets of sensors, delays of inputs, constants within functions.

Each is a mechanism without parts, which a search adds and drops like a term. docs/method.md, Parameters beside
coefficients.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import msgspec
import numpy as np

from odescope.arrays import FloatArray
from odescope.library.constants import Constant, term_at
from odescope.library.expression import Atom, Call, Combination, Name, Power, Term
from odescope.library.mechanism import Kind, Mechanism
from odescope.library.product import Product
from odescope.library.readable import readable
from odescope.library.tape import evaluate, write_tape
from odescope.likelihood.program import Frame
from odescope.model.relation import FoundParameter
from odescope.model.scores import DelayScore, OffsetScore
from odescope.recordings.coordinate import Coordinate, Hold, Input, free_name
from odescope.signals.estimate import Signals

SHARP = 0.01  # width of dry friction that searches begin with, in root mean squares of the velocity: nearly a jump
BLUNT = 3.0  # the same, at most
PRECISE = 0.01  # standard errors: what a constant is rounded by, at most


@dataclass(frozen=True, eq=False)
class Start:
    """Where a search may begin: coefficients (mechanisms,) of the candidates, and values of constants by name."""

    coefficients: FloatArray
    constants: Mapping[str, float] = field(default_factory=dict)

    def among(self, mechanisms: Sequence[Mechanism], frame: Frame) -> FloatArray:
        """Return the coefficients of all mechanisms, centred, those of settings after those of the candidates.

        Args:
            mechanisms: candidates, then settings.
            frame: with all constants.
        """
        theta = np.append(self.coefficients, np.zeros(len(mechanisms) - len(self.coefficients)))
        for k, m in enumerate(mechanisms):
            if m.kind == "constant" and m.place in self.constants:
                theta[k] = frame.constants[m.place].coefficient(self.constants[m.place])
        values = {name: self.constants.get(name, c.nominal) for name, c in frame.constants.items()}
        centred: FloatArray = theta / frame.centring.sizes(mechanisms, values)
        return centred


@dataclass(frozen=True, eq=False)
class Starts:
    """Where searches begin: from the `first`, of many from the most promising.

    `plain` are relations that hold their targets bare, if there are any; they are begun from too where one of the
    others cannot be followed, and all candidates are then plain. `rival` are relations that promise more than the
    first: they are begun from whatever the others end in. `further` gives one more for the constants where the best
    search ended, if it can, and is asked only where none of the others ends clear or all of them by their budgets.
    """

    first: Sequence[Start]
    plain: Start | None = None
    rival: Start | None = None
    further: Callable[[Mapping[str, float]], Start | None] = lambda _: None


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
    mechanisms: Sequence[Mechanism], signals: Signals, late: Collection[str], declared: Sequence[Constant] = ()
) -> tuple[tuple[Mechanism, ...], dict[str, Constant]]:
    """Return the mechanisms with dry friction of a finite width and the settings after them, and all constants.

    sign(v) jumps where v passes zero, and no integrator and no derivative stands that: it becomes tanh(v/w), w a
    constant of its own for every argument.

    Args:
        mechanisms: the candidates.
        signals: where the sizes of velocities are seen.
        late: names of the inputs whose delays are open.
        declared: constants that the mechanisms name.
    """
    arguments = {a.text: a for m in mechanisms for p in m.parts for a in _signs(p.product.term)}
    widths, constants = dict[str, Atom](), {c.name: c for c in declared}
    for number, (text, argument) in enumerate(sorted(arguments.items()), start=1):
        plain = text if text.isidentifier() else str(number)
        name = free_name(f"width_{plain}", {*signals.names, *constants})
        widths[text] = Name(name)
        usual = _root_mean_square(argument, signals)
        constants[name] = Constant(name, SHARP * usual, BLUNT * usual, SHARP * usual, optional=True)
    smooth = [_smooth(m, widths) for m in mechanisms] if widths else list(mechanisms)
    known = frozenset[str]().union(*(m.names for m in smooth))
    angles = [c.name for c in signals.coordinates if c.angle and not c.cyclic and c.name in known]
    inputs = [i.name for i in signals.inputs if i.name in late and i.name in known]
    settings: list[tuple[Kind, str]] = [("offset", a) for a in angles]
    settings += [("delay", i) for i in inputs]
    settings += [("constant", c) for c in constants]
    return (*smooth, *(Mechanism(kind, f"{kind} {place}", place, (), 0.0) for kind, place in settings)), constants


def _root_mean_square(argument: Combination, signals: Signals) -> float:
    """Return two digits of the root mean square of an argument over the signals."""
    values = evaluate(write_tape(signals.names, [argument]), signals.joined())[0]
    return float(f"{max(float(np.sqrt(np.mean(values**2))), 1e-300):.2g}")


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


def settings_of(
    mechanisms: Sequence[Mechanism],
    theta: FloatArray,
    covariance: FloatArray,
    constants: Mapping[str, Constant],
    holds: Mapping[str, Hold],
) -> FoundSettings:
    """Return what mechanisms without parts say, with what inputs do between samples.

    Args:
        mechanisms: those that are present.
        theta: (k,) their coefficients.
        covariance: (k, k) of these.
        constants: all, by name.
        holds: by input.
    """
    offsets, delays, parameters = dict[str, OffsetScore](), dict[str, DelayScore](), list[FoundParameter]()
    values = values_of(mechanisms, theta, covariance, constants)
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    for m, coefficient, error in zip(mechanisms, theta.tolist(), errors.tolist(), strict=True):
        if m.kind == "constant":
            value = values[m.place] or 0.0
            error *= abs(constants[m.place].slope(value))
            parameters.append(FoundParameter(m.place, value, error, *_holding(m.place, mechanisms, values)))
        elif m.kind == "offset":
            offsets[m.place] = OffsetScore(coefficient, error)
        elif m.kind == "delay":
            delays[m.place] = DelayScore(coefficient, error)
    return FoundSettings(offsets, delays, tuple(parameters), holds)


def values_of(
    mechanisms: Sequence[Mechanism], theta: FloatArray, covariance: FloatArray, constants: Mapping[str, Constant]
) -> dict[str, float | None]:
    """Return the values of all constants, to the digits that are known; None where the record does not ask for one.

    Args:
        mechanisms: those that are present.
        theta: (k,) their coefficients.
        covariance: (k, k) of these.
        constants: all, by name.
    """
    values = {c.name: None if c.optional else c.nominal for c in constants.values()}
    for k, m in enumerate(mechanisms):
        if m.kind == "constant":
            constant = constants[m.place]
            value = constant.at(float(theta[k]))
            error = abs(constant.slope(value)) * float(np.sqrt(max(covariance[k, k], 0.0)))
            # Beside a standard error of a thousandth, four digits are as good as sixteen, and can be read.
            digits = 4 - int(np.floor(np.log10(min(max(error / abs(value), 1e-12), 1e-2) / PRECISE))) if value else 4
            values[m.place] = float(f"{value:.{digits}g}")
    return values


def _holding(
    name: str, mechanisms: Sequence[Mechanism], values: Mapping[str, float | None]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the terms that hold a constant, each once: with numbers, and with the names of all that have values."""
    without = {n: None for n, value in values.items() if value is None}
    terms = dict.fromkeys(p.product.term for m in mechanisms for p in m.parts if name in p.product.term.names)
    found = {term_at(t, values)[1].text: readable(term_at(t, without)[1]) for t in terms}
    return tuple(found), tuple(found.values())
