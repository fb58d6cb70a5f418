"""What the likelihood stage has to say, as plain data and as sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.expression import Term
from odescope.likelihood.evidence import between, in_blocks
from odescope.likelihood.process_noise import Noisy
from odescope.likelihood.refine import Refinement
from odescope.likelihood.search import MOST_TERMS, THIN
from odescope.model.model import Json

CORRELATED = 0.5  # least correlation of two estimates that is listed
CLEAR = 0.1  # least correlation of what is missing with its cause that is worth a word
SURE = 12.0  # least squared ratio of that correlation to its spread between blocks of the record


def likelihood_scores(refinement: Refinement, targets: Sequence[str]) -> dict[str, Json]:
    """Return how the stage went: noise, trail of the search, intervals, correlations, limits of detection.

    `limits` are the coefficients from which on an absent term would probably have been found at this noise; null where
    these data cannot tell it from the terms that are there.
    """
    outcome, process, searcher = refinement.outcome, refinement.process, refinement.searcher
    lacking = process if refinement.follows else refinement.rejected
    trail: list[Json] = [
        {
            "gap": m.width if process is None and np.isfinite(m.width) else None,
            "action": m.action,
            "target": targets[m.part.relation],
            "term": m.part.product.text,
            "statistic": m.statistic,
            "price": m.penalty,
        }
        for m in (outcome.trail if process is None else process.trail)
    ]
    scores: dict[str, Json] = {
        "follows": refinement.follows,
        "residual_variance": outcome.scale,
        "gap": outcome.width if np.isfinite(outcome.width) else None,
        "finished": refinement.finished,
        "starts": refinement.starts,
        "process_noise": None,
        "trail": trail,
        "hints": [] if lacking is None else list[Json](missing_physics(lacking, targets)),
    }
    if process is not None:
        scores["process_noise"] = dict(zip(targets, process.unexplained.tolist(), strict=True))
        scores["held_out_free_run"] = process.held_out
    if refinement.evidence is None or not refinement.follows:
        return scores
    present = [searcher.parts[k] for k in refinement.fit.present]
    scores["intervals"] = [
        {"target": target, "term": t.text, "interval": list[Json](t.interval)}
        for target, relation in zip(targets, refinement.relations, strict=True)
        for t in relation.terms
        if t.interval is not None
    ]
    correlation = refinement.evidence.correlation
    scores["correlations"] = [
        {
            "first": f"{present[i].product.text} in {targets[present[i].relation]}",
            "second": f"{present[j].product.text} in {targets[present[j].relation]}",
            "correlation": float(correlation[i, j]),
        }
        for i, j in zip(*np.nonzero(np.abs(np.tril(correlation, -1)) > CORRELATED), strict=True)
    ]
    limits = refinement.evidence.limits
    absent = sorted(np.flatnonzero(limits), key=lambda k: float(searcher.penalty[k]))  # the simplest first
    scores["limits"] = [
        {
            "target": targets[searcher.parts[k].relation],
            "term": searcher.parts[k].product.text,
            "limit": float(limits[k]) if np.isfinite(limits[k]) else None,
        }
        for k in absent
    ]
    return scores


def likelihood_notes(refinement: Refinement, targets: Sequence[str]) -> list[str]:
    """Return what the user should know of the stage: what the model does not explain, and where evidence is thin."""
    outcome, process = refinement.outcome, refinement.process
    notes = []
    if refinement.late:
        notes.append("the search was ended by the clock, [likelihood] seconds: another run may end elsewhere")
    elif not refinement.finished:
        notes.append(
            "the search ended with its budget: allow it more, [likelihood] budget, for what it may have missed"
        )
    if len(refinement.fit.present) > MOST_TERMS * len(targets):
        notes.append(
            "the search stopped at its largest number of terms: the library lacks what would explain the record in few"
        )
    if not refinement.follows:
        notes.append(
            f"no standard errors: even in short segments the best model misses the record by {outcome.scale**0.5:.2g}"
            " times its noise, so coefficients are the regression's; look for missing physics, such as dry friction,"
            " a delay, or an input that was not recorded"
        )
        return notes
    if process is not None:
        sizes = ", ".join(f"{q:.2g} of {t}" for q, t in zip(process.unexplained, targets, strict=True))
        notes.append(
            f"the model leaves {sizes} unexplained (root mean square of averages over {process.window:.2g} s);"
            " standard errors allow for it"
        )
    if refinement.evidence is not None:
        weak = refinement.evidence.wald < THIN * refinement.searcher.penalty[refinement.fit.present]
        thin = [
            f"{refinement.searcher.parts[k].product.text} in {targets[refinement.searcher.parts[k].relation]}"
            f" ({np.sqrt(w):.1f} standard errors)"
            for k, w in zip(refinement.fit.present[weak], refinement.evidence.wald[weak], strict=True)
        ]
        if thin:
            notes.append(f"thin evidence, more data would decide: {', '.join(thin)}")
    return notes


def missing_physics(process: Noisy, targets: Sequence[str]) -> list[str]:
    """Return sentences about what the unexplained part of each target goes with.

    The gaps of the highest state of every coordinate are what its target lacks, summed over a segment. What goes with
    the sign of a velocity is dry friction; what goes with the rate of an input is a delay.
    """
    searcher, segments = process.searcher, process.searcher.segments
    names, following = searcher.frame.variables, searcher.frame.following
    program, kept = searcher.program(process.fit.present)
    none = np.zeros(0, dtype=np.int64)
    last = searcher.evaluator.integrate(program, process.fit.theta[kept], none, process.fit.x0).last
    joints = np.flatnonzero(segments.joined)
    begin = process.fit.x0[joints + 1]
    lacking = begin - last[joints]
    present = [searcher.parts[k].product.term for k in kept]
    velocities = [int(np.flatnonzero(following == j)[0]) for j in range(len(following)) if (following == j).any()]
    moving = [int(following[v]) for v in velocities if not _has_sign(present, names[following[v]])]
    rates = np.diff(segments.inputs[segments.start, 0], axis=0, append=0.0)[joints]
    causes = np.column_stack([*(np.sign(begin[:, j]) for j in moving), rates])
    sentences = []
    for i in np.flatnonzero(following < 0):
        target, shares = targets[-1 - following[i]], _goes_with(lacking[:, i], causes, begin)
        for j, share in zip(moving, shares, strict=False):
            if share is not None and share < 0.0:  # friction is against the motion
                sentences.append(
                    f"what is unexplained of {target} goes with the sign of {names[j]} (correlation {share:.2g}), as"
                    f" dry friction does: try sign({names[j]}) in the library's basis"
                )
        for name, share in zip(names[len(following) :], shares[len(moving) :], strict=True):
            if share is not None:
                sentences.append(
                    f"what is unexplained of {target} goes with the rate of {name} (correlation {share:.2g}), as with"
                    " a delay between what was recorded and what acted"
                )
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
