"""A model, its record and the functions that may stand in the place of what is suspected of it.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.expression import ONE, Name, Term
from odescope.library.families import STRIBECK, Family, bends, families_of, stribeck
from odescope.library.mechanism import Mechanism, candidate
from odescope.library.pairs import NO_UNITS, may_be_angles, pair_families, sines
from odescope.library.product import Product
from odescope.likelihood.add_and_drop import Moves
from odescope.likelihood.budget import Budget
from odescope.likelihood.fit import Fit
from odescope.likelihood.held_out import thinned
from odescope.likelihood.imitation import SEEN, Choice, Imitated, Placed, Samples, choices_of
from odescope.likelihood.negligible import worthless
from odescope.likelihood.refinement import Refinement
from odescope.likelihood.search import WHITE, WIDTHS, WhiteResiduals
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import SEGMENT
from odescope.likelihood.smoothed_targets import explicit, rates
from odescope.likelihood.steps import STEP_SHARE
from odescope.likelihood.suspicion import JOINT, Suspicion, dry_friction, imitates, values_of_variables

STEPS = 4  # of RK4 at most, but for dry friction, where more change next to nothing: what is found is fitted again
SPEEDS = 3  # at which Stribeck's curve is looked for
FEW = 10  # steps of a fit that begins where it is likely to end


@dataclass(frozen=True, eq=False)
class FunctionSpace:
    """What the choice of functions works on.

    `space` holds the candidates of the model, then all functions that are tried, then their constants: only what is
    present is on a tape. `families` are the functions of every variable, `choices` those of every suspicion; `number`
    finds a candidate by relation and product, `own` counts those of the model; `width` is that of the defects; `exact`
    is whether the model follows the record and is what functions are to say; `samples` are the variables at the
    averages of the record.
    """

    space: SearchSpace
    suspected: tuple[Suspicion, ...]
    families: Mapping[str, tuple[Family, ...]]
    choices: tuple[tuple[Choice, ...], ...]
    number: Mapping[tuple[int, Product], int]
    own: int
    width: float
    exact: bool
    samples: Samples

    @classmethod
    def of(
        cls,
        refinement: Refinement,
        suspected: Sequence[Suspicion],
        limit: float,
        units: Mapping[str, str | None] = NO_UNITS,
    ) -> Self:
        """Return what functions are chosen on.

        Args:
            refinement: the end of a likelihood stage, of plain candidates.
            suspected: what is suspected of its model.
            limit: units of budget that may be spent.
            units: of states and inputs, as far as they are known.
        """
        space = refinement.space
        segments = thinned(space.segments if refinement.process is None else space.segments.cut_anew(SEGMENT))
        space = _with_few_steps(space.on(segments), refinement.fit)
        space = space.within(Budget(limit, space.budget.monitor, space.budget.deadline))
        values = values_of_variables(space)
        taken = {*space.frame.variables, *space.frame.targets, *space.frame.constants}
        joint = _joint(suspected, values, taken, units)
        angles = may_be_angles(values, units) if joint else None
        names = dict.fromkeys(s.variable for s in suspected if s.reason not in JOINT)
        every = {
            n: families_of(n, values[n], taken, None if angles is None else n in angles, units.get(n)) for n in names
        }
        families = _suited(every, suspected, space)
        fixed = dict(zip(space.frame.constants, space.whole.constants(refinement.fit.theta), strict=True))
        choices = tuple(
            joint.get(s.reason)
            or (
                *choices_of(families.get(s.variable, ()), s.beside, s.falling, s.divided),
                *_stribeck(s, refinement, values, taken),
            )
            for s in suspected
        )
        constants = {c.name: c for found in choices for choice in found for c in choice.constants}
        families = {
            n: tuple(f for f in of if {c.name for c in f.constants} <= constants.keys()) for n, of in families.items()
        }
        known = {(p.relation, p.product) for m in space.mechanisms for p in m.parts}
        made = dict.fromkeys(
            candidate(s.relation, Product(None, term), space.frame.targets[s.relation])
            for s, found in zip(suspected, choices, strict=True)
            for choice in found
            for term in choice.terms
        )
        added = [m for m in made if (m.parts[0].relation, m.parts[0].product) not in known]
        settings = [Mechanism("constant", f"constant {name}", name, (), 0.0) for name in constants]
        wide = space.among([*space.mechanisms, *added, *settings]).with_constants(constants)
        number = {(m.parts[0].relation, m.parts[0].product): k for k, m in enumerate(wide.mechanisms) if m.parts}
        measured = all(s.reason == "measured" for s in suspected)  # from far off, and by open segments alone
        width = np.inf if measured or refinement.process is not None else refinement.outcome.width
        own, samples = len(space.mechanisms), len(next(iter(values.values())))
        seen = {**values, **{name: np.full(samples, value) for name, value in fixed.items()}}
        exact = refinement.exact and not measured
        return cls(wide, tuple(suspected), families, choices, number, own, float(width), exact, Samples(seen))

    def padded(self, theta: FloatArray) -> FloatArray:
        """Return coefficients of the model as those of all candidates."""
        return np.append(theta, np.zeros(len(self.space.mechanisms) - len(theta)))

    def tightened(self, theta: FloatArray, bar: float = np.inf) -> Fit | None:
        """Return the fit of what has a coefficient, begun in loose segments.

        Args:
            theta: (mechanisms,) coefficients.
            bar: None where cost and price are above: the cost of looser segments is no higher. Nor is there one where
                the clock strikes on the way.
        """
        space, spread = self.space, self.space.segments.spread
        here = space.fit(theta, np.flatnonzero(theta), space.segments.initial, spread * np.inf)
        if here is None or here.cost + space.price(here) > bar:
            return None
        tight = space.again(here, here.x0, spread * self.width, FEW)
        if tight is not None and tight.converged:
            return tight
        for width in (w for w in WIDTHS[1:] if w >= self.width):
            here = None if space.budget.late else space.again(here, here.x0, spread * width)
            if here is None or here.cost + space.price(here) > bar:
                return None
        return here

    def base(self, relation: int, theta: FloatArray, given: Collection[str] = ()) -> list[int]:
        """Return what stands beside functions: terms that imitate nothing, and those that are given, by number.

        Args:
            relation: its number.
            theta: (mechanisms,) coefficients of the model.
            given: variables by name, or a constant: what may stand there in any case.
        """
        found = list[int]()
        for k, m in enumerate(self.space.mechanisms[: self.own]):
            if m.parts and m.parts[0].relation == relation and (product := m.parts[0].product).factor is None:
                there = theta[k] != 0.0 and not imitates(product, relation, self.suspected)
                if there or product.text in given:
                    found.append(k)
        return found

    def curves(self, k: int) -> list[Placed]:
        """Return Stribeck's curve for a suspicion at several speeds, nothing for what is no speed with dry friction.

        Smoothed states tell least of it, near standstill: the likelihood has to.
        """
        found = ((c, n) for c in self.choices[k] for n in c.constants if n.name.startswith(f"{STRIBECK}_"))
        return [Placed(c, {n.name: float(speed)}) for c, n in found for speed in n.evenly(SPEEDS)]

    def present(self, fit: Fit, relation: int) -> list[tuple[int, Product]]:
        """Return the number and product of what stands in a relation of a model."""
        parts = ((k, p) for k in fit.present.tolist() for p in self.space.mechanisms[k].parts)
        return [(k, p.product) for k, p in parts if p.relation == relation]

    def plain(self, relation: int) -> list[int]:
        """Return the numbers of the candidates of the model before that hold no target."""
        parts = ((k, p) for k, m in enumerate(self.space.mechanisms[: self.own]) for p in m.parts)
        return [k for k, p in parts if p.relation == relation and p.product.factor is None]

    def single(self, found: Fit) -> tuple[str, ...]:
        """Return what a model multiplies a variable by once, while other powers of it may imitate a function.

        As L*x beside x and x**2: it may be part of that function, times L, or of none.

        Args:
            found: the model.
        """
        texts = list[str]()
        for s in (s for s in self.suspected if s.reason == "powers"):
            terms = [p.term for _, p in self.present(found, s.relation) if p.factor is None]
            here = [t for t in terms if s.variable in t.names]
            rests = [Term(tuple(f for f in t.factors if f[0] != Name(s.variable))) for t in here]
            texts += [t.text for t, rest in zip(here, rests, strict=True) if rest != ONE and rests.count(rest) == 1]
        return tuple(dict.fromkeys(texts))

    @property
    def lines(self) -> tuple[str, ...]:
        """A constant and all variables: what may stand beside functions in a relation of any kind."""
        return (ONE.text, *self.space.frame.variables)

    def alone(self, relation: int, fit: Fit) -> list[str]:
        """Return the variables that stand by themselves in a relation of a model."""
        here = {(p.relation, p.product) for k in fit.present.tolist() for p in self.space.mechanisms[k].parts}
        names = self.space.frame.variables
        return [n for n in names if (relation, Product(None, Term(((Name(n), 1),)))) in here]

    def imitated(
        self, relation: int, found: Fit, base: Sequence[int], measured: bool, at: FloatArray | None = None
    ) -> Imitated | None:
        """Return what a relation says, None where it says nothing somewhere.

        What a model says that does not follow the record is no more to be imitated than any other imitation.

        Args:
            relation: its number.
            found: the model.
            base: numbers of what stands beside functions.
            measured: whether it is what differences of the smoothed states say, as it is where no model follows them.
            at: (mechanisms,) coefficients whose constants the base has; those of the model by default.
        """
        space = self.space
        said = (rates(space) if measured or not self.follows(found) else explicit(space, found))[relation]
        every = -(-len(said) // SEEN)
        terms = [space.mechanisms[k].parts[0].product.term for k in base]
        theta = found.theta if at is None else at
        columns = space.evaluated(terms, theta)[:, ::every] if terms else np.zeros((0, len(said[::every])))
        return Imitated(said[::every], columns, self.samples.thinned(every)) if np.isfinite(said).all() else None

    def follows(self, fit: Fit) -> bool:
        """Say whether a model follows the record: the one before, or one with functions that leaves its noise."""
        return self.exact or fit.cost < WHITE * self.space.segments.samples

    def written(
        self, relation: int, theta: FloatArray, base: Sequence[int], placed: Sequence[Placed], imitated: Imitated
    ) -> FloatArray | None:
        """Return coefficients with a relation made of its base and functions; None without its bare target.

        Args:
            relation: its number.
            theta: (mechanisms,) coefficients before.
            base: numbers of what stands beside functions.
            placed: these.
            imitated: what they are to say.
        """
        bare = self.number.get((relation, Product(self.space.frame.targets[relation])))
        if bare is None:
            return None
        result = theta.copy()
        for k, m in enumerate(self.space.mechanisms):
            if relation in m.relations:
                result[k] = 0.0
        terms = [self.number[relation, Product(None, t)] for p in placed for t in p.choice.terms]
        np.add.at(result, [*base, *terms], -imitated.coefficients(placed))
        result[bare] = 1.0
        for name, value in ((n, v) for p in placed for n, v in p.values.items()):
            k = self.space.needed[name]
            result[k] = self.space.frame.constants[name].coefficient(value)
        return result

    def unknown(self, found: Fit, relation: int, measured: bool) -> float:
        """Return the sum of squares, over what is compared, of what a relation says and the record does not know.

        That of a rate which noise leaves below the cutoff, or, of a model, as much less as its residuals are.

        Args:
            found: the model.
            relation: its number.
            measured: whether the relation says what differences of the smoothed states say.
        """
        segments, place = self.space.segments, int(self.space.frame.measured[relation])
        order = self.space.frame.variables.index(self.own_state(relation)) - place + 1
        cutoff = (segments.spread[place] / segments.noise[relation]) ** 2 / (2.0 * segments.step)
        error = segments.spread[place] * (2.0 * np.pi * cutoff) ** order / np.sqrt(2.0 * order + 1.0)
        share = 1.0 if measured else min(found.cost / segments.samples, 1.0)
        samples = len(segments.filtered)
        return float(share * error**2 * samples / -(-samples // SEEN))

    def own_state(self, relation: int) -> str:
        """Return the state whose rate a relation is for, by name."""
        following = list(self.space.frame.following)
        return self.space.frame.variables[following.index(-1 - relation)]

    def judge(self) -> WhiteResiduals:
        """Return what judges moves at the width."""
        return WhiteResiduals(self.space, self.space.segments.spread * self.width)

    def moves(self) -> Moves:
        """Return the moves at the width."""
        return Moves(self.space, self.judge(), self.width, 1.0, [])

    def pruned(self, fit: Fit, functions: Collection[int] = ()) -> Fit:
        """Return the fit without the plain terms that are not worth their price, nor those of some functions."""
        moves = self.moves()
        able = [k for k in fit.free.tolist() if (k < self.own and self.space.mechanisms[k].parts) or k in functions]
        gone = worthless(self.space, fit, able)
        if len(gone):
            theta = fit.theta.copy()
            theta[gone] = 0.0
            present = np.setdiff1d(fit.present, gone)
            fewer = self.space.fit(theta, present, fit.x0, moves.defect_std, fit.strength, FEW)
            return fewer if fewer is not None and moves.penalised(fewer) < moves.penalised(fit) else fit
        return fit


def _with_few_steps(space: SearchSpace, found: Fit) -> SearchSpace:
    """Return the space with no more steps than the model needs: what is stiff, as a substrate that runs out, does."""
    few = space.finer(min(space.evaluator.substeps, STEPS))
    if few.evaluator.substeps == space.evaluator.substeps:
        return few
    loose, segments = space.segments.spread * np.inf, space.segments
    fits = [s.fit(found.theta, found.present, segments.initial, loose, iterations=FEW) for s in (space, few)]
    costs = [np.inf if f is None else f.cost for f in fits]
    return few if abs(costs[1] - costs[0]) < STEP_SHARE * costs[0] else space


def _stribeck(
    suspected: Suspicion, refinement: Refinement, values: Mapping[str, FloatArray], taken: Collection[str]
) -> tuple[Choice, ...]:
    """Return Stribeck's curve, where a speed is suspected of whose dry friction the relation holds.

    What a model that does not follow the record lacks is no reason against it: there the friction need not be in it.

    Args:
        suspected: the variable and the relation.
        refinement: whose model it is of.
        values: of the variables, by name (N,).
        taken: names that its constant may not have.
    """
    mechanisms = refinement.space.mechanisms
    able = refinement.fit.present if refinement.exact else range(len(mechanisms))
    parts = (p for k in able for p in mechanisms[k].parts)
    terms = (p.product.term for p in parts if p.relation == suspected.relation and p.product.factor is None)
    dry = dry_friction(refinement.space, terms).get(suspected.variable)
    if dry is None:
        return ()
    family = stribeck(suspected.variable, values[suspected.variable], taken)
    return (Choice((family.term * dry,), family.constants),)


def _suited(
    every: Mapping[str, Sequence[Family]], suspected: Sequence[Suspicion], space: SearchSpace
) -> dict[str, tuple[Family, ...]]:
    """Return those functions of every variable that its place in the relations allows.

    Args:
        every: functions of a variable, by its name.
        suspected: all suspicions.
        space: whose states they are of.
    """
    squared = {s.variable for s in suspected if s.squared}
    divided = {s.variable for s in suspected if s.reason == "fractions"}
    following = zip(space.frame.states, space.frame.following.tolist(), strict=True)
    positions = {state for state, after in following if after >= 0}
    return {
        n: tuple(f for f in found if f.suits(n in squared, n in divided, n in positions)) for n, found in every.items()
    }


def _joint(
    suspected: Sequence[Suspicion],
    values: Mapping[str, FloatArray],
    taken: Collection[str],
    units: Mapping[str, str | None],
) -> dict[str, tuple[Choice, ...]]:
    """Return the functions for suspicions of no variable, by their reason.

    Args:
        suspected: all suspicions.
        values: of the variables, by name (N,).
        taken: names that constants may not have.
        units: of the variables, as far as they are known.
    """
    if not any(s.reason in JOINT for s in suspected):
        return {}
    pairs = tuple(Choice((f.term,), f.constants, f.points) for f in pair_families(values, taken, units))
    bent = tuple(Choice((f.term,), f.constants) for n, v in values.items() for f in bends(n, v, taken))
    return {"pair": pairs, "bend": bent, "sine": tuple(Choice((term,)) for term in sines(may_be_angles(values, units)))}
