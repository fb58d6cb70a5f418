"""Functions that stand in one relation, in the others: a rate has the same constants in every balance that it is in.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Self

from odescope.arrays import FloatArray
from odescope.library.expression import ONE, Term
from odescope.library.families import Family
from odescope.library.mechanism import candidate
from odescope.library.product import Product
from odescope.likelihood.add_and_drop import GAIN, HOPELESS
from odescope.likelihood.beginnings import Beginnings
from odescope.likelihood.budget import Budget
from odescope.likelihood.fit import Fit
from odescope.likelihood.function_space import FEW
from odescope.likelihood.imitation import Choice, Imitated, Placed
from odescope.likelihood.sparsest import beside
from odescope.likelihood.standing import Standing

OTHERS = 3  # functions of a variable that are fitted in all relations at once
ROUNDS = 3  # moves a relation, at most


@dataclass(frozen=True, eq=False)
class _Place:
    """Functions of one variable in a relation: what they are multiplied by, what stands beside them, what it says."""

    relation: int
    families: set[Family]
    rests: tuple[Term, ...]
    base: list[int]
    imitated: Imitated

    def with_family(self, family: Family) -> Choice:
        """Return the same with another function of the variable."""
        return Choice(tuple(family.term * rest for rest in self.rests), family.constants)

    def missed(self, family: Family, values: Mapping[str, float]) -> float:
        """Return the share of what is said that another function leaves at these constants."""
        squares = float(self.imitated.said @ self.imitated.said)
        return self.imitated.missed([Placed(self.with_family(family), values)]) / max(squares, 1e-300)


@dataclass(frozen=True, eq=False)
class Sharing(Beginnings):
    """The moves that put one function into several relations."""

    def pooled(self, standing: Standing) -> tuple[Self, Standing]:
        """Return the choice with more candidates, a budget as large again for them, and the model among them.

        These are every function that stands in one relation in all others, and in its place the other functions of
        its variable.
        """
        targets, terms = self.space.frame.targets, self.functions(standing.fit)
        split = (self.split(t, name) for t in terms for name in self.families)
        others = [f.term * s[1] for s in split if s is not None for f in self.families[s[0].variable]]
        wanted = [(r, Product(None, t)) for t in dict.fromkeys((*terms, *others)) for r in range(len(targets))]
        made = [candidate(r, product, targets[r]) for r, product in wanted if (r, product) not in self.number]
        places = range(len(self.space.mechanisms), len(self.space.mechanisms) + len(made))
        number = {(m.parts[0].relation, m.parts[0].product): k for k, m in zip(places, made, strict=True)}
        space = self.space.among([*self.space.mechanisms, *made])
        budget = space.budget
        if terms:
            space = space.within(Budget(budget.limit, budget.monitor, budget.deadline))
        wide = replace(self, space=space, number={**self.number, **number})
        fit = replace(standing.fit, theta=wide.padded(standing.fit.theta))
        said = None if standing.said is None else replace(standing.said, theta=wide.padded(standing.said.theta))
        return wide, replace(standing, fit=fit, said=said)

    def together(self, standing: Standing) -> Standing:
        """Return the model with functions in several relations, where the likelihood prefers that."""
        price = self.moves().penalised
        for _ in range(ROUNDS * len(self.space.frame.targets)):
            least = price(standing.fit) - GAIN
            others = (trial for other in self.elsewhere(standing) for trial in (other, *self.shared(other)))
            trials = chain(self.shared(standing), others)
            better = next((t for t in trials if self.space.budget.over or price(t.fit) < least), None)
            if better is None or not price(better.fit) < least:
                break
            # What follows the record better than the model before says what other functions are to come near to.
            told = better.said is not None and better.fit.cost < better.said.cost
            standing = replace(better, said=None) if told else better
        return standing

    def shared(self, standing: Standing) -> Iterator[Standing]:
        """Yield the model with one relation after the other said by functions of the others, and plain terms."""
        fit = standing.fit
        for r in range(len(self.space.frame.targets)):
            terms = [t for t in self.functions(fit) if t not in self.functions(fit, r)]
            own = [s.relation == r for s in self.suspected]
            none = tuple(Placed(Choice()) if o else p for o, p in zip(own, standing.placed, strict=True))
            given = [terms, *([t] for t in terms if len(terms) > 1)] if terms else []
            ways = [(some, measured) for some in given for measured in (False, True)]
            bases = {base: m for some, m in ways for base in self.beside_functions(standing, r, some, m)}
            for base, measured in bases.items():
                imitated = self.imitated(r, standing.said or fit, base, measured, fit.theta)
                theta = None if imitated is None else self.written(r, fit.theta, list(base), [], imitated)
                found = self.fitted(theta, fit)
                if found is not None:
                    yield Standing(found, none, standing.said)

    def beside_functions(
        self, standing: Standing, relation: int, terms: Sequence[Term], measured: bool
    ) -> Iterator[tuple[int, ...]]:
        """Yield what may say a relation, with functions of others and plain terms, as numbers.

        These are found from the functions alone, and beside a constant, the own state, and all variables.

        Args:
            standing: the model.
            relation: its number.
            terms: the functions.
            measured: whether it is what differences of the smoothed states say: a fraction says much near a pole.
        """
        plain, own, names = self.plain(relation), self.own_state(relation), self.space.frame.variables
        among = [*(self.number[relation, Product(None, t)] for t in terms), *plain]
        imitated = self.imitated(relation, standing.said or standing.fit, among, measured, standing.fit.theta)
        if imitated is None:
            return
        whole = max(float(imitated.said @ imitated.said), 1e-300)
        texts = [self.space.mechanisms[k].parts[0].product.text for k in among]
        for few in ((), (ONE.text,), (ONE.text, own), (ONE.text, *names)):
            begin = [j for j, text in enumerate(texts) if j < len(terms) or text in few]
            for unknown in (self.unknown(standing.fit, relation, measured) / whole, 0.0):
                yield tuple(sorted(among[j] for j in beside(imitated, begin, unknown)))

    def elsewhere(self, standing: Standing) -> Iterator[Standing]:
        """Yield the model with another function of a variable in the place of one, in all its relations at once.

        In a single one that is worth a look, too: others may be said by that other function alone.
        """
        for name, families in self.families.items():
            places = self.places(standing, name)
            ranked = list[tuple[float, Family, Mapping[str, float]]]()
            for family in families:
                if any(p.families != {family} for p in places):
                    near = [p.imitated.nearest(p.with_family(family), ())[1].values for p in places]
                    tried = [(sum(p.missed(family, v) for p in places), family, v) for v in near]
                    ranked.append(min(tried, key=lambda found: found[0]))
            for _, family, values in sorted(ranked, key=lambda found: found[0])[:OTHERS]:
                theta: FloatArray | None = standing.fit.theta
                for p in places:
                    if theta is not None:
                        chosen = [Placed(p.with_family(family), values)]
                        theta = self.written(p.relation, theta, p.base, chosen, p.imitated)
                found = self.fitted(theta, standing.fit)
                if found is not None:
                    yield Standing(found, self.placed_anew(standing, name, family, values), standing.said)

    def places(self, standing: Standing, name: str) -> list[_Place]:
        """Return the relations of a model that hold functions of a variable."""
        found, fit = list[_Place](), standing.fit
        for r in range(len(self.space.frame.targets)):
            here = {t: s for t in self.functions(fit, r) if (s := self.split(t, name)) is not None}
            base = [k for k, p in self.present(fit, r) if p.factor is None and p.term not in here]
            imitated = self.imitated(r, standing.said or fit, base, False, fit.theta) if here else None
            if imitated is not None:
                families, rests = zip(*here.values(), strict=True)
                found.append(_Place(r, set(families), tuple(dict.fromkeys(rests)), base, imitated))
        return found

    def placed_anew(
        self, standing: Standing, name: str, family: Family, values: Mapping[str, float]
    ) -> tuple[Placed, ...]:
        """Return what stands for every suspicion with another function of a variable.

        Args:
            standing: the model before.
            name: of the variable.
            family: the other function.
            values: of its constants.
        """
        anew = list[Placed]()
        for placed in standing.placed:
            split = [self.split(t, name) for t in placed.choice.terms]
            rests = [s[1] for s in split if s is not None]
            other = Choice(tuple(family.term * rest for rest in rests), family.constants)
            anew.append(Placed(other, values) if rests else placed)
        return tuple(anew)

    def functions(self, fit: Fit, relation: int | None = None) -> list[Term]:
        """Return the terms of a model that hold functions, those of one relation or of all together."""
        relations = range(len(self.space.frame.targets)) if relation is None else (relation,)
        return list(dict.fromkeys(p.term for r in relations for k, p in self.present(fit, r) if k >= self.own))

    def everywhere(self, fit: Fit) -> list[int]:
        """Return the numbers of the functions of a model in all relations: a rate of one balance may be in others."""
        places = ((r, Product(None, t)) for t in self.functions(fit) for r in range(len(self.space.frame.targets)))
        return sorted(k for place in places if (k := self.number[place]) >= self.own)

    def split(self, term: Term, name: str) -> tuple[Family, Term] | None:
        """Return the function of a variable that a term holds, and the rest of the term; None where it holds none.

        A rest with constants of its own is another function: the product of the two is none of one variable.
        """
        if name not in term.names:
            return None
        for family in self.families.get(name, ()):
            if all(term.power_of(atom) == power for atom, power in family.term.factors):
                rest = Term(tuple(f for f in term.factors if f not in family.term.factors))
                if rest.names.isdisjoint(family.term.names) and rest.names.isdisjoint(self.space.frame.constants):
                    return family, rest
        return None

    def fitted(self, theta: FloatArray | None, fit: Fit) -> Fit | None:
        """Return the fit of other coefficients from where a fit ended, less what is not worth its price.

        What is said of a state that is hardly more than its noise is a poor beginning: while there is hope it goes on.
        """
        if theta is None:
            return None
        found = self.space.fit(theta, theta.nonzero()[0], fit.x0, self.moves().defect_std, iterations=FEW)
        if found is not None and not found.converged and found.cost < HOPELESS * fit.cost:
            found = self.tightened(theta)
        return self.pruned(found) if found is not None and found.cost < HOPELESS * fit.cost else None
