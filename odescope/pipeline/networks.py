"""Balances that hold a step of a weighted sum, as units of a network do: a small library that is tried first.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, combinations, product

import numpy as np

from odescope.arrays import FloatArray
from odescope.events import Progress
from odescope.library.candidates import Library
from odescope.library.constants import Constant
from odescope.library.pairs import step_of_sum
from odescope.likelihood.imitation import Choice, Imitated, Placed, Samples
from odescope.likelihood.refinement import Refinement
from odescope.likelihood.search import THIN
from odescope.likelihood.unexplained import unexplained
from odescope.pipeline.constants import substituted_at
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed, relations_form
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.stages import refine_form, regress_at
from odescope.pipeline.wider import basis_of, follows_surely, promises, with_basis, within
from odescope.pipeline.work import Work

MANY = 6  # variables of a sum, at most
STEEPEST = 30.0  # weight of a variable, times its range
DIRECTIONS = 40  # of the weights, at random, and how long these are, each times the deviation of its variable:
STEEPNESS = (1.0, 2.5, 6.0)  # where a step is looked for,
PLACES = (-1.0, 0.0, 1.0)  # the same of its middle, in deviations of the sum
BEGUN = 6  # points from which constants are fitted
SEEN = 500  # samples that tell, at most
STEPS = 60  # of such a fit, at most
MATTERS = 1.05  # times the squares that a step leaves: what one less a variable does, at least, where that matters
BUDGET = 10.0  # units, at most: a search that begins beside the law of a network takes less than five
TOLD = 0.5  # of the squares that lines leave: what a step leaves, at most


@dataclass(frozen=True, eq=False)
class _Balance:
    """What a balance says, and what may stand in it: its number, its own state, and the deviations of all variables.

    `taken` are names that constants may not have.
    """

    number: int
    own: str
    imitated: Imitated
    deviations: Mapping[str, float]
    taken: Sequence[str] = ()

    @cached_property
    def around(self) -> tuple[FloatArray, FloatArray]:
        """What stands beside a step, as `Imitated.beside` returns it."""
        return self.imitated.beside(self.imitated.base)


@dataclass(frozen=True, eq=False)
class _Step:
    """The step of a weighted sum of some variables, by name, and the squares that it leaves of its balance."""

    names: tuple[str, ...]
    placed: Placed
    squares: float

    @property
    def weights(self) -> list[str]:
        """The names of the constants that multiply its variables."""
        return [c.name for c in self.placed.choice.constants[:-1]]


def networks(work: Work, filtered: Filtered, regressed: Regressed) -> tuple[Posed, Refinement] | None:
    """Return relations in lines and steps of weighted sums, and their model; None where these promise nothing.

    A population of neurons, or a gene, decays by itself and is driven by a step of what all others send to it, each by
    a weight of its own. Products imitate a step of several variables by more terms than a search ends with. The model
    follows the record, with no weight in doubt. Nothing is tried where there is an angle or a second order, or where
    a library was written by hand.

    Args:
        work: whose study says of which states and inputs functions may be looked for.
        filtered: the records and their signals.
        regressed: what regression in the default library found.
    """
    study, signals = work.study, filtered.signals
    alike = all(c.order == 1 and not c.angle for c in signals.coordinates)
    if study.library.by_hand or not alike or not study.suspects or not filtered.sample.complete:
        return None
    balances = {b.number: b for b in _balances(work, filtered)}
    steps = {r: step for r, b in balances.items() if (step := _step(b)) is not None}
    if not steps:
        return None
    wide = within(with_basis(work, basis_of(study), 1), BUDGET)
    found = _regressed(wide, filtered, steps)
    if not promises(found, regressed):
        return None
    work.monitor.tell(Progress("suspicion", "search with steps of weighted sums", 0, 1))
    posed, refinement = _refined(wide, filtered, steps, found)
    if refinement is None or not (refinement.exact or refinement.says_all):
        return None
    fewer = {r: _without(balances[r], s, refinement) for r, s in steps.items()}
    if any(fewer[r].names != step.names for r, step in steps.items()):
        posed, refinement = _refined(wide, filtered, fewer, _regressed(wide, filtered, fewer))
    if refinement is None or not (follows_surely(refinement) and _weighs_surely(fewer.values(), refinement)):
        return None
    return posed, replace(refinement, finished=True)


def _weighs_surely(steps: Iterable[_Step], refinement: Refinement) -> bool:
    """Say whether a model holds steps, with no weight in doubt.

    A step of one variable whose middle may as well be at zero is a tanh beside a constant: a function of two numbers
    less, which is looked for later.

    Args:
        steps: that the model may hold.
        refinement: the model.
    """
    held, weak = {p.name for p in refinement.settings.parameters}, _weak(refinement)
    there = [step for step in steps if held.issuperset(step.weights)]
    inside = {name for step in there for name in step.weights}
    odd = any(len(step.names) == 1 and step.placed.choice.constants[-1].name in weak for step in there)
    return bool(inside) and weak.isdisjoint(inside) and not odd


def _regressed(work: Work, filtered: Filtered, steps: Mapping[int, _Step]) -> Regressed:
    """Return what regression finds in lines and steps, each in its own balance."""
    targets = filtered.signals.targets
    lines = [work.study.candidates(target) for target in targets]
    libraries = [own + Library(steps[r].placed.choice.terms if r in steps else ()) for r, own in enumerate(lines)]
    values = {name: value for step in steps.values() for name, value in step.placed.values.items()}
    return regress_at(work, substituted_at(libraries, _constants(steps), values, targets), filtered)


def _constants(steps: Mapping[int, _Step]) -> tuple[Constant, ...]:
    """Return the constants of all steps: weights are nominally none, and what stands against that is their evidence."""
    return tuple(c for step in steps.values() for c in step.placed.choice.constants)


def _refined(
    work: Work, filtered: Filtered, steps: Mapping[int, _Step], found: Regressed
) -> tuple[Posed, Refinement | None]:
    """Return the relations of lines and steps, and the model that a search in them ends with.

    Args:
        work: for the study with lines.
        filtered: the records and their signals.
        steps: by the number of their balance.
        found: what regression finds with them.
    """
    posed = replace(relations_form(work.study, (found,), lambda _: found), constants=_constants(steps))
    return posed, refine_form(work, filtered, posed)


def _without(balance: _Balance, step: _Step, refinement: Refinement) -> _Step:
    """Return a step as a model has it, less the variables whose weights may as well be none, unless all are.

    Args:
        balance: what it stands in.
        step: that the model began with.
        refinement: the model.
    """
    weak = _weak(refinement)
    names = tuple(n for n, weight in zip(step.names, step.weights, strict=True) if weight not in weak) or step.names
    known = {**step.placed.values, **{p.name: p.value for p in refinement.settings.parameters}}
    choice = _choice(balance, names)
    return _Step(names, Placed(choice, {c.name: known[c.name] for c in choice.constants}), step.squares)


def _weak(refinement: Refinement) -> frozenset[str]:
    """Return the names of the constants of a model that may as well have their nominal values."""
    outcome, space = refinement.outcome, refinement.space
    mechanisms, free = space.mechanisms, outcome.fit.free
    thin = outcome.fit.wald / max(outcome.scale, 1.0) <= THIN * space.penalty[free]
    return frozenset(mechanisms[k].place for k in free[thin] if mechanisms[k].kind == "constant")


def _balances(work: Work, filtered: Filtered) -> Iterator[_Balance]:
    """Yield what every balance says at some samples, with a constant and its own state beside."""
    signals = filtered.signals
    joined = signals.joined()
    joined = joined[:, :: -(-joined.shape[1] // SEEN)]
    values = {n: joined[signals.row(n)] for n in work.study.suspects}
    deviations = {n: float(v.std()) for n, v in values.items() if float(v.std()) > 0.0}
    samples = Samples({n: values[n] for n in deviations})
    for r, coordinate in enumerate(signals.coordinates):
        if coordinate.name in deviations and 1 < len(deviations) <= MANY:
            base = np.vstack([np.ones(joined.shape[1]), values[coordinate.name]])
            imitated = Imitated(joined[signals.row(coordinate.target)], base, samples)
            yield _Balance(r, coordinate.name, imitated, deviations, signals.names)


def _step(balance: _Balance) -> _Step | None:
    """Return the step of a sum of the fewest variables that a balance holds, None where lines say about as much."""
    imitated, names = balance.imitated, tuple(balance.deviations)
    rows = np.vstack([imitated.base, *(imitated.samples.values[n] for n in names if n != balance.own)])
    _, rest = imitated.beside(rows)
    whole = _fitted(balance, names)
    if not whole.squares < TOLD * float(rest @ rest):
        return None
    smaller = chain.from_iterable(combinations(names, size) for size in range(1, len(names)))
    tried = (_fitted(balance, some) for some in smaller)
    return next((fewer for fewer in tried if fewer.squares < MATTERS * whole.squares), whole)


def _fitted(balance: _Balance, names: tuple[str, ...]) -> _Step:
    """Return the step of a sum of some variables at its best constants."""
    choice, (there, rest) = _choice(balance, names), balance.around
    choice = replace(choice, points=tuple(_points(balance, names, [c.name for c in choice.constants])))
    points, columns = balance.imitated.samples.on_grid(choice)
    nearest = np.argsort(np.sum(unexplained(rest, there, columns) ** 2, axis=1))[:BEGUN]
    fits = [balance.imitated.fitted([Placed(choice, points[k])], (there, rest), STEPS) for k in nearest]
    squares, (placed,) = min(fits, key=lambda found: found[0])
    constant, _, size = balance.imitated.coefficients([placed])
    if abs(constant + size) < abs(constant):  # a step that falls is a number less one that rises: which is to go
        placed = Placed(choice, {n: -value for n, value in placed.values.items()})
    return _Step(names, placed, squares)


def _choice(balance: _Balance, names: Sequence[str]) -> Choice:
    """Return the step of a sum of these variables."""
    values = balance.imitated.samples.values
    limits = {n: STEEPEST / float(np.ptp(values[n])) for n in names}
    reach = sum(w * float(np.abs(values[n]).max()) for n, w in limits.items())
    step, constants = step_of_sum(limits, reach, balance.own, balance.taken)
    return Choice((step,), constants)


def _points(
    balance: _Balance, names: Sequence[str], constants: Sequence[str]
) -> Iterator[tuple[tuple[str, float], ...]]:
    """Yield values of the constants of a step, by name, to begin with: weights at random, and middles.

    Lines would say in which proportion the others weigh, but what the own state weighs is hidden behind its decay.

    Args:
        balance: what it stands in.
        names: of the variables of its sum.
        constants: names of the weights, then of the offset.
    """
    values, rng = balance.imitated.samples.values, np.random.default_rng(0)
    directions = rng.standard_normal((DIRECTIONS, len(names)))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for direction, steepness in product(directions, STEEPNESS):
        weights = {n: steepness * d / balance.deviations[n] for n, d in zip(names, direction.tolist(), strict=True)}
        total = np.sum([w * values[n] for n, w in weights.items()], axis=0)
        for place in PLACES:
            middle = float(total.mean() + place * total.std())
            yield tuple(zip(constants, (*weights.values(), middle), strict=True))
