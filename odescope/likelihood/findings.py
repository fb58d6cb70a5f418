"""What the likelihood stage has to say of its model: scores, doubts, and what the unexplained part goes with."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from odescope.arrays import FloatArray
from odescope.library.expression import Term
from odescope.library.mechanism import Mechanism
from odescope.likelihood.evidence import Evidence, between, in_blocks
from odescope.likelihood.process_noise import Noisy
from odescope.likelihood.refine import Refinement
from odescope.likelihood.search import MOST_TERMS, THIN
from odescope.model.notes import delay_hint, dry_friction_hint
from odescope.model.scores import Correlation, Doubts, Interval, Likelihood, Limit, Number, Step

CORRELATED = 0.5  # least correlation of two estimates that is listed
CLEAR = 0.1  # least correlation of what is missing with its cause that is worth a word
SURE = 12.0  # least squared ratio of that correlation to its spread between blocks of the record


def likelihood_scores(refinement: Refinement, targets: Sequence[str]) -> Likelihood:
    """Return how the stage went: noise, trail of the search, and what the evidence says where errors are stated."""
    outcome, process = refinement.outcome, refinement.process
    lacking = process if refinement.follows else refinement.rejected
    scores = Likelihood(
        follows=refinement.follows,
        residual_variance=float(refinement.scale),
        gap=_finite(outcome.width),
        finished=refinement.finished,
        starts=refinement.starts,
        process_noise=None
        if process is None
        else dict[str, Number](zip(targets, process.unexplained.tolist(), strict=True)),
        trail=_trail(refinement),
        hints=() if lacking is None else tuple(missing_physics(lacking, targets)),
        held_out_free_run=None if process is None else float(process.held_out),
        truncated=refinement.truncated,
    )
    if refinement.evidence is None or not refinement.follows:
        return scores
    return msgspec.structs.replace(
        scores,
        intervals=_intervals(refinement, targets),
        correlations=_correlations(refinement, refinement.evidence),
        limits=_limits(refinement, refinement.evidence),
    )


def _trail(refinement: Refinement) -> tuple[Step, ...]:
    process = refinement.process
    return tuple(
        Step(
            gap=_finite(m.width) if process is None else None,
            action=m.action,
            target=m.mechanism.place,
            term=m.mechanism.term,
            statistic=float(m.statistic),
            price=float(m.penalty),
        )
        for m in (refinement.outcome.trail if process is None else process.trail)
    )


def _intervals(refinement: Refinement, targets: Sequence[str]) -> tuple[Interval, ...]:
    return tuple(
        Interval(target=target, term=t.text, interval=t.interval)
        for target, relation in zip(targets, refinement.relations, strict=True)
        for t in relation.terms
        if t.interval is not None
    )


def _correlations(refinement: Refinement, evidence: Evidence) -> tuple[Correlation, ...]:
    names = [str(m) for m in _fitted(refinement)]
    return tuple(
        Correlation(first=names[i], second=names[j], correlation=float(evidence.correlation[i, j]))
        for i, j in zip(*np.nonzero(np.abs(np.tril(evidence.correlation, -1)) > CORRELATED), strict=True)
    )


def _limits(refinement: Refinement, evidence: Evidence) -> tuple[Limit, ...]:
    """Return the limit of every absent mechanism, the simplest first."""
    mechanisms, penalty = refinement.space.mechanisms, refinement.space.penalty
    limits = evidence.limits * refinement.space.sizes(refinement.fit.theta)
    asked = [k for k in np.flatnonzero(evidence.limits) if mechanisms[k].parts]
    absent = sorted(asked, key=lambda k: float(penalty[k]))
    return tuple(
        Limit(
            target=mechanisms[k].place,
            term=mechanisms[k].term,
            limit=_finite(limits[k]),
        )
        for k in absent
    )


def doubts(refinement: Refinement, targets: Sequence[str]) -> Doubts:
    """Return what the stage knows against its model: where evidence is thin, and what a search may have missed."""
    process, space, fit = refinement.process, refinement.space, refinement.fit
    thin = list[tuple[str, str, float]]()
    if refinement.follows and refinement.evidence is not None:
        sure = space.sureness_of(fit, refinement.covariance)
        thin = [
            (space.mechanisms[k].term, space.mechanisms[k].place, errors)
            for k, errors in zip(fit.present.tolist(), sure, strict=True)
            if errors is not None and errors**2 < THIN * space.penalty[k]
        ]
    return Doubts(
        late=refinement.late,
        crowded=len(fit.free) > MOST_TERMS * len(targets),
        window=None if process is None else process.window,
        thin=tuple(thin),
    )


def _fitted(refinement: Refinement) -> list[Mechanism]:
    """Return the mechanisms whose coefficients were fitted."""
    return [refinement.space.mechanisms[k] for k in refinement.fit.free]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def missing_physics(process: Noisy, targets: Sequence[str]) -> list[str]:
    """Return sentences about what the unexplained part of each target goes with.

    The gaps of the highest state of every coordinate are what its target lacks, summed over a segment. What goes with
    the sign of a velocity is dry friction; what goes with the rate of an input is a delay.
    """
    space, segments = process.space, process.space.segments
    names, following = space.frame.variables, space.frame.following
    present, none = process.fit.present, np.zeros(0, dtype=np.int64)
    program = space.program(present)
    last = space.evaluator.integrate(program, process.fit.theta[present], none, process.fit.x0).last
    joints = np.flatnonzero(segments.joined)
    begin = process.fit.x0[joints + 1]
    lacking = begin - last[joints]
    terms = [p.product.term for k in present for p in space.mechanisms[k].parts]
    velocities = [int(np.flatnonzero(following == j)[0]) for j in range(len(following)) if (following == j).any()]
    moving = [int(following[v]) for v in velocities if not _has_sign(terms, names[following[v]])]
    rates = np.diff(segments.inputs[segments.start, 0], axis=0, append=0.0)[joints]
    causes = np.column_stack([*(np.sign(begin[:, j]) for j in moving), rates])
    sentences = []
    for i in np.flatnonzero(following < 0):
        target, shares = targets[-1 - following[i]], _goes_with(lacking[:, i], causes, begin)
        for j, share in zip(moving, shares, strict=False):
            if share is not None and share < 0.0:  # friction is against the motion
                sentences.append(dry_friction_hint(target, names[j], share))
        for name, share in zip(names[len(following) :], shares[len(moving) :], strict=True):
            if share is not None:
                sentences.append(delay_hint(target, name, share))
    return sentences


def _goes_with(lacking: FloatArray, causes: FloatArray, states: FloatArray) -> list[float | None]:
    """Return the correlation with each cause, the others and the states taken out, where it is clear between blocks."""
    shares: list[float | None] = []
    for k in range(causes.shape[1]):
        others = np.column_stack([np.ones(len(causes)), states, np.delete(causes, k, axis=1)])
        both = np.column_stack([lacking, causes[:, k]])
        rest = both - others @ np.linalg.lstsq(others, both, rcond=None)[0]
        scale = float(np.sqrt(np.prod(np.sum(rest**2, axis=0))))
        if not scale > 0.0:
            shares.append(None)
            continue
        blocks = in_blocks(rest[:, :1] * rest[:, 1:] / scale)
        share = float(blocks.sum())
        sure = len(blocks) > 1 and share**2 > SURE * float(between(blocks)[0])
        shares.append(share if sure and abs(share) > CLEAR else None)
    return shares


def _has_sign(terms: list[Term], velocity: str) -> bool:
    """Say whether some term changes sign with the velocity alone, abruptly or smoothly."""
    return any(velocity in t.names and any(f in t.text for f in ("sign(", "tanh(")) for t in terms)
