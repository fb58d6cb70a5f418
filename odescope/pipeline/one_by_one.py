"""The terms of Lagrange's equations one by one, as candidates of relations where no energy says all that a record does.

docs/method.md, Forms compete.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from odescope.likelihood.refinement import Refinement
from odescope.model.relation import Relation
from odescope.pipeline.contender import LOOSE, Contender
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.wider import promises, regressed_with
from odescope.pipeline.work import Work


def with_terms_of_mechanisms(
    work: Work, filtered: Filtered, regressed: Regressed, contenders: Sequence[Contender]
) -> Regressed:
    """Return what regression finds beside the terms of Lagrange's equations, where these promise more.

    What a controller holds at an angle is a spring that relations have no term for. And a load that hangs from a
    trolley whose drive takes no notice of it follows the acceleration of the trolley and gives nothing back: Lagrange's
    equations say so with an energy of the load that is next to nothing. The record tells no number of that, and of
    relations with the acceleration among their terms it does.

    Args:
        work: whose study leaves the library open.
        filtered: the records and their signals.
        regressed: what regression found in the library of the relations.
        contenders: Lagrange's equations among them.
    """
    study = work.study
    found = [(c.refinement, c.loose) for c in contenders if c.follows and c.refinement is not None]
    if not found or study.library.by_hand or not study.suspects or not filtered.sample.complete:
        return regressed
    refinement, loose = found[0]
    wider = regressed_with(work, filtered, beside=_one_by_one(refinement, filtered.signals.targets))
    return wider if wider is not None and (loose or promises(wider, regressed)) else regressed


def _one_by_one(refinement: Refinement, targets: Sequence[str]) -> list[Relation]:
    """Return the equations of motion, without the accelerations of others in those whose scale is told.

    Args:
        refinement: Lagrange's equations.
        targets: their accelerations, one an equation.
    """
    untold = {
        m.term
        for m in refinement.mechanisms
        if m.kind == "kinetic" and m.std_error is not None and m.std_error > LOOSE * abs(m.coefficient)
    }
    present = [refinement.space.mechanisms[k] for k in refinement.fit.present]
    parts = [p for m in present if m.kind == "kinetic" and m.term in untold for p in m.parts]
    given = {t for p in parts if (t := p.product.factor) == targets[p.relation]}
    return [
        r if target in given else replace(r, terms=tuple(t for t in r.terms if t.factor in (None, target)))
        for target, r in zip(targets, refinement.relations, strict=True)
    ]
