"""Sums and differences of angles, where products of their sines and cosines take two terms for one.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import msgspec

from odescope.events import Progress
from odescope.library.expression import Call, Term
from odescope.library.product import Product
from odescope.likelihood.refinement import Refinement
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed
from odescope.pipeline.suspicion import replaces
from odescope.pipeline.wider import TIMES, regressed_with, searched_with
from odescope.pipeline.work import Work


def with_sums(
    work: Work, filtered: Filtered, posed: Posed, refinement: Refinement | None
) -> tuple[Posed, Refinement | None]:
    """Return relations and their model: with sums and differences of angles, where that is the better one.

    Phases pull at each other by the sine of a difference, a trailer turns by that of the angle between it and what
    pulls it. Sums span what products do: neither fits better, and where these take two terms for one, a record of
    phases that have locked cannot decide among them. Nothing is tried where no two terms of the model would be one.

    Args:
        work: whose study leaves open which library it is, where all angles are of order 1.
        filtered: the records and their signals.
        posed: the relations in products.
        refinement: the model that the search in them ended with, if there is one.
    """
    own, angles = work.study.library, [c for c in work.study.measured() if c.angle]
    undecided = own.by_default and own.sums == "auto" and all(c.order == 1 for c in angles)
    if not (undecided and len(angles) > 1 and filtered.sample.complete):
        return posed, refinement
    if refinement is not None and not _would_merge(refinement, {c.name for c in angles}):
        return posed, refinement
    wide = replace(work, study=msgspec.structs.replace(work.study, library=msgspec.structs.replace(own, sums=True)))
    found = regressed_with(wide, filtered)
    if found is None:
        return posed, refinement
    work.monitor.tell(Progress("suspicion", "search with sums and differences of angles", 0, 1))
    in_sums, other = searched_with(wide, filtered, found, refinement, TIMES)
    if other is None or (refinement is not None and not replaces(other, refinement)):
        return posed, refinement
    return in_sums, other


def _would_merge(refinement: Refinement, angles: Collection[str]) -> bool:
    """Say whether a relation holds two products of functions of the same angles, with the same beside them.

    Args:
        refinement: the model.
        angles: their names.
    """
    parts = [p for k in refinement.fit.present for p in refinement.space.mechanisms[k].parts]
    waves = [_split(p.product, angles) for p in parts]
    pairs = [(p.relation, *wave) for p, wave in zip(parts, waves, strict=True) if len(wave[1]) > 1]
    return len(set(pairs)) < len(pairs)


def _split(product: Product, angles: Collection[str]) -> tuple[Product, frozenset[str]]:
    """Return a product less its functions of angles, and the angles that these are of."""
    waves = [f for f in product.term.factors if isinstance(f[0], Call) and f[0].argument.names <= set(angles)]
    rest = Term(tuple(f for f in product.term.factors if f not in waves))
    return Product(product.factor, rest), Term(tuple(waves)).names
