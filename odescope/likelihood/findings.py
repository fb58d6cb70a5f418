"""What the likelihood stage has to say of its model: scores, doubts, and what the unexplained part goes with."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from odescope.library.mechanism import Mechanism
from odescope.likelihood.evidence import Evidence
from odescope.likelihood.lacking import has_dry_friction, lacking
from odescope.likelihood.look_alikes import look_alikes
from odescope.likelihood.process_noise import Noisy
from odescope.likelihood.refinement import Refinement
from odescope.likelihood.search import MOST_TERMS, THIN
from odescope.model.scores import Correlation, Doubts, Interval, Likelihood, Limit, Number, Step
from odescope.signals.estimate import Signals

CORRELATED = 0.5  # least correlation of two estimates that is listed


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
        bursts=refinement.bursts,
        unknown=refinement.unknown,
    )
    if refinement.evidence is None or not refinement.follows:
        return scores
    return msgspec.structs.replace(
        scores,
        intervals=_intervals(refinement, targets),
        correlations=_correlations(refinement, refinement.evidence),
        limits=_limits(refinement, refinement.evidence),
    )


def unexplained_shares(refinement: Refinement, signals: Signals) -> dict[str, float]:
    """Return what noise of the process takes up of each target, as a share of its root mean square; empty without it.

    Args:
        refinement: whose model it is.
        signals: the targets as they were measured.
    """
    shares = dict[str, float]()
    if refinement.process is None:
        return shares
    for target, left in zip(signals.targets, refinement.process.unexplained.tolist(), strict=True):
        squares = np.concatenate([columns[signals.row(target)] ** 2 for columns in signals.columns])
        whole = float(np.sqrt(squares.mean()))
        if np.isfinite(left) and whole > 0.0:
            shares[target] = left / whole
    return shares


def left_by(refinement: Refinement, signals: Signals) -> float:
    """Return the share that noise of the process takes up, of the target of which that is most; infinite without it.

    Args:
        refinement: whose model it is.
        signals: the targets as they were measured.
    """
    return max(unexplained_shares(refinement, signals).values(), default=np.inf)


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
    pairs = look_alikes(space, refinement.outcome) if refinement.exact else []
    alike = [(k, space.mechanisms[j].term) for k, j in pairs]
    return Doubts(
        late=refinement.late,
        crowded=len(fit.free) > MOST_TERMS * len(targets),
        window=None if process is None else process.window,
        thin=tuple(thin),
        alike=tuple((space.mechanisms[k].term, space.mechanisms[k].place, other) for k, other in alike),
    )


def _fitted(refinement: Refinement) -> list[Mechanism]:
    """Return the mechanisms whose coefficients were fitted."""
    return [refinement.space.mechanisms[k] for k in refinement.fit.free]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def missing_physics(process: Noisy, targets: Sequence[str]) -> list[str]:
    """Return sentences about what the unexplained part of each target goes with."""
    space, sentences = process.space, list[str]()
    for m in lacking(space, process.fit):
        if m.friction:
            known = has_dry_friction(space.mechanisms, m.cause)
            sentences.append(_dry_friction_hint(targets[m.target], m.cause, m.correlation, known))
        else:
            sentences.append(_delay_hint(targets[m.target], m.cause, m.correlation))
    return sentences


def _dry_friction_hint(target: str, velocity: str, correlation: float, known: bool) -> str:
    """Return what to say where what is unexplained of a target goes with the sign of a velocity.

    Args:
        target: whose equation it is.
        velocity: a state.
        correlation: of the two, others taken out.
        known: whether the library has dry friction of that velocity.
    """
    told = "the library has it, and it is not worth a term" if known else f"try sign({velocity}) in the library's basis"
    return (
        f"what is unexplained of {target} goes with the sign of {velocity} (correlation {correlation:.2g}), as"
        f" dry friction does: {told}"
    )


def _delay_hint(target: str, name: str, correlation: float) -> str:
    """Return what to say where what is unexplained of a target goes with the rate of an input.

    Args:
        target: whose equation it is.
        name: of the input.
        correlation: of the two, others taken out.
    """
    return (
        f"what is unexplained of {target} goes with the rate of {name} (correlation {correlation:.2g}), as with a delay"
        " between what was recorded and what acted, or where that rate acts itself, which would be one more input"
    )
