"""What may stand in the place of what is suspected: functions of a variable, chosen by the likelihood.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.constants import Constant
from odescope.library.expression import ONE, Name, Term
from odescope.library.families import families_of
from odescope.library.mechanism import Mechanism, candidate
from odescope.library.product import Product
from odescope.library.readable import readable
from odescope.likelihood.add_and_drop import GAIN, Moves
from odescope.likelihood.budget import Budget
from odescope.likelihood.fit import Fit
from odescope.likelihood.held_out import thinned
from odescope.likelihood.imitation import SEEN, Choice, Imitated, Placed, choices_of
from odescope.likelihood.negligible import worthless
from odescope.likelihood.refine import Refinement
from odescope.likelihood.search import WIDTHS, Outcome, WhiteResiduals, search
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import SEGMENT
from odescope.likelihood.settings import Start
from odescope.likelihood.smoothed_targets import explicit, rates
from odescope.likelihood.suspicion import Suspicion, imitates, values_of_variables

STEPS = 4  # of RK4 at most, but for dry friction: what is found here is fitted again
RIVALS = {0: 3, 1: 3, 2: 2}  # functions of a suspicion that are fitted, by number of their constants
EVIDENT = 10.0  # fall of cost and price that decides for functions: odds of 150 to 1
PASSES = 3  # through all suspicions, at most: what is best for one may depend on the others
FEW = 10  # steps of a fit that begins where it is likely to end


@dataclass(frozen=True, eq=False)
class Alternative:
    """A model with functions in the place of what is suspected.

    `mechanisms` are the functions, candidates beside those of the model, none where the search dropped all, and
    `constants` theirs; `start` holds their coefficients. `gain` is the fall of the penalised cost, at prices that count
    all functions that were tried, None where one of the two does not follow the record; `tried` are these, by number
    of the suspicion. `outcome` is that of a search with them: there is none where functions alone are evidently better.
    """

    mechanisms: tuple[Mechanism, ...]
    constants: tuple[Constant, ...]
    start: Start
    outcome: Outcome | None
    gain: float | None
    tried: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, eq=False)
class _Standing:
    """A fit, and what stands for every suspicion in it."""

    fit: Fit
    placed: tuple[Placed, ...]


@dataclass(frozen=True, eq=False)
class _Work:
    """What the choice of functions works on.

    `space` holds the candidates of the model, then all functions that are tried, then their constants: only what is
    present is on a tape. `choices` are those of every suspicion; `number` finds a candidate by relation and product,
    `own` counts those of the model; `width` is that of the defects.
    """

    space: SearchSpace
    suspected: tuple[Suspicion, ...]
    choices: tuple[tuple[Choice, ...], ...]
    number: Mapping[tuple[int, Product], int]
    own: int
    width: float

    @staticmethod
    def of(refinement: Refinement, suspected: Sequence[Suspicion], limit: float) -> _Work:
        space = refinement.space
        segments = thinned(space.segments if refinement.process is None else space.segments.cut_anew(SEGMENT))
        space = space.on(segments).finer(min(space.evaluator.substeps, STEPS))
        space = space.within(Budget(limit, space.budget.monitor, space.budget.deadline))
        values = values_of_variables(space)
        taken = {*space.frame.variables, *space.frame.targets, *space.frame.constants}
        families = {s.variable: families_of(s.variable, values[s.variable], taken) for s in suspected}
        choices = tuple(choices_of(families[s.variable], s.beside) for s in suspected)
        constants = {c.name: c for found in choices for choice in found for c in choice.constants}
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
        width = refinement.outcome.width if refinement.process is None else np.inf
        return _Work(wide, tuple(suspected), choices, number, len(space.mechanisms), float(width))

    def padded(self, theta: FloatArray) -> FloatArray:
        """Return coefficients of the model as those of all candidates."""
        return np.append(theta, np.zeros(len(self.space.mechanisms) - len(theta)))

    def tightened(self, theta: FloatArray) -> Fit | None:
        """Return the fit of what has a coefficient, begun in loose segments."""
        space = self.space
        here = space.fit(theta, np.flatnonzero(theta), space.segments.initial, space.segments.spread * np.inf)
        for width in WIDTHS[1:]:
            if here is None or width < self.width:
                break
            here = space.again(here, here.x0, space.segments.spread * width)
        return here

    def base(self, relation: int, theta: FloatArray, variables: Collection[str] | None) -> list[int]:
        """Return what stands beside functions: terms that imitate nothing, a constant, and some variables.

        Args:
            relation: its number.
            theta: (mechanisms,) coefficients of the model.
            variables: by name; None for none of them, nor a constant.
        """
        plain, found = set() if variables is None else {ONE.text, *variables}, list[int]()
        for k, m in enumerate(self.space.mechanisms[: self.own]):
            if m.parts and m.parts[0].relation == relation and (product := m.parts[0].product).factor is None:
                there = theta[k] != 0.0 and not imitates(product, relation, self.suspected)
                if there or product.text in plain:
                    found.append(k)
        return found

    def imitated(self, relation: int, found: Fit, base: Sequence[int], measured: bool) -> Imitated | None:
        """Return what a relation says, None where it says nothing somewhere.

        Args:
            relation: its number.
            found: the model.
            base: numbers of what stands beside functions.
            measured: whether it is what differences of the smoothed states say.
        """
        space = self.space
        said = (rates(space) if measured else explicit(space, found))[relation]
        every = -(-len(said) // SEEN)
        terms = [space.mechanisms[k].parts[0].product.term for k in base]
        columns = space.evaluated(terms, found.theta)[:, ::every] if terms else np.zeros((0, len(said[::every])))
        values = {name: column[::every] for name, column in values_of_variables(space).items()}
        return Imitated(said[::every], columns, values) if np.isfinite(said).all() else None

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

    def first(self, found: Fit) -> _Standing | None:
        """Return the model with functions that come near to it in the place of what is suspected.

        Those of least penalised cost: functions beside what is no imitation alone, or beside all variables and a
        constant, too.
        """
        standings = (self.beside(found, variables) for variables in (None, self.space.frame.variables))
        price = self.moves().penalised
        return min((s for s in standings if s is not None), key=lambda s: price(s.fit), default=None)

    def beside(self, found: Fit, variables: Collection[str] | None) -> _Standing | None:
        """Return the model with functions that come near to it.

        Args:
            found: the model before.
            variables: what may stand beside functions with a constant, None for neither.
        """
        theta, placed = found.theta, [Placed(Choice())] * len(self.suspected)
        for r in dict.fromkeys(s.relation for s in self.suspected):
            mine = [k for k, s in enumerate(self.suspected) if s.relation == r]
            base = self.base(r, found.theta, variables)
            imitated = self.imitated(r, found, base, any(self.suspected[k].reason == "residual" for k in mine))
            if imitated is None:
                return None
            chosen = imitated.together([[*self.simple(k), Choice(), *self.linear(k)] for k in mine])
            written = self.written(r, theta, base, chosen, imitated)
            if written is None:
                return None
            theta = written
            for k, one in zip(mine, chosen, strict=True):
                placed[k] = one
        fit = self.tightened(theta)
        return None if fit is None else _Standing(self.pruned(fit), tuple(placed))

    def simple(self, k: int) -> list[Choice]:
        """Return the functions for a suspicion that stand alone and have no more than one constant."""
        return [c for c in self.choices[k] if len(c.constants) < 2 and len(c.terms) < 2]

    def linear(self, k: int) -> list[Choice]:
        """Return the variable of a suspicion as what stands for it, where it is a candidate."""
        term = Term(((Name(self.suspected[k].variable), 1),))
        return [Choice((term,))] if (self.suspected[k].relation, Product(None, term)) in self.number else []

    def holds_functions(self, fit: Fit) -> bool:
        """Say whether a model has functions beside the candidates of the one before."""
        return any(k >= self.own and self.space.mechanisms[k].parts for k in fit.present.tolist())

    def moves(self) -> Moves:
        """Return the moves at the width."""
        judge = WhiteResiduals(self.space, self.space.segments.spread * self.width)
        return Moves(self.space, judge, self.width, 1.0, [])

    def pruned(self, fit: Fit) -> Fit:
        """Return the fit without the plain terms that are not worth their price."""
        moves = self.moves()
        plain = [k for k in fit.free.tolist() if k < self.own and self.space.mechanisms[k].parts]
        gone = worthless(self.space, fit, plain)
        if len(gone):
            theta = fit.theta.copy()
            theta[gone] = 0.0
            present = np.setdiff1d(fit.present, gone)
            fewer = self.space.fit(theta, present, fit.x0, moves.defect_std, fit.strength, FEW)
            return fewer if fewer is not None and moves.penalised(fewer) < moves.penalised(fit) else fit
        return fit

    def exchanged(self, standing: _Standing) -> _Standing:
        """Return the model with the functions that the likelihood prefers, each tried with the others as they are."""
        price = self.moves().penalised
        for _ in range(PASSES):
            before = standing
            for k in range(len(self.suspected)):
                for trial in self.trials(standing, k):
                    if trial is not None and price(trial.fit) < price(standing.fit) - GAIN:
                        standing = trial
                    if self.space.budget.over:
                        return standing
            if standing is before:
                break
        return standing

    def trials(self, standing: _Standing, k: int) -> Iterator[_Standing | None]:
        """Yield the model with other functions for one suspicion, those that come nearest to what it says now."""
        fit, relation = standing.fit, self.suspected[k].relation
        others = [
            self.now(p, fit)
            for j, p in enumerate(standing.placed)
            if j != k and self.suspected[j].relation == relation and self.there(p, relation, fit)
        ]
        base = self.base(relation, fit.theta, {self.suspected[k].variable})
        imitated = self.imitated(relation, fit, base, self.suspected[k].reason == "residual")
        if imitated is None:
            return
        ranked, bar = imitated.ranked(self.choices[k], others), self.moves().penalised(fit)
        rivals = [[found[1] for found in ranked if len(found[1].choice.constants) == n][:m] for n, m in RIVALS.items()]
        plain = (Placed(Choice()), *map(Placed, self.linear(k)))
        for rival in (*plain, *chain.from_iterable(rivals)):
            if rival.choice != standing.placed[k].choice:
                yield self.with_rival(standing, k, rival, others, (base, imitated, bar))

    def with_rival(
        self,
        standing: _Standing,
        k: int,
        rival: Placed,
        others: Sequence[Placed],
        around: tuple[list[int], Imitated, float],
    ) -> _Standing | None:
        """Return the model with a rival for one suspicion, None where it cannot be better.

        Args:
            standing: the model as it is.
            k: number of the suspicion.
            rival: that is tried.
            others: functions that stand in the same relation.
            around: what else stands there, what the relation says by now, and the penalised cost to be below.
        """
        (base, imitated, bar), fit, relation = around, standing.fit, self.suspected[k].relation
        theta = self.written(relation, fit.theta, base, [*others, rival], imitated)
        if theta is None:
            return None
        trial = self.space.fit(theta, np.flatnonzero(theta), fit.x0, self.moves().defect_std, iterations=FEW)
        if trial is None or trial.cost + self.least(trial, relation) > bar:
            return None
        return _Standing(self.pruned(trial), (*standing.placed[:k], rival, *standing.placed[k + 1 :]))

    def least(self, fit: Fit, relation: int) -> float:
        """Return the least price that a fit may have without terms of a relation that are no functions."""
        space = self.space
        plain = [k for k in fit.free if k < self.own and relation in space.mechanisms[k].relations]
        return space.price(fit) - float(space.penalty[plain].sum())

    def there(self, placed: Placed, relation: int, fit: Fit) -> bool:
        """Say whether a function is in a relation of the model."""
        return any(self.number[relation, Product(None, t)] in fit.present for t in placed.choice.terms)

    def now(self, placed: Placed, fit: Fit) -> Placed:
        """Return a function with its constants as they were fitted."""
        space = self.space
        return Placed(
            placed.choice,
            {n: space.frame.constants[n].at(float(fit.theta[space.needed[n]])) for n in placed.values},
        )

    def searched(self, standing: _Standing) -> Outcome | None:
        """Return where a search with the functions that were chosen ends, over all candidates."""
        theta, mechanisms = standing.fit.theta, self.space.mechanisms
        functions = [k for k in np.flatnonzero(theta).tolist() if k >= self.own and mechanisms[k].parts]
        named = frozenset[str]().union(*(mechanisms[k].names for k in functions))
        constants = [k for name, k in self.space.needed.items() if name in named and k >= self.own]
        kept = np.array([*range(self.own), *functions, *constants])
        space = self.space.among([mechanisms[k] for k in kept])
        outcome = search(replace(space, frame=replace(space.frame, constants=self._constants(named))), theta[kept])
        if outcome is None:
            return None
        fit, whole = outcome.fit, np.zeros(len(mechanisms))
        whole[kept] = fit.theta
        return replace(outcome, fit=replace(fit, theta=whole, present=kept[fit.present], held=kept[fit.held]))

    def told(self, fit: Fit, outcome: Outcome | None, gain: float | None, plain: int) -> Alternative:
        """Return what came of it.

        Args:
            fit: the model with functions.
            outcome: of the search with them, where there was one.
            gain: over the model without.
            plain: number of its candidates; what else may be present are settings.
        """
        mechanisms, constants = self.space.mechanisms, self.space.frame.constants
        chosen = [k for k in fit.present.tolist() if k >= self.own and mechanisms[k].parts]
        held = frozenset[str]().union(*(mechanisms[k].names for k in chosen))
        asked = {n: k for n, k in self.space.needed.items() if k < self.own or n in held}
        return Alternative(
            mechanisms=tuple(mechanisms[k] for k in chosen),
            constants=tuple(constants[n] for n, k in asked.items() if k >= self.own),
            start=Start(
                fit.theta[[*range(plain), *chosen]], {n: constants[n].at(float(fit.theta[k])) for n, k in asked.items()}
            ),
            outcome=outcome,
            gain=gain,
            tried=self.tried,
        )

    @property
    def tried(self) -> tuple[tuple[str, ...], ...]:
        """The functions that were compared, by number of the suspicion."""
        return tuple(tuple(dict.fromkeys(readable(t) for c in found for t in c.terms)) for found in self.choices)

    def _constants(self, named: Collection[str]) -> dict[str, Constant]:
        """Return the constants of the model, and of new ones those that are named."""
        own = {m.place for m in self.space.mechanisms[: self.own] if m.kind == "constant"}
        return {n: c for n, c in self.space.frame.constants.items() if n in own or n in named}


def alternative(refinement: Refinement, suspected: Sequence[Suspicion], plain: int, limit: float) -> Alternative | None:
    """Return what a model becomes with functions in the place of what is suspected; None where it cannot be followed.

    Args:
        refinement: the end of a likelihood stage, of plain candidates.
        suspected: what is suspected of its model.
        plain: number of the candidates; what else may be present are settings.
        limit: units of budget that may be spent.
    """
    work = _Work.of(refinement, suspected, limit)
    found = replace(refinement.fit, theta=work.padded(refinement.fit.theta))
    standing = work.first(found)
    if standing is None:
        return None
    standing, price = work.exchanged(standing), work.moves().penalised
    before = work.tightened(found.theta) if refinement.exact else None
    gain = None if before is None else price(before) - price(standing.fit)
    if gain is not None and gain > EVIDENT and work.holds_functions(standing.fit):
        return work.told(standing.fit, None, gain, plain)
    outcome = work.searched(standing)
    if outcome is None:
        return None
    if before is not None and np.isfinite(outcome.width) and work.holds_functions(outcome.fit):
        gain = price(before) - price(outcome.fit)
    return work.told(outcome.fit, outcome, gain, plain)
