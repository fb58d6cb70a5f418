"""Forms that compete for one record: relations, Lagrange's equations, reactions; each with candidates and starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.mechanism import Mechanism, candidates_of
from odescope.library.tape import evaluate, write_tape
from odescope.library.ties import tied
from odescope.model.assembled import coefficients_of
from odescope.model.model import Model
from odescope.model.relation import Relation
from odescope.pipeline.joint_models import Search, forward, plain, rival
from odescope.recordings.record import Record, Records
from odescope.regression.mechanisms import MechanismProblem, proposed
from odescope.regression.problem import Problem
from odescope.selection.ranking import Candidate
from odescope.signals.estimate import Signals, signals_like
from odescope.study.options import Form, LeftOut, Mechanisms, Study


@dataclass(frozen=True, eq=False)
class Posed:
    """A form: its candidates, those left out as combinations of others, and coefficients (k,) to begin from.

    `plain` are the coefficients of relations that hold their targets bare, where there are any. `rival` are those of
    relations that promise more than all `starts`, with other target terms. `regression` gives what regression on all
    relations together proposes, where that is not among the starts; it is asked for late, because it takes as long as a
    search.
    """

    form: Form
    mechanisms: tuple[Mechanism, ...]
    left_out: LeftOut
    starts: tuple[FloatArray, ...]
    plain: FloatArray | None = None
    rival: FloatArray | None = None
    regression: Callable[[], FloatArray | None] = lambda: None

    @cached_property
    def proposal(self) -> FloatArray | None:
        """What regression on all relations together proposes, computed once."""
        return self.regression()


def relations_form(
    study: Study,
    problems: Sequence[Problem],
    searches: Sequence[Search],
    proposals: Sequence[tuple[tuple[Candidate, ...], Model]],
) -> Posed:
    """Return the plain candidates of all targets, begun from what regression proposes and from a forward selection.

    Args:
        study: whose ties hold.
        problems: one a target.
        searches: one a target, where regression found something for all.
        proposals: of the regression, the best first; there may be none.
    """
    candidates = candidates_of([p.terms for p in problems], [p.target for p in problems])
    mechanisms = tied(candidates, study.library.ties, study.scope())
    starts: list[Sequence[Relation]] = [model.relations for _, model in proposals]
    starts.append([forward(p) for p in problems])
    rivals = [rival(p, s.ranked.candidates if s else ()) for p, s in zip_longest(problems, searches)]
    other = [r or begun for r, begun in zip(rivals, starts[0], strict=True)] if any(rivals) else None
    bare = None
    if proposals and not any(len(m.parts) > 1 for m in mechanisms):
        bare = [plain(s, c) for s, c in zip(searches, proposals[0][0], strict=True)]
    return Posed(
        "relations",
        mechanisms,
        (),
        tuple(coefficients_of(mechanisms, relations) for relations in starts),
        None if bare is None else coefficients_of(mechanisms, bare),
        None if other is None else coefficients_of(mechanisms, other),
    )


def mechanisms_form(study: Study, form: Form, library: Mechanisms, records: Records, signals: Signals) -> Posed:
    """Return Lagrange's equations or reactions, begun from little, or from what regression proposes.

    Args:
        study: how signals are filtered, and the seed.
        form: which of the two.
        library: the candidates, and those left out.
        records: what the signals were found in.
        signals: noise, cutoffs and values.
    """
    mechanisms, left_out = library

    def regression() -> FloatArray | None:
        rng = np.random.default_rng(study.random.seed)
        noise = {c.name: c.noise for c in signals.channels}
        twice = Records(tuple(_with_noise(run, noise, rng) for run in records))
        noisy = signals_like(signals, twice.stretches, study.signals.differentiator, study.signals.margin)
        return proposed(MechanismProblem.of(signals, mechanisms), noisy)

    return Posed(form, mechanisms, left_out, (_little(mechanisms, signals),), regression=regression)


def _with_noise(run: Record, noise: dict[str, float], rng: np.random.Generator) -> Record:
    """Return a record with as much noise once more."""
    size = np.array([noise.get(name, 0.0) for name in run.names])
    return replace(run, values=run.values + size * rng.standard_normal(run.values.shape))


def _little(mechanisms: Sequence[Mechanism], signals: Signals) -> FloatArray:
    """Return what is known, the simplest kinetic term of every coordinate at 1, and forces of the size they seem."""
    theta, joined = np.zeros(len(mechanisms)), signals.joined()
    inertia = np.zeros(len(signals.targets))
    for r, target in enumerate(signals.targets):
        own = [
            (m.size, m.term != f"{signals.coordinates[r].derivative(1)}**2", k, p.share)
            for k, m in enumerate(mechanisms)
            for p in m.parts
            if m.kind == "kinetic" and p.relation == r and p.product.factor == target
        ]
        if own:
            _, _, k, inertia[r] = min(own)
            theta[k] = 1.0
    for k, m in enumerate(mechanisms):
        first = m.parts[0]
        if m.known is not None:
            theta[k] = m.known
        elif m.kind == "force" and first.product.term.names <= {i.name for i in signals.inputs}:
            y = joined[signals.row(signals.targets[first.relation])]
            u = evaluate(write_tape(signals.names, [first.product.term]), joined)[0]
            theta[k] = inertia[first.relation] * float(y @ u) / max(float(u @ u), 1e-300) / -first.share
    return theta
