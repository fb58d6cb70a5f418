"""States and inputs that are temperatures: one identification more with Arrhenius' law, where a model imitates it.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations_with_replacement

import msgspec

from odescope.events import Progress
from odescope.library.families import ABOVE_ZERO, ACTIVATION, Family, families_of
from odescope.library.readable import readable
from odescope.likelihood.refinement import Refinement
from odescope.model.scores import SuspicionScore
from odescope.pipeline.filtering import Filtered, signals_of
from odescope.pipeline.forms import Posed, relations_form
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.stages import refine_form
from odescope.pipeline.units import units_of
from odescope.pipeline.wider import (
    LEAST,
    TIMES,
    basis_of,
    evidently_better,
    promises,
    regressed_with,
    with_basis,
    within,
)
from odescope.pipeline.work import Work
from odescope.signals.bursts import without_bursts
from odescope.study.library_options import Span

DEGREE = 2  # of the products of states and inputs
AT_FIRST = 40.0  # units of budget for a search in a small library: another comes if it is no law
CLOSE = 1.1  # times an energy that was found, and the inverse: its range beside a second one


def rates(work: Work, filtered: Filtered, regressed: Regressed) -> tuple[Posed, Refinement] | None:
    """Return relations in few terms with rates that go with a temperature, and their model; None where none promises.

    A reactor that ignites is too steep for products of its temperature to imitate, and too quick for regression to tell
    many of these apart. With what flows in and out, and rates, a library is small: it is tried first, and its model is
    kept where it follows the record with no term in doubt. Where it ignites the signals are wrong, and long steps run
    away: what is between such bursts tells the law. Nothing is tried where there is no temperature or no amount, or a
    library was written by hand.

    Args:
        work: whose study says of which variables functions may be looked for.
        filtered: the records and their signals.
        regressed: what regression in the default library found.
    """
    if work.study.library.by_hand or not filtered.sample.complete:
        return None
    factors = _factors(work, filtered, ())
    amounts = _amounts(work, filtered, factors)
    if not factors or not amounts:
        return None
    warm = {f.variable for f in factors}
    inflows = [name for name in work.study.suspects if name in work.study.inputs and name not in warm]
    flows = tuple(f"{inflow}*{state}" for inflow in inflows for state in filtered.signals.states)
    two = (*factors, *_factors(work, filtered, tuple(_spans(factors))))
    first = (two, ()) if len(amounts) > 1 else (factors, ())  # reactions in a row, or there and back, have two energies
    calm, tried = _between_bursts(work, filtered), list[tuple[Work, Regressed]]()
    for among, beside in dict.fromkeys([first, (factors, flows)]):
        wide = within(_with_rates(work, amounts, among, _spans(among), 1, beside), AT_FIRST)
        found = regressed_with(wide, calm)
        # The default library was regressed on bursts, too: criteria of other rows do not compare.
        if found is not None and (calm is not filtered or promises(found, regressed)):
            tried.append((wide, found))
    for wide, found in sorted(tried, key=lambda t: t[1].criterion):
        work.monitor.tell(Progress("suspicion", "search with rates that go with a temperature", 0, 1))
        posed = _posed(wide, found)
        refinement = refine_form(wide, calm, posed)
        if refinement is not None and refinement.exact and refinement.outcome.sure and _holds(refinement):
            left = 1.0 - calm.records.samples / filtered.records.samples
            # Finished: it would not spend a larger budget than its own.
            return posed, replace(refinement, finished=True, bursts=left)
    return None


def _between_bursts(work: Work, filtered: Filtered) -> Filtered:
    """Return the pieces of the records between bursts, and their signals; all as it is where there are none.

    Args:
        work: whose study says how signals are filtered.
        filtered: the records and their signals.
    """
    estimate = partial(signals_of, work.study, inputs=filtered.inputs)
    found = without_bursts(filtered.signals, filtered.records, estimate)
    return filtered if found is None else replace(filtered, signals=found[0], records=found[1])


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
    amounts = _amounts(work, filtered, factors)
    if not factors or not amounts:
        return refinement, ()
    balances = [r for r, c in enumerate(signals.coordinates) if c.name in amounts]
    law = refinement if refinement is not None and _holds(refinement) else None
    if refinement is not None and not wanting:
        if law is not None and settled and not _imitates(law, balances, factors):
            return refinement, ()
        if refinement.lacks_nothing and settled:  # what else stands in doubt may be all wrong
            work = within(work, max(LEAST, TIMES * refinement.spent))
    spans = _spans(factors)
    if law is None:
        one = _searched(_with_rates(work, amounts, factors, spans), filtered)
        law = one if one is not None and evidently_better(one, refinement) else None
    if wanting if law is None else _imitates(law, balances, factors):
        more, found = _factors(work, filtered, tuple(spans)), () if law is None else law.settings.parameters
        known = {p.name: (p.value / CLOSE, p.value * CLOSE) for p in found if p.name in spans}
        spans = spans | known | _spans(more)
        two = _searched(_with_rates(work, amounts, (*factors, *more), spans), filtered)
        if two is not None and evidently_better(two, law or refinement):
            law, factors = two, (*factors, *more)
    if law is None or law is refinement:
        return refinement, ()
    return law, tuple(_scores(law, factors, filtered, law.gained_over(refinement)))


def _with_rates(
    work: Work,
    amounts: Sequence[str],
    factors: Sequence[Family],
    spans: Mapping[str, Span],
    degree: int = DEGREE,
    beside: Sequence[str] = (),
) -> Work:
    """Return the work for a study with rates that go with temperatures.

    Args:
        work: for the study.
        amounts: the states that may react.
        factors: of their rates.
        spans: of the constants in these.
        degree: of the products of states and inputs.
        beside: more candidates.
    """
    wide = with_basis(work, basis_of(work.study), degree)
    reactants = (*amounts, *(f"{a}*{b}" for a, b in combinations_with_replacement(amounts, 2)))
    extra = (*(f"{r}*{f.term.text}" for f in factors for r in reactants), *beside)
    library = msgspec.structs.replace(wide.study.library, extra=extra, parameters=dict(spans))
    return replace(wide, study=msgspec.structs.replace(wide.study, library=library))


def _searched(wide: Work, filtered: Filtered) -> Refinement | None:
    """Return the model of a search with rates that go with temperatures, None where there is none."""
    tried = regressed_with(wide, filtered)
    if tried is None:
        return None
    wide.monitor.tell(Progress("suspicion", "search with rates that go with a temperature", 0, 1))
    return refine_form(wide, filtered, _posed(wide, tried))


def _posed(wide: Work, found: Regressed) -> Posed:
    """Return the relations of a library, searched from what regression finds at all energies."""
    return relations_form(wide.study, (found, *found.elsewhere), lambda _: found)


def _amounts(work: Work, filtered: Filtered, factors: Sequence[Family]) -> list[str]:
    """Return the states that may react: all but those that rates go with."""
    warm = {f.variable for f in factors}
    return [n for n in filtered.signals.states if n in work.study.suspects and n not in warm]


def _spans(factors: Sequence[Family]) -> dict[str, Span]:
    """Return the ranges of the constants in factors, by name."""
    return {c.name: (c.low, c.high) for f in factors for c in f.constants}


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
