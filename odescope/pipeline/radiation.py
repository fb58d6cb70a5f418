"""States and inputs that are temperatures: one identification more with their fourth powers, where a model imitates it.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from odescope.events import Progress
from odescope.library.expression import Name, Term
from odescope.library.families import ABOVE_ZERO, in_kelvins
from odescope.library.parse import Scope, parse_term
from odescope.library.readable import readable
from odescope.likelihood.refinement import Refinement
from odescope.model.scores import SuspicionScore
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed, relations_form
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.stages import refine_form
from odescope.pipeline.temperatures import AT_FIRST
from odescope.pipeline.units import units_of
from odescope.pipeline.wider import (
    TIMES,
    basis_of,
    better_or_simpler,
    promises,
    regressed_with,
    searched_with,
    with_basis,
    with_extra,
    within,
)
from odescope.pipeline.work import Work

DEGREE = 2  # of the products of states and inputs: more imitates what is radiated


def radiated(work: Work, filtered: Filtered, regressed: Regressed) -> tuple[Posed, Refinement] | None:
    """Return relations in few terms with what bodies radiate, and their model; None where none promises.

    With it a library needs no cubes and is small: it is tried first, and its model is kept where it follows the record
    with no term in doubt, or runs so near to it that what its steps and its samples leave moves nothing.

    Args:
        work: whose study says of which variables functions may be looked for.
        filtered: the records and their signals.
        regressed: what regression in the default library found.
    """
    powers = _powers(work, filtered)
    if not powers:
        return None
    wide = within(_wide(work, powers), AT_FIRST)
    found = regressed_with(wide, filtered)
    if found is None or not promises(found, regressed):
        return None
    work.monitor.tell(Progress("suspicion", "search with what is radiated", 0, 1))
    posed = relations_form(wide.study, (found,), lambda _: found)
    refinement = refine_form(wide, filtered, posed)
    if refinement is None or not (refinement.outcome.sure and (refinement.exact or refinement.hardly_off)):
        return None
    return (posed, replace(refinement, finished=True)) if any(_radiating(refinement, powers)) else None


def with_radiation(
    work: Work, filtered: Filtered, refinement: Refinement | None
) -> tuple[Refinement | None, tuple[SuspicionScore, ...]]:
    """Return the model with what bodies radiate, where that is evidently better, and what was found.

    Two that exchange heat so hold the fourth powers of both temperatures in both balances (Stefan and Boltzmann): while
    squares and cubes of one imitate its own, no function of the other is seen. Nothing is tried where no temperature
    has an absolute zero, a model holds them in lines alone, or a library was written by hand.

    Args:
        work: whose study says of which variables functions may be looked for.
        filtered: the records and their signals.
        refinement: the model so far, if there is one.
    """
    powers = _powers(work, filtered)
    if not powers or (refinement is not None and not _imitates(refinement, powers)):
        return refinement, ()
    wide = _wide(work, powers)
    found = regressed_with(wide, filtered)
    if found is None:
        return refinement, ()
    work.monitor.tell(Progress("suspicion", "search with what is radiated", 0, 1))
    _, other = searched_with(wide, filtered, found, refinement, TIMES)
    if other is None or not (better_or_simpler(other, refinement) and any(_radiating(other, powers))):
        return refinement, ()
    return other, tuple(_scores(other, powers, filtered, other.gained_over(refinement)))


def _powers(work: Work, filtered: Filtered) -> dict[str, Term]:
    """Return the fourth power of every temperature, by its name; none for a library by hand."""
    if work.study.library.by_hand or not filtered.sample.complete:
        return {}
    units = units_of(filtered)
    zeros = {n: zero for n in work.study.suspects if (zero := ABOVE_ZERO.get(units.get(n) or "")) is not None}
    return {n: parse_term(f"({in_kelvins(n, zero)})**4", Scope.of([n])) for n, zero in zeros.items()}


def _wide(work: Work, powers: Mapping[str, Term]) -> Work:
    """Return the work for a study with fourth powers beside products of states and inputs."""
    return with_extra(with_basis(work, basis_of(work.study), DEGREE), tuple(t.text for t in powers.values()))


def _imitates(refinement: Refinement, powers: Mapping[str, Term]) -> bool:
    """Say whether a model has powers, products or fractions of temperatures, or does not follow the record."""
    parts = (p.product for k in refinement.fit.present for p in refinement.space.mechanisms[k].parts)
    degrees = (sum(p.term.power_of(Name(n)) for n in powers) + (p.factor is not None) for p in parts)
    return refinement.wanting or any(degree > 1 for degree in degrees)


def _radiating(refinement: Refinement, powers: Mapping[str, Term]) -> Iterator[tuple[int, str]]:
    """Yield relation and temperature of what is radiated in a model."""
    parts = [p for k in refinement.fit.present for p in refinement.space.mechanisms[k].parts]
    held = {(p.relation, p.product.term) for p in parts}
    for r in range(refinement.space.relations):
        yield from ((r, name) for name, term in powers.items() if (r, term) in held)


def _scores(
    found: Refinement, powers: Mapping[str, Term], filtered: Filtered, gain: float | None
) -> Iterator[SuspicionScore]:
    """Yield what was found, by target and temperature."""
    signals = filtered.signals
    for r, name in _radiating(found, powers):
        seen, tried = signals.joined()[signals.row(name)], (readable(powers[name]),)
        low, high = float(seen.min()), float(seen.max())
        yield SuspicionScore(signals.targets[r], name, "radiation", 0, low, high, tried, tried, gain)
