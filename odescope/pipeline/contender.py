"""A form with its model, how that does, and which of several is kept."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from odescope.library.expression import Name, Term
from odescope.likelihood.findings import left_by
from odescope.likelihood.held_out import free_run_error
from odescope.likelihood.path import LOST
from odescope.likelihood.refine import WELL
from odescope.likelihood.refinement import Refinement
from odescope.model.model import Model
from odescope.model.scores import FormScore
from odescope.model.worth import MINOR
from odescope.pipeline.forms import Posed
from odescope.pipeline.physics import energy_of
from odescope.signals.estimate import Signals
from odescope.study.library_options import Form
from odescope.study.options import LeftOut

HARDLY = 0.02  # of the root mean square of a target
LITTLE = 0.25  # of it: white noise of the process that leaves the law most of the say
LOOSE = 0.5  # standard errors of a kinetic term over its coefficient
SEVERAL = 3  # powers of one coordinate in the forces of a potential: they may imitate a function of it
SPREAD = 1.1  # error of free runs over the least: within it fewer coefficients win
UNREFINED = 3.0  # times that of mechanisms: error of free runs of what regression has and the likelihood may improve


@dataclass(frozen=True, eq=False)
class Contender:
    """A form with its model, and how that does."""

    form: Form
    model: Model
    refinement: Refinement | None
    left_out: LeftOut
    coefficients: int
    free_run: float
    inertial: bool = True  # whether its kinetic energy is positive over the data, if it has one,
    loose: bool = False  # and whether part of that is not told from nothing
    left: float = np.inf  # to noise of the process, of the target that this takes up most of

    @property
    def misfit(self) -> float:
        """Residual variance over that of the noise."""
        return np.inf if self.refinement is None else float(self.refinement.outcome.scale)

    @property
    def follows(self) -> bool:
        """Whether it follows the record, with process noise if need be."""
        return self.refinement is not None and self.refinement.follows

    @property
    def exact(self) -> bool:
        """Whether it follows the record to within its noise."""
        return self.refinement is not None and self.refinement.exact

    @property
    def clear(self) -> bool:
        """Whether it follows the record to within its noise, and no term of it is in doubt."""
        return self.refinement is not None and self.refinement.clear

    @property
    def says_all(self) -> bool:
        """Whether what it leaves to noise of the process is white: what lacks in a law would show between blocks."""
        return self.refinement is not None and self.refinement.says_all

    @property
    def says_something(self) -> bool:
        """Whether what it leaves to noise of the process, if anything, is not all: such noise explains any record.

        Free runs stay with the record or, as those of chaos part from it under any law, little is left.
        """
        return self.exact or (self.follows and (self.free_run < LOST or self.left < MINOR))

    def likelier_than(self, other: Contender) -> bool:
        """Say whether it is for sure likelier than another that follows the record, noise of the process counted."""
        gained = None if self.refinement is None else self.refinement.gained_over(other.refinement)
        return gained is not None and gained > 0.0

    def score(self, chosen: bool) -> FormScore:
        """Return how it did."""
        misfit = self.misfit if np.isfinite(self.misfit) else None
        follows = None if self.refinement is None else self.follows
        return FormScore(self.form, self.coefficients, self.free_run, misfit, follows, chosen)


def contender_of(
    posed: Posed, model: Model, refinement: Refinement | None, others: Sequence[Refinement], signals: Signals
) -> Contender:
    """Return a form with how it does on free runs.

    Args:
        posed: the form.
        model: its model.
        refinement: what the likelihood led to; without it the model of the regression runs on the data of the others.
        others: what the likelihood led to in other forms.
        signals: what the models were found in.
    """
    energy = energy_of(model, signals)
    inertial = energy is None or energy.least_inertia is None or energy.least_inertia > 0.0
    loose = energy is not None and energy.loosest is not None and energy.loosest > LOOSE
    if refinement is not None:
        count = len(refinement.fit.free)
        error, left = refinement.free_run_error, left_by(refinement, signals)
        return Contender(posed.form, model, refinement, posed.left_out, count, error, inertial, loose, left)
    theta = posed.starts[0].coefficients if posed.proposal is None else posed.proposal
    spaces = [other.space.among(posed.mechanisms) for other in others[:1]]
    error = float(np.sqrt(free_run_error(spaces[0], theta))) if spaces else np.inf
    count = int(np.count_nonzero(theta)) - len(model.relations)
    return Contender(posed.form, model, None, posed.left_out, count, error, inertial, loose)


def best_of(contenders: Sequence[Contender]) -> Contender:
    """Return the one to keep: by likelihood among those that follow the record to its noise, else by free runs.

    A kinetic energy that is not positive counts only where nothing else follows the record so. Free runs that all leave
    the record, as those of what is balanced by a controller do, say nothing: likelihood with process noise decides.
    A kinetic energy of which a part is not told from nothing gives way to what says as much.
    """
    contenders = [c for c in contenders if not (c.loose and any(_says_as_much(o, c) for o in contenders))]
    exact = [c for c in contenders if c.exact and c.inertial] or [c for c in contenders if c.exact]
    likely = {c: c.refinement.outcome.deviance for c in exact if c.refinement is not None}
    blocks = {c.refinement.space.segments.block for c in exact if c.refinement is not None}
    if len(blocks) == 1:  # else averages of other numbers of samples, whose densities do not compare
        return min(likely, key=likely.__getitem__)
    able = exact or [c for c in contenders if c.follows] or list(contenders)
    if all(c.free_run >= LOST for c in able):
        able = [c for c in able if all(c is o or c.likelier_than(o) for o in able)] or able
    least = min(c.free_run for c in able)
    return min((c for c in able if c.free_run <= SPREAD * least), key=lambda c: (c.coefficients, c.free_run))


def _says_as_much(one: Contender, loose: Contender) -> bool:
    """Say whether a form runs as well as another of which a part is not told, with no more coefficients."""
    runs = one.follows and _runs_as_well(one, loose)
    return runs and not one.loose and one.coefficients <= loose.coefficients


def _runs_as_well(one: Contender, other: Contender) -> bool:
    """Say whether the free runs of a form are no further from what is held out than those of another, or hardly."""
    return one.free_run <= SPREAD * other.free_run


def leave_little(contenders: Sequence[Contender], asis: Sequence[Contender]) -> bool:
    """Say whether mechanisms follow the record and leave relations little to find.

    These then compete as regression has them, unless these already run better, or keep to the record with fewer
    coefficients, or, where it has none, mechanisms do not run well. Noise of the process carries free runs away from
    any law: where it is white, or takes up next to nothing, there is nothing left to find, too. A Lagrangian with
    negative inertia is none: forces that do no work, as of a magnet or a flywheel, are no mechanisms. Nor is one of
    which a part is not told from nothing: what is coupled one way alone, as a load that hangs from a driven trolley,
    has none. Nor is one that takes more coefficients to run as well as relations do, or as these may once the
    likelihood has them: it weighs equations as no energy does. A potential that may imitate a function, as gravity far
    out, leaves this to find where more is left.

    Args:
        contenders: the mechanisms.
        asis: the relations as regression has them, if it has some.
    """
    bar = min((a.free_run for a in asis), default=WELL)
    least = bar if asis and bar < WELL else np.inf  # what runs well, and better, needs no such noise
    return any(
        (c.clear and not any(a.coefficients < c.coefficients and _runs_as_well(a, c) for a in asis))
        or (not any(_takes_fewer(a, c) for a in asis) and _does_well(c, bar, least) and not _imitates(c))
        for c in contenders
        if c.inertial and not c.loose
    )


def _takes_fewer(one: Contender, other: Contender) -> bool:
    """Say whether a form keeps to the record with fewer coefficients, or may come to run as well as another."""
    return one.coefficients < other.coefficients and one.free_run < min(LOST, UNREFINED * other.free_run)


def _imitates(contender: Contender) -> bool:
    """Say whether a potential holds several powers of one coordinate."""
    found = contender.refinement
    if found is None:
        return False
    potential = [m for k in found.fit.present if (m := found.space.mechanisms[k]).kind == "potential"]
    powers = (part.relation for m in potential for part in m.parts if _is_power(part.product.term))
    return any(number >= SEVERAL for number in Counter(powers).values())


def _is_power(term: Term) -> bool:
    """Say whether a term is a power of one variable, or none of any."""
    return len(term.factors) <= 1 and all(isinstance(atom, Name) for atom, _ in term.factors)


def _does_well(contender: Contender, bar: float, least: float) -> bool:
    """Say whether a form leaves next to nothing to noise of the process, or little and runs freely as well as others.

    Args:
        contender: the form.
        bar: error of the free runs of others.
        least: the same, if they run well.
    """
    if contender.left < HARDLY:
        return True
    runs = contender.free_run <= (SPREAD * least if contender.says_all else bar)
    return contender.follows and (contender.exact or contender.left < LITTLE) and runs
