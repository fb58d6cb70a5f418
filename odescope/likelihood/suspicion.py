"""Suspicion: where a model may imitate a function that its library lacks.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.expression import ONE, Call, Name, Term
from odescope.library.families import NEGLIGIBLE
from odescope.library.product import Product
from odescope.likelihood.evidence import between, in_blocks
from odescope.likelihood.fit import Fit
from odescope.likelihood.refinement import Refinement
from odescope.likelihood.search import WHITE
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.smoothed_targets import explicit, rates
from odescope.likelihood.taken_out import outside

SEVERAL = 2  # powers of one variable that may be a function
FEW_INPUTS = 2  # that a function of another variable may be multiplied by, where it stands for what nothing is near to
QUANTILES = 12  # of a variable, between which the mean of a residual is taken
GOES_WITH = 0.05  # least share of a residual's variance that goes with a variable
DRIVES = 0.1  # of the power that dry friction takes: what a term has to give for that to be no chance
SURE = 3.0  # times what chance alone would give

Reason = Literal["powers", "fractions", "driven", "residual", "measured", "pair", "sine", "bend"]
JOINT: tuple[Reason, ...] = ("pair", "sine", "bend")  # reasons that are of no variable
MEASURED: tuple[Reason, ...] = ("residual", "measured")  # for which functions come near to what rates were measured


@dataclass(frozen=True)
class Suspicion:
    """A variable of which a relation may hold a function that is not in the library.

    `reason` is what says so: several powers of it, a fraction of it, a term of it that drives where dry friction
    brakes, or a residual that goes with it; `beside` is what such a function may be multiplied by, `terms` how many
    terms of the relation may be one; `squared` whether its square or a higher power divides, `divided` what a fraction
    divides; `falling` is what stands beside a function that falls off with an amount, the amount among it. What is
    "measured" of all variables says what a model imitates so badly that nothing is near to it. A "pair" is of no
    variable, but of two together, a "sine" is of any that may be an angle, and a "bend" of any that may reach a limit:
    a relation that imitates something may hold these.
    """

    relation: int
    variable: str
    reason: Reason
    beside: tuple[Term, ...] = (ONE,)
    terms: int = 0
    squared: bool = False
    falling: tuple[Term, ...] = ()
    divided: tuple[Term, ...] = ()


def suspicions(refinement: Refinement, names: Collection[str], declared: Collection[str]) -> tuple[Suspicion, ...]:
    """Return what a model's terms and its residual give reason to suspect.

    Args:
        refinement: the end of a likelihood stage, of plain candidates.
        names: of the variables whose functions may be looked for.
        declared: constants that its library declares.
    """
    space, found = refinement.space, refinement.fit
    names = set(names) - _of_functions(space, declared)
    terms, divided = ([list[Product]() for _ in space.frame.targets] for _ in range(2))
    apart = outside(space, found)
    for k in found.present.tolist():
        for part in space.mechanisms[k].parts:
            terms[part.relation].append(part.product)
            divided[part.relation] += [] if k in apart else [part.product]
    suspected, rate, constants = list[Suspicion](), _rates(space, terms), set(space.frame.constants)
    values = values_of_variables(space)
    for r, products in enumerate(terms):
        found_here = (_imitation(r, products, n, constants, rate.get(n)) for n in space.frame.variables if n in names)
        counted = (_less_outside(s, divided[r]) for s in found_here if s is not None)
        here = [_growing(space, values, _falling(values, s)) for s in counted]
        driven = (n for n in _driven(space, found, r) if n in names - {s.variable for s in here})
        suspected += [*here, *(Suspicion(r, n, "driven") for n in driven)]
    leaves_more = refinement.process is not None or refinement.outcome.scale > WHITE
    if leaves_more and not refinement.hardly_off:
        known = {s.relation for s in suspected}  # an imitation that is not good enough leaves a residual, too
        suspected += [s for s in _residual(space, found, names, terms) if s.relation not in known]
    return tuple(suspected)


def everywhere(
    refinement: Refinement, relations: Collection[int], names: Collection[str], declared: Collection[str]
) -> tuple[Suspicion, ...]:
    """Return the suspicion of a function of every variable in relations.

    Args:
        refinement: the end of a likelihood stage, of plain candidates.
        relations: numbers of these.
        names: of the variables whose functions may be looked for.
        declared: constants that its library declares.
    """
    space = refinement.space
    wanted, values = set(names) - _of_functions(space, declared), values_of_variables(space)
    able = [n for n in space.frame.variables if n in wanted]
    inputs = [n for n in space.frame.variables if n not in space.frame.states]
    driven = tuple(Term(((Name(n), 1),)) for n in (inputs if len(inputs) <= FEW_INPUTS else ()))
    return tuple(
        _growing(space, values, Suspicion(r, n, "measured", (ONE, *(t for t in driven if n not in t.names))))
        for r in sorted(relations)
        for n in able
    )


def with_pairs(suspected: Sequence[Suspicion]) -> tuple[Suspicion, ...]:
    """Return suspicions with three more for every relation that imitates something.

    These are of functions of two variables, of a sine of what may be an angle, and of a bend, beside them.
    """
    relations = dict.fromkeys(s.relation for s in suspected if s.reason in ("powers", "fractions"))
    return (*suspected, *(Suspicion(r, "", reason) for r in relations for reason in JOINT))


def _of_functions(space: SearchSpace, declared: Collection[str]) -> set[str]:
    """Return the variables of functions whose constants a library declares: it has said what it wants of these."""
    atoms = {a for m in space.mechanisms for p in m.parts for a, _ in p.product.term.factors if isinstance(a, Call)}
    return {n for a in atoms for n in a.argument.names if not a.argument.names.isdisjoint(declared)}


def _driven(space: SearchSpace, found: Fit, relation: int) -> list[str]:
    """Return the speeds that some term drives, on average, while dry friction brakes: it imitates a fall of that.

    Args:
        space: the candidates.
        found: the model.
        relation: its number.
    """
    coefficients, driven = dict[Term, float](), list[str]()
    for k in found.present:
        for p in space.mechanisms[k].parts:
            if p.relation == relation and p.product.factor is None:
                term = p.product.term
                coefficients[term] = coefficients.get(term, 0.0) + p.share * float(found.theta[k])
    for speed, friction in dry_friction(space, coefficients).items():
        terms = [friction, *(t for t in coefficients if speed in t.names and t != friction)]
        rows = space.evaluated([Term(((Name(speed), 1),)), *terms], found.theta)
        power = np.array([coefficients[t] * float(row @ rows[0]) for t, row in zip(terms, rows[1:], strict=True)])
        driven += [speed] if (power[1:] * power[0] < -DRIVES * power[0] ** 2).any() else []
    return driven


def dry_friction(space: SearchSpace, terms: Iterable[Term]) -> dict[str, Term]:
    """Return the terms that are dry friction of a single speed, by its name: the widths of such are optional constants.

    Args:
        space: whose constants they may name.
        terms: of a relation.
    """
    widths = {name for name, c in space.frame.constants.items() if c.optional}
    return {n: t for t in terms if t.names & widths for n in t.names - widths if t.names - widths == {n}}


def _rates(space: SearchSpace, terms: Sequence[Sequence[Product]]) -> dict[str, str]:
    """Return the names of the states that are the rates of others, by the names of these.

    Args:
        space: whose states they are.
        terms: of every relation; a state is the rate of another whose relation holds nothing else.
    """
    states, found = space.frame.states, dict[str, str]()
    for state, following in zip(states, space.frame.following.tolist(), strict=True):
        if following >= 0:
            found[state] = states[following]
            continue
        rest = [p for p in terms[-1 - following] if p != Product(space.frame.targets[-1 - following])]
        if len(rest) == 1 and rest[0].factor is None and rest[0].text in states:
            found[state] = rest[0].text
    return found


def _imitation(
    relation: int, products: Sequence[Product], name: str, constants: Collection[str], rate: str | None
) -> Suspicion | None:
    """Return why powers or fractions of a variable may be a function of it, None where they are not.

    Where the energy stays, even powers of a rate are functions of the position: beside them its power is one more.

    Args:
        relation: its number.
        products: what it holds.
        name: of the variable.
        constants: within functions: what holds some stands beside no other function.
        rate: name of the variable that is its rate, if one is.
    """
    powers = _powers([p for p in products if p.term.names.isdisjoint(constants)], name)
    if any(p.factor is not None and p.term.power_of(Name(name)) for p in products):
        # A fraction divides the whole relation, so the function may be in any of its terms: those that hold its
        # numerator, or all where that is a number, as in M/(1 + I), or may be a pole, V**2/(c - x)**2.
        # What is divided by 1 + a/N**2 is multiplied by N**2 and divided by N**2 + a.
        below = [p.term for p in products if p.factor is not None]
        dividing = [0.0, *(t.power_of(Name(name)) for t in below)]
        lowest, squared = min(dividing), max(dividing) - min(dividing) > 1
        above = [rest for rest, found in powers.items() if squared or found != {lowest}] or list(powers)
        terms = sum(p.term.power_of(Name(name)) != 0 for p in products)
        if len(below) == 1:  # what is divided by it goes with powers, which may be a law: i**2/x**2 - g
            divided = ({power - below[0].power_of(Name(name)) for power in found} - {0} for found in powers.values())
            terms = terms if any(len(found) >= SEVERAL for found in divided) else 0
        return Suspicion(relation, name, "fractions", tuple(dict.fromkeys((ONE, *above))), terms, squared)
    powers = {rest: found - {0} for rest, found in powers.items()}
    energy = [rest for rest, found in powers.items() if found and rate is not None and _even(rest, rate)]
    together = energy if len(energy) >= SEVERAL else []
    beside = [rest for rest, found in powers.items() if len(found) >= SEVERAL or rest in together]
    most = max((len(powers[rest]) for rest in beside), default=0)
    most = max(most, sum(len(powers[rest]) for rest in together))
    single = [rest for rest, found in powers.items() if found]
    # What divides another variable may divide a function, too: what flows out of a cone goes with sqrt(h)/h**2.
    common = [Term(((Name(name), p),)) for rest, found in powers.items() if rest != ONE for p in found if p < 0]
    multiplied = tuple(dict.fromkeys((ONE, *beside, *single, *common)))
    return Suspicion(relation, name, "powers", multiplied, most) if beside else None


def _less_outside(suspected: Suspicion, divided: Sequence[Product]) -> Suspicion:
    """Return a suspicion with the terms of a fraction, and what it divides, without those that stand outside of it."""
    if suspected.reason != "fractions" or not suspected.terms:
        return suspected
    terms = sum(p.term.power_of(Name(suspected.variable)) != 0 for p in divided)
    return replace(suspected, terms=terms, divided=tuple(_powers(divided, suspected.variable)))


def _powers(products: Iterable[Product], name: str) -> dict[Term, set[float]]:
    """Return the powers of a variable in a relation, by what else there is in their terms, which holds it nowhere.

    Args:
        products: of the relation; those with a target do not count.
        name: of the variable.
    """
    powers = dict[Term, set[float]]()
    for term in (p.term for p in products if p.factor is None):
        rest = Term(tuple(f for f in term.factors if f[0] != Name(name)))
        if name not in rest.names:
            powers.setdefault(rest, set()).add(term.power_of(Name(name)))
    return powers


def _even(term: Term, name: str) -> bool:
    """Say whether a term is an even power of a variable, 1 among them."""
    power = term.power_of(Name(name))
    return power % 2 == 0 and term == (Term(((Name(name), power),)) if power else ONE)


def _falling(values: Mapping[str, FloatArray], suspected: Suspicion) -> Suspicion:
    """Return a suspicion with what may stand beside an exponential that falls, where its variable is an amount.

    Growth goes with light, or with how many there are, and falls off again by a function of that, once it is too much.
    """
    own = values[suspected.variable]
    several = suspected.reason == "fractions" or suspected.terms > SEVERAL
    if not several or own.min() <= -NEGLIGIBLE * own.max():
        return suspected
    return replace(suspected, falling=tuple(r * Term(((Name(suspected.variable), 1),)) for r in suspected.beside))


def _growing(space: SearchSpace, values: Mapping[str, FloatArray], suspected: Suspicion) -> Suspicion:
    """Return a suspicion with the relation's own state among what stands beside functions, where neither has a sign.

    What has none often changes in proportion to itself, at a rate that is a function of it, or of something else that
    has none, as a temperature.

    Args:
        space: whose states they are.
        values: of the variables, by name (N,).
        suspected: of a variable.
    """
    own = space.frame.states[list(space.frame.following).index(-1 - suspected.relation)]
    if min(values[own].min(), values[suspected.variable].min()) <= 0.0:
        return suspected
    return replace(suspected, beside=tuple(dict.fromkeys((*suspected.beside, Term(((Name(own), 1),))))))


def _residual(
    space: SearchSpace, found: Fit, names: Collection[str], terms: Sequence[Sequence[Product]]
) -> list[Suspicion]:
    """Return the variable, in each relation, that its residual goes with most, where it clearly does with one.

    A function of it may stand where it does by itself, and before what multiplies it there.

    Args:
        space: the candidates.
        found: the model.
        names: of the variables whose functions may be looked for.
        terms: of every relation.
    """
    missing = np.subtract(rates(space), explicit(space, found))
    suspected = list[Suspicion]()
    columns = values_of_variables(space)
    for r, column in enumerate(missing):
        shares = {n: _share(column, columns[n]) for n in space.frame.variables if n in names}
        if shares and max(shares.values()) > GOES_WITH:
            name = max(shares, key=lambda n: shares[n])
            able = [p for p in terms[r] if p.term.names.isdisjoint(space.frame.constants)]
            beside = [rest for rest, powers in _powers(able, name).items() if powers != {0}]
            suspected.append(Suspicion(r, name, "residual", tuple(dict.fromkeys((ONE, *beside)))))
    return suspected


def _share(residual: FloatArray, variable: FloatArray) -> float:
    """Return the share of a residual's variance that means between quantiles of a variable explain, 0 if by chance."""
    if not np.isfinite(residual).all():
        return 0.0
    edges = np.unique(np.quantile(variable, np.linspace(0.0, 1.0, QUANTILES + 1)[1:-1]))
    place = np.searchsorted(edges, variable)
    count = np.maximum(np.bincount(place, minlength=len(edges) + 1), 1)
    means = np.bincount(place, residual - residual.mean(), minlength=len(edges) + 1) / count
    explained = (residual - residual.mean()) * means[place]
    variance = float(residual.var())
    if not variance > 0.0:
        return 0.0
    blocks = in_blocks(explained[:, None])
    sure = len(blocks) > 1 and float(blocks.sum()) ** 2 > SURE**2 * float(between(blocks)[0])
    return float(explained.mean()) / variance if sure else 0.0


def values_of_variables(space: SearchSpace) -> Mapping[str, FloatArray]:
    """Return the smoothed states and inputs, by name."""
    columns = space.evaluated([Term(((Name(n), 1),)) for n in space.frame.variables], np.zeros(len(space.mechanisms)))
    return dict(zip(space.frame.variables, columns, strict=True))


def imitates(product: Product, relation: int, suspected: Sequence[Suspicion]) -> bool:
    """Say whether a product of a relation may be part of an imitation.

    Args:
        product: of the relation.
        relation: its number.
        suspected: in all relations.
    """
    for s in suspected:
        if s.relation != relation or s.reason not in ("powers", "fractions"):
            continue
        power = product.term.power_of(Name(s.variable))
        if s.reason == "fractions" and (product.term != ONE if product.factor is not None else power):
            return True
        rest = Term(tuple(f for f in product.term.factors if f[0] != Name(s.variable)))
        if product.factor is None and power and rest in s.beside:
            return True
    return False
