"""Where a choice of functions begins: models in which functions come near to what a relation says.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.expression import ONE, Name, Term
from odescope.library.product import Product
from odescope.likelihood.fit import Fit
from odescope.likelihood.imitation import Choice, Imitated, Placed
from odescope.likelihood.saturating import Saturating
from odescope.likelihood.sparsest import Sparse, grown, sparse
from odescope.likelihood.standing import Standing
from odescope.likelihood.suspicion import JOINT, MEASURED

End = tuple[list[int], Sparse, Imitated]  # what may stand for a relation: plain terms, functions, what they say
EVIDENT = 10.0  # fall of cost and price that decides for functions: odds of 150 to 1
ONE_BY_ONE = 3  # ends of a relation that are tried while all others are as they were


@dataclass(frozen=True, eq=False)
class Beginnings(Saturating):
    """The models that a choice of functions may begin with."""

    def first(self, found: Fit, plain: Fit | None) -> Standing | None:
        """Return the model with functions that come near to it in the place of what is suspected.

        Those of least penalised cost: few terms and functions, functions with a saturation, functions in the place of
        all that a relation has, Stribeck's curve, or functions beside what is no imitation alone, or beside all
        variables and a constant, too, and what holds a variable but once; then the same with functions of pairs.

        Args:
            found: the model before.
            plain: the same, fitted at the width, if it could be followed.
        """
        price, rubbing = self.moves().penalised, self.rubbing(found)
        if rubbing is not None and plain is not None and price(rubbing.fit) < price(plain) - EVIDENT:
            return rubbing  # a law that is known beforehand: what else there is may be exchanged
        ways = (self.sparse(found, plain), self.saturating(found), self.substituted(found, plain), rubbing)
        standings = [s for s in ways if s is not None]
        single = self.single(found)
        bases = tuple(dict.fromkeys(((), single, self.lines, (*self.lines, *single))))
        pairs = (False,) if self.exact else (False, True)  # what follows the record was said by few, pairs among them
        for given, paired in ((given, paired) for paired in pairs for given in bases):
            if standings and self.space.budget.late:
                break
            bar = min((price(s.fit) for s in standings), default=np.inf)
            near = self.beside(found, given, bar, paired)
            standings += [] if near is None else [near]
        return min(standings, key=lambda s: price(s.fit), default=None)

    def sparse(self, found: Fit, plain: Fit | None) -> Standing | None:
        """Return the model with few terms and functions that come near to it: of those that do the likeliest.

        None where it is the model that is to be said, and this does not follow the record: no more than a beginning.

        Args:
            found: the model before.
            plain: the same, fitted at the width, if it could be followed.
        """
        if not self.exact and any(s.reason != "measured" for s in self.suspected):
            return None
        standing = Standing(found, (Placed(Choice()),) * len(self.suspected), found if self.exact else None)
        relations = dict.fromkeys(s.relation for s in self.suspected)
        ends = {r: e for r in relations if (e := self.sparse_ends(found, r))}
        if not ends:
            return None
        price, best, known = self.moves().penalised, None, dict[bytes, Fit]()
        if plain is not None:
            few = {r: e[:ONE_BY_ONE] for r, e in ends.items()}
            best = self.one_by_one(replace(standing, fit=plain), few, known)
            best = None if best.fit is plain else best
        for r in ends:
            standing = self.with_relation(standing, r, *ends[r][0])
        fit = self.fitted_once(standing.fit.theta, np.inf, known)
        if fit is None:
            return best
        standing = self.one_by_one(replace(standing, fit=fit), {r: e[1:] for r, e in ends.items()}, known)
        return standing if best is None or price(standing.fit) < price(best.fit) else best

    def substituted(self, found: Fit, plain: Fit | None) -> Standing | None:
        """Return the model with functions without constants in the place of all that relations have; None if worse.

        What a short record knows of a relation is told by its expansion: a root may be as far from its imitation as
        the record lets it be, and no function is near that beside nothing else.

        Args:
            found: the model before.
            plain: the same, fitted at the width, if it could be followed.
        """
        fit, moves, expansion = plain, self.moves(), self.judge().expansion
        while fit is not None and not self.space.budget.over:
            better = moves.substitute(fit, expansion)
            if better is None:
                break
            fit = better
        if fit is None or fit is plain:
            return None
        placed = tuple(self.placed_in(fit, k) for k in range(len(self.suspected)))
        return Standing(fit, placed, found if self.exact else None) if any(p.choice.terms for p in placed) else None

    def rubbing(self, found: Fit) -> Standing | None:
        """Return the model with Stribeck's curve beside dry and viscous friction, in the place of all else of a speed.

        Args:
            found: the model before.
        """
        price, standings = self.moves().penalised, list[Standing]()
        for number, suspected in enumerate(self.suspected):
            curves, relation, speed = self.curves(number), suspected.relation, suspected.variable
            if not curves:
                continue
            factors = (Term((f,)) for f in curves[0].choice.terms[0].factors)
            dry = next(f for f in factors if f.names.isdisjoint(curves[0].values))
            rows = self.base(relation, found.theta, self.lines)
            terms = {j: self.space.mechanisms[j].parts[0].product.term for j in rows}
            base = [j for j, t in terms.items() if speed not in t.names or t.text == speed]
            base.append(self.number[relation, Product(None, dry)])
            imitated = self.imitated(relation, found, base, True)
            for curve in curves:
                if self.space.budget.late:
                    break
                theta = None if imitated is None else self.written(relation, found.theta, base, [curve], imitated)
                fit = None if theta is None else self.tightened(theta)
                if fit is not None:
                    placed = tuple(curve if j == number else Placed(Choice()) for j in range(len(self.suspected)))
                    standings.append(Standing(self.pruned(fit), placed, found if self.exact else None))
        return min(standings, key=lambda s: price(s.fit), default=None)

    def placed_in(self, fit: Fit, k: int) -> Placed:
        """Return the function without constants that stands for a suspicion in a fit, one without terms for none."""
        relation = self.suspected[k].relation
        plain = (c for c in self.choices[k] if len(c.terms) == 1 and not c.constants)
        there = (c for c in plain if self.number[relation, Product(None, c.terms[0])] in fit.present)
        return Placed(next(there, Choice()))

    def fitted_once(self, theta: FloatArray, bar: float, known: dict[bytes, Fit]) -> Fit | None:
        """Return the fit of what has a coefficient, which is known where it was tried with other functions about it.

        Args:
            theta: (mechanisms,) coefficients.
            bar: None where cost and price are above.
            known: what was tried, by what has a coefficient.
        """
        present = (theta != 0.0).tobytes()
        fit = known.get(present) or self.tightened(theta, bar)
        if fit is not None:
            known[present] = fit
        return fit

    def one_by_one(self, standing: Standing, ends: Mapping[int, Sequence[End]], known: dict[bytes, Fit]) -> Standing:
        """Return the model with other ends of relations, each taken where it is better with the others as they are.

        Args:
            standing: the model.
            ends: of relations, by number.
            known: what was tried, by what has a coefficient.
        """
        price = self.moves().penalised
        for relation, end in ((r, end) for r, found in ends.items() for end in found):
            if self.space.budget.over:
                break
            trial = self.with_relation(standing, relation, *end)
            other = self.fitted_once(trial.fit.theta, price(standing.fit), known)
            if other is not None and price(other) < price(standing.fit):
                standing = replace(trial, fit=other)
        return standing

    def sparse_ends(self, found: Fit, relation: int) -> list[End]:
        """Return what may stand for a relation, the best first: numbers of plain terms, functions, what they say.

        Args:
            found: the model before.
            relation: its number.
        """
        mine = [k for k, s in enumerate(self.suspected) if s.relation == relation]
        measured = any(self.suspected[k].reason in MEASURED for k in mine)
        base = self.base(relation, found.theta, self.lines)
        imitated = self.imitated(relation, found, base, measured)
        if imitated is None:
            return []
        few = {ONE.text}, {ONE.text, self.own_state(relation)}
        bases = [[j for j, k in enumerate(base) if self.space.mechanisms[k].parts[0].product.text in f] for f in few]
        terms = sum(p.relation == relation for k in found.present for p in self.space.mechanisms[k].parts) - 1
        bar = self.unknown(found, relation, measured) / max(float(imitated.said @ imitated.said), 1e-300), terms
        choices = [self.choices[k] for k in mine]
        found_here = sparse(imitated, choices, [*bases, range(len(base))], bar)
        plain = self.plain(relation)
        wide = self.imitated(relation, found, plain, measured)
        kept = [(s, [base[k] for k in s.kept]) for s in found_here]
        kept += [] if wide is None else [(s, [plain[k] for k in s.kept]) for s in grown(wide, choices, bar)]
        kept.sort(key=lambda one: one[0].dear)
        ends = ((rows, s, self.imitated(relation, found, rows, measured)) for s, rows in kept)
        bare = (relation, Product(self.space.frame.targets[relation])) in self.number
        return [(rows, s, said) for rows, s, said in ends if said is not None and bare]

    def with_relation(
        self, standing: Standing, relation: int, base: list[int], found: Sparse, imitated: Imitated
    ) -> Standing:
        """Return a model with something else for a relation, not yet fitted.

        Args:
            standing: the model as it is.
            relation: its number.
            base: numbers of plain terms.
            found: the functions beside these.
            imitated: what the relation says.
        """
        mine = [k for k, s in enumerate(self.suspected) if s.relation == relation]
        theta = self.written(relation, standing.fit.theta, base, found.placed, imitated)
        placed = dict(zip(mine, found.placed, strict=True))
        return Standing(
            standing.fit if theta is None else replace(standing.fit, theta=theta),
            tuple(placed.get(k, p) for k, p in enumerate(standing.placed)),
            standing.said,
        )

    def beside(self, found: Fit, given: Collection[str], bar: float, paired: bool) -> Standing | None:
        """Return the model with functions that come near to it, None where its penalised cost is above a bar.

        Nor is there one where functions of two variables may be among them and none is.

        Args:
            found: the model before.
            given: variables by name, or a constant, that may stand beside functions.
            bar: the penalised cost.
            paired: whether functions of two variables, and bends, may be among them.
        """
        placed, ways = [Placed(Choice())] * len(self.suspected), dict[int, tuple[list[int], Imitated]]()
        for r in dict.fromkeys(s.relation for s in self.suspected):
            mine = [k for k, s in enumerate(self.suspected) if s.relation == r]
            base = self.base(r, found.theta, given)
            imitated = self.imitated(r, found, base, any(self.suspected[k].reason in MEASURED for k in mine))
            if imitated is None:
                return None
            ways[r] = base, imitated
            chosen = imitated.together([[*self.simple(k, paired), Choice(), *self.linear(k)] for k in mine])
            for k, one in zip(mine, chosen, strict=True):
                placed[k] = one
        if paired and not any(p.choice.terms for p, s in zip(placed, self.suspected, strict=True) if s.reason in JOINT):
            return None
        turned = [self.turned(k, p) for k, p in enumerate(placed)]
        begun = (self.begun(found, ways, there, bar) for there in ([placed] if turned == placed else [placed, turned]))
        return min((s for s in begun if s is not None), key=lambda s: self.moves().penalised(s.fit), default=None)

    def begun(
        self, found: Fit, ways: Mapping[int, tuple[list[int], Imitated]], placed: Sequence[Placed], bar: float
    ) -> Standing | None:
        """Return the fit of a model with functions, pruned; None where its penalised cost is above a bar.

        Args:
            found: the model before.
            ways: what stands beside functions in a relation, and what they are to say there, by its number.
            placed: the functions, by number of the suspicion.
            bar: the penalised cost.
        """
        theta: FloatArray | None = found.theta
        for r, (base, imitated) in ways.items():
            here = [p for p, s in zip(placed, self.suspected, strict=True) if s.relation == r]
            theta = None if theta is None else self.written(r, theta, base, here, imitated)
        if theta is None:
            return None
        plain = [k for k in np.flatnonzero(theta) if k < self.own and self.space.mechanisms[k].parts]
        fit = self.tightened(theta, bar + float(self.space.penalty[plain].sum()))  # all of which pruning may leave out
        return None if fit is None else Standing(self.pruned(fit), tuple(placed), found if self.exact else None)

    def turned(self, k: int, placed: Placed) -> Placed:
        """Return a bend that is a line to the other side of its place, any other function as it is.

        The two are the same beside the variable and a constant, and which of these is needed decides between them.

        Args:
            k: number of the suspicion.
            placed: what stands for it.
        """
        if self.suspected[k].reason != "bend" or not placed.choice.terms:
            return placed
        able = (c for c in self.choices[k] if {n.name for n in c.constants} == placed.values.keys())
        others = (c for c in able if c.terms != placed.choice.terms)
        return Placed(next(others, placed.choice), placed.values)

    def simple(self, k: int, paired: bool) -> list[Choice]:
        """Return the functions for a suspicion that stand alone: those of one variable with a constant at most.

        Or those that multiply all that a fraction divides; those of two variables, where they are asked for, have two.

        Args:
            k: number of the suspicion.
            paired: whether functions of two variables are asked for.
        """
        joint = self.suspected[k].reason in JOINT
        if joint and not paired:
            return []
        few = [c for c in self.choices[k] if len(c.constants) <= 1 + joint]
        return [c for c in few if len(c.terms) < 2 or c.common]

    def linear(self, k: int) -> list[Choice]:
        """Return the variable of a suspicion as what stands for it, where it is a candidate."""
        term = Term(((Name(self.suspected[k].variable), 1),))
        return [Choice((term,))] if (self.suspected[k].relation, Product(None, term)) in self.number else []
