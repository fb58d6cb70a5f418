"""States and inputs that are temperatures: one identification more with Arrhenius' law, where a model imitates it.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
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
from odescope.study.library_options import Span

DEGREE = 2  # of the products of states and inputs
CLOSE = 1.1  # times an energy that was found, and the inverse: its range beside a second one


def with_arrhenius(
    work: Work, filtered: Filtered, refinement: Refinement | None, suspicions: Sequence[SuspicionScore]
) -> tuple[Refinement | None, tuple[SuspicionScore, ...]]:
    """Return the model with rates that go with a temperature, where that is evidently better, and what was found.

    Where a reaction gives off heat the same rate stands in several relations, beside much else that depends on the
    temperature. One reactant or two are tried; a second energy, as of a reaction that follows the first, where the
    model still lets an amount go with the temperature. Nothing is where the model follows the record with few terms
    and leaves no suspicion, or has the law already and nothing else is in doubt, or a library was written by hand.

    Args:
        work: whose study says of which variables functions may be looked for.
        filtered: the records and their signals.
        refinement: the model so far, if there is one.
        suspicions: against its terms, and what was found for them.
    """
    study, signals, settled = work.study, filtered.signals, all(s.found for s in suspicions)
    wanting = refinement is None or refinement.wanting
    if study.library.by_hand or not filtered.sample.complete or not (wanting or suspicions):
        return refinement, ()
    factors = _factors(work, filtered, ())
    amounts = [n for n in signals.states if n in study.suspects and n not in {f.variable for f in factors}]
    if not factors or not amounts:
        return refinement, ()
    balances = [r for r, c in enumerate(signals.coordinates) if c.name in amounts]
    law = refinement if refinement is not None and _holds(refinement) else None
    if refinement is not None and not wanting:
        if law is not None and settled and not _imitates(law, balances, factors):
            return refinement, ()
        if refinement.lacks_nothing and settled:  # what else stands in doubt may be all wrong
            work = within(work, max(LEAST, TIMES * refinement.spent))
    spans = {c.name: (c.low, c.high) for f in factors for c in f.constants}
    if law is None:
        one = _with_rates(work, filtered, amounts, factors, spans)
        law = one if one is not None and evidently_better(one, refinement) else None
    if wanting if law is None else _imitates(law, balances, factors):
        more, found = _factors(work, filtered, tuple(spans)), () if law is None else law.settings.parameters
        known = {p.name: (p.value / CLOSE, p.value * CLOSE) for p in found if p.name in spans}
        spans = spans | known | {c.name: (c.low, c.high) for f in more for c in f.constants}
        two = _with_rates(work, filtered, amounts, (*factors, *more), spans)
        if two is not None and evidently_better(two, law or refinement):
            law, factors = two, (*factors, *more)
    if law is None or law is refinement:
        return refinement, ()
    return law, tuple(_scores(law, factors, filtered, law.gained_over(refinement)))


def _with_rates(
    work: Work, filtered: Filtered, amounts: Sequence[str], factors: Sequence[Family], spans: Mapping[str, Span]
) -> Refinement | None:
    """Return the model of a search with rates that go with temperatures, None where there is none.

    Args:
        work: for the study.
        filtered: the records and their signals.
        amounts: the states that may react.
        factors: of their rates.
        spans: of the constants in these.
    """
    wide = with_basis(work, basis_of(work.study), DEGREE)
    reactants = (*amounts, *(f"{a}*{b}" for a, b in combinations_with_replacement(amounts, 2)))
    rates = tuple(f"{r}*{f.term.text}" for f in factors for r in reactants)
    library = msgspec.structs.replace(wide.study.library, extra=rates, parameters=dict(spans))
    wide = replace(wide, study=msgspec.structs.replace(wide.study, library=library))
    tried = regressed_with(wide, filtered)
    if tried is None:
        return None
    work.monitor.tell(Progress("suspicion", "search with rates that go with a temperature", 0, 1))
    return refine_form(wide, filtered, relations_form(wide.study, (tried, *tried.elsewhere), lambda _: tried))


def _factors(work: Work, filtered: Filtered, taken: Sequence[str]) -> tuple[Family, ...]:
    """Return the factor of Arrhenius' law of every temperature.

    Where one is a state, those that drive it, as a coolant's, are not where the reaction is.

    Args:
        work: whose study says of which variables functions may be looked for.
        filtered: the records and their signals.
        taken: names that constants may not have.
    """
    signals, units = filtered.signals, units_of(filtered)
    used = {*signals.names, *signals.targets, *taken}
    warm = [n for n in work.study.suspects if units.get(n) in ABOVE_ZERO]
    found = (f for n in warm for f in families_of(n, signals.joined()[signals.row(n)], used, False, units[n]))
    factors = tuple(f for f in found if any(c.name.startswith(ACTIVATION) for c in f.constants))
    return tuple(f for f in factors if f.variable in signals.states) or factors


def _imitates(found: Refinement, balances: Collection[int], factors: Sequence[Family]) -> bool:
    """Say whether an amount goes with a temperature in other ways than by Arrhenius' law.

    Args:
        found: the model.
        balances: the relations of what may react.
        factors: that stand for the law.
    """
    warm = {f.variable for f in factors}
    known = {c.name for f in factors for c in f.constants}
    parts = (p for k in found.fit.present for p in found.space.mechanisms[k].parts if p.relation in balances)
    return any(not p.product.term.names.isdisjoint(warm) and p.product.term.names.isdisjoint(known) for p in parts)


def _holds(refinement: Refinement) -> bool:
    """Say whether a model has a factor of Arrhenius' law."""
    present = (refinement.space.mechanisms[k] for k in refinement.fit.present)
    return any(m.kind == "constant" and m.place.startswith(ACTIVATION) for m in present)


def _scores(
    found: Refinement, factors: Sequence[Family], filtered: Filtered, gain: float | None
) -> Iterator[SuspicionScore]:
    """Yield what was found, by target and temperature."""
    signals = filtered.signals
    for r, target in enumerate(signals.targets):
        terms = [p.product.term for k in found.fit.present for p in found.space.mechanisms[k].parts if p.relation == r]
        for factor in factors:
            held = tuple(dict.fromkeys(readable(t) for t in terms if factor.constants[0].name in t.names))
            if held:
                seen = signals.joined()[signals.row(factor.variable)]
                low, high, tried = float(seen.min()), float(seen.max()), (readable(factor.term),)
                yield SuspicionScore(target, factor.variable, "temperature", 0, low, high, tried, held, gain)
