"""States and inputs that are temperatures: one identification more with Arrhenius' law, where a model imitates it.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations_with_replacement

import msgspec

from odescope.events import Progress
from odescope.library.families import ABOVE_ZERO, ACTIVATION, Family, families_of
from odescope.library.readable import readable
from odescope.likelihood.refine import Refinement
from odescope.model.scores import SuspicionScore
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import relations_form
from odescope.pipeline.stages import refine_form
from odescope.pipeline.units import units_of
from odescope.pipeline.wider import LEAST, TIMES, basis_of, evidently_better, regressed_with, with_basis, within
from odescope.pipeline.work import Work

DEGREE = 2  # of the products of states and inputs


def with_arrhenius(
    work: Work, filtered: Filtered, refinement: Refinement | None, suspicions: Sequence[SuspicionScore]
) -> tuple[Refinement | None, tuple[SuspicionScore, ...]]:
    """Return the model with rates that go with a temperature, where that is evidently better, and what was found.

    Where a reaction gives off heat the same rate stands in several relations, beside much else that depends on the
    temperature. One reactant or two are tried. Nothing is where the model follows the record with few terms and
    leaves no suspicion, or has the law already and nothing else is in doubt, or a library was written by hand.

    Args:
        work: whose study says of which variables functions may be looked for.
        filtered: the records and their signals.
        refinement: the model so far, if there is one.
        suspicions: against its terms, and what was found for them.
    """
    study, signals, settled = work.study, filtered.signals, all(s.found for s in suspicions)
    if study.library.by_hand or not filtered.sample.complete:
        return refinement, ()
    if refinement is not None and not refinement.wanting and (not suspicions or (settled and _holds(refinement))):
        return refinement, ()
    factors = _factors(work, filtered)
    amounts = [n for n in signals.states if n in study.suspects and n not in factors]
    if not factors or not amounts:
        return refinement, ()
    wide = with_basis(work, basis_of(study), DEGREE)
    reactants = (*amounts, *(f"{a}*{b}" for a, b in combinations_with_replacement(amounts, 2)))
    rates = tuple(f"{r}*{f.term.text}" for f in factors.values() for r in reactants)
    spans = {c.name: (c.low, c.high) for f in factors.values() for c in f.constants}
    library = msgspec.structs.replace(wide.study.library, extra=rates, parameters=spans)
    wide = replace(wide, study=msgspec.structs.replace(wide.study, library=library))
    tried = regressed_with(wide, filtered)
    if tried is None:
        return refinement, ()
    work.monitor.tell(Progress("suspicion", "search with rates that go with a temperature", 0, 1))
    if refinement is not None and refinement.lacks_nothing and settled:  # what else stands in doubt may be all wrong
        wide = within(wide, max(LEAST, TIMES * refinement.spent))
    other = refine_form(wide, filtered, relations_form(wide.study, (tried, *tried.elsewhere), lambda _: tried))
    if other is None or not evidently_better(other, refinement):
        return refinement, ()
    return other, tuple(_scores(other, factors, filtered, other.gained_over(refinement)))


def _factors(work: Work, filtered: Filtered) -> dict[str, Family]:
    """Return the factor of Arrhenius' law of every temperature, by its name.

    Where one is a state, those that drive it, as a coolant's, are not where the reaction is.
    """
    signals, units = filtered.signals, units_of(filtered)
    taken = {*signals.names, *signals.targets}
    warm = [n for n in work.study.suspects if units.get(n) in ABOVE_ZERO]
    found = (f for n in warm for f in families_of(n, signals.joined()[signals.row(n)], taken, False, units[n]))
    factors = {f.variable: f for f in found if any(c.name.startswith(ACTIVATION) for c in f.constants)}
    return {n: f for n, f in factors.items() if n in signals.states} or factors


def _holds(refinement: Refinement) -> bool:
    """Say whether a model has a factor of Arrhenius' law."""
    present = (refinement.space.mechanisms[k] for k in refinement.fit.present)
    return any(m.kind == "constant" and m.place.startswith(ACTIVATION) for m in present)


def _scores(
    found: Refinement, factors: Mapping[str, Family], filtered: Filtered, gain: float | None
) -> Iterator[SuspicionScore]:
    """Yield what was found, by target and temperature."""
    signals = filtered.signals
    for r, target in enumerate(signals.targets):
        terms = [p.product.term for k in found.fit.present for p in found.space.mechanisms[k].parts if p.relation == r]
        for name, factor in factors.items():
            held = tuple(dict.fromkeys(readable(t) for t in terms if factor.constants[0].name in t.names))
            if held:
                seen = signals.joined()[signals.row(name)]
                low, high, tried = float(seen.min()), float(seen.max()), (readable(factor.term),)
                yield SuspicionScore(target, name, "temperature", 0, low, high, tried, held, gain)
