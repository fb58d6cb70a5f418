"""Sentences about a model: how far to trust it, and what its user should know.

They are worded here, below all who say them: a model in a notebook, the likelihood stage, a result and its report.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf, log

from odescope.model.choice_notes import findings, listed, of_single_terms, unsettled
from odescope.model.free_run_notes import free_run_sentences, parting_sentences, unexplained_parting
from odescope.model.gated_notes import gated_sentence
from odescope.model.left_out_notes import left_out_sentences
from odescope.model.scores import (
    Conserved,
    Doubts,
    EnergyScore,
    Likelihood,
    ModelScores,
)
from odescope.model.time_score import TimeScore
from odescope.model.worth import FLOWS, NEXT_TO_NOTHING, ONE_OF_TWO, much, share
from odescope.recordings.gaps import SHORTEST_RUN

UNSIGNED = 1e-3  # of the largest power dissipated: less is what errors of the coefficients make
IMBALANCE = 0.1  # of the energy turned over: less is what noise of the velocities makes
LOOSE = 1.0  # standard error over coefficient of a kinetic term that another Lagrangian could do without
LITTLE = 0.02  # of it: less is told, and no reason to doubt a law
BRIDGED = 0.01  # of the standard deviation of an input, that lines over its gaps are off by elsewhere
READ_BADLY = 0.01  # of a sample period: jitter of a clock worth telling
TEN_TO_ONE = log(10.0)  # log-likelihood: by less a record hardly decides
TELLING = 5.0  # log-likelihood: smooth inputs that gain less by being band-limited are as good as linear


def trust(scores: ModelScores | None) -> tuple[str, ...]:
    """Return sentences on how far to trust a model, from the scores it was identified with; none where it has none."""
    return () if scores is None else tuple(_trust(scores))


def _trust(scores: ModelScores) -> Iterator[str]:
    predicted = [(t, s.telling_r2) for t, s in scores.targets.items() if s.telling_r2 is not None]
    if predicted:
        parts = [f"{share(r2)} of the variance of {target}" for target, r2 in predicted]
        yield f"On held-out data it predicts {listed(parts)} (R²)."
    for step in scores.path:
        if step.chosen and step.error is not None:
            apart = "" if not step.spread else f" ({step.spread:.2g} from stretch to stretch)"
            off = f"is {step.error:.2g} standard deviations of the record off{apart}"
            yield (
                "Fitted without the held-out stretches and run freely over them, it"
                f" {'loses the record' if step.lost else off}."
            )
    yield from free_run_sentences(scores.free_runs)
    if poles := _poles(scores):
        yield f"Expect poles in {listed(poles)}."
    elif any(s.denominator is not None for s in scores.targets.values()):
        yield "No denominator vanishes between the states of the data."
    judged = scores.likelihood
    if judged is None:
        if scores.targets:
            yield "Its coefficients come from regression alone, so they have no standard errors."
    elif judged.exact and judged.residual_variance is not None:
        ratio = judged.residual_variance
        yield f"It follows the record to within its noise: residual variance {ratio:.3f} times that of the noise."


def notes_of(
    scores: ModelScores | None, dependent: Sequence[tuple[str, Sequence[str]]], doubts: Doubts | None
) -> tuple[str, ...]:
    """Return what the user of a result should know, each sentence once.

    Args:
        scores: those of the model; a draft has none.
        dependent: every candidate that was left out of a library, with those it is a combination of.
        doubts: those of the likelihood stage, where it ran.
    """
    constant = () if scores is None else tuple(c.sum for c in scores.conserved if c.values)
    said = [*left_out_sentences(dependent, constant)]
    if scores is not None:
        said += [*findings(scores), *parting_sentences(scores.free_runs, scores.likelihood)]
        said += [*warnings_of(scores, doubts), *_of_the_data(scores)]
        if scores.likelihood is not None and doubts is not None:
            said += [*_not_looked_at(scores.likelihood), *_unexplained(scores.likelihood, doubts, True)]
            said += [*_of_the_budget(scores.likelihood, doubts, True)]
    return tuple(dict.fromkeys(said))


def warnings_of(scores: ModelScores | None, doubts: Doubts | None) -> tuple[str, ...]:
    """Return those of the notes that say what may be wrong with a model; all others say what was found and done."""
    if scores is None:
        return ()
    said = [*unsettled(scores.suspicions), *unexplained_parting(scores.free_runs, scores.likelihood)]
    said += [*_lost(scores), *_unlikely(scores.conserved)]
    if scores.energy is not None:
        said += [*_of_the_energy(scores.energy)]
    if scores.likelihood is not None and doubts is not None:
        said += [*_of_the_likelihood(scores.likelihood, doubts), *scores.likelihood.hints]
    return tuple(dict.fromkeys(said))


def _lost(scores: ModelScores) -> Iterator[str]:
    """Yield where the model is not to be run, and what of the data it has not seen."""
    for target in _poles(scores):
        yield f"the denominator of {target} vanishes between the states of the data: expect poles when simulating"
    for name, (longest, off) in {} if scores.time is None else scores.time.bridged.items():
        if off > BRIDGED:
            lost = "single samples" if longest == 1 else f"up to {longest} samples in a row"
            yield (
                f"{name} lacks {lost}, over which a straight line is off by {share(off)} of"
                " its standard deviation elsewhere: what it did in such gaps biases coefficients, of which standard"
                ' errors know nothing; gaps = "split" in [data], or --gaps split, does without them'
            )
    if scores.left_out:
        one = scores.left_out == 1
        which, were = ("1 recording is", "was") if one else (f"{scores.left_out} recordings are", "were")
        yield f"{which} shorter than a period of the cutoff and {were} left out"


def _of_the_data(scores: ModelScores) -> Iterator[str]:
    """Yield what was found out about the record, and allowed for."""
    if scores.time is not None:
        yield from _of_time(scores.time)
    if (read := scores.streamed) is not None:
        yield (
            f"{read.rows:,} rows were read in {read.portions} chunks: all of them count in the regression;"
            f" cutoffs, ranking, likelihood and report rest on {read.sampled} of the chunks"
        )
    for name, sensor in scores.offsets.items():
        error = "" if sensor.std_error is None else f" +- {sensor.std_error:.1g}"
        yield f"the sensor of {name} reads {sensor.offset:.4g}{error} more than {name} in the equations"
    for name, found in scores.delays.items():
        if found.delay:
            error = "" if found.std_error is None else f" (standard error {found.std_error:.2g} s)"
            when = "after" if found.delay > 0.0 else "before"
            held = name in scores.holds and scores.holds[name].hold == "zero"
            why = ", as what steps between two samples does" if found.delay < 0.0 and held else ""
            yield f"{name} acts {abs(found.delay):.4g} s {when} it was recorded{error}{why}"
    for name, between in scores.holds.items():
        acts = _acting(between.hold)
        if between.other is not None:
            yield (
                f"{name} is {acts} between samples, or {_acting(between.other)}: the record does not decide, so"
                f" standard errors allow for both (where you know, set hold in [inputs.{name}])"
            )
            continue
        if between.hold == "band-limited" and between.gain is not None and between.gain < TELLING:
            continue
        steps = (
            f"; {between.steps} of its steps fall between two samples, at times that were found"
            if between.steps
            else ""
        )
        yield f"{name} is {acts} between samples{_over_linear(between.gain)}{steps}"
    for name, count in scores.outliers.items():
        if count and name in scores.gated:
            yield gated_sentence(name, scores.gated[name])
        elif count:
            yield f"{count} samples of {name} are far from the filtered signal: they were clipped"


def _acting(hold: str) -> str:
    """Return in a word how an input runs between its samples."""
    return "held" if hold == "zero" else hold


def _over_linear(gain: float | None) -> str:
    """Return what a hold gains in log-likelihood; lines through its samples may gain as much by acting later."""
    if gain is None:
        return ""
    if gain < 1.0:
        return ", or runs linearly and acts half a sample later: the record does not decide"
    hardly = ", by which the record hardly decides" if gain < TEN_TO_ONE else ""
    return f": {gain:,.{1 if hardly else 0}f} in log-likelihood over linear{hardly}"


def _of_time(found: TimeScore) -> Iterator[str]:
    """Yield what was wrong with the time stamps, in words that say what was done."""
    if found.disordered:
        yield f"{found.disordered} of {found.rows} rows were out of order: sorted"
    if found.doubled:
        yield f"{found.doubled} of {found.rows} rows had the time of another: merged, different values averaged"
    if found.coarse:
        yield f"the clock ticked every {found.coarse:.4g} s, while several rows came: they count as taken at even times"
    if found.jitter > READ_BADLY:
        yield (
            f"the clock was read with a jitter of {100.0 * found.jitter:.2g} % of a sample period: samples count as"
            " taken at regular times"
        )
    if found.scatter > READ_BADLY and not found.uneven:
        yield (
            f"samples were taken off even times by {100.0 * found.scatter:.2g} % of a sample period (standard"
            " deviation): each counts at the nearest of these, moved there along a smooth curve"
        )
    if found.clocked:
        verb = "changes" if len(found.clocked) == 1 else "change"
        yield f"{listed(found.clocked)} {verb} at even times alone, whenever read: held from one of these to the next"
    if found.cut:
        why = 'to be split (gaps = "split" in [data])' if found.split else "too long to bridge"
        reasons = {why: found.cut - found.unseen, "in which what an input did is not known": found.unseen}
        at = [f"{'a gap' if count == 1 else f'{count} gaps'} {why}" for why, count in reasons.items() if count]
        yield f"recordings were cut at {' and at '.join(at)}"
    if found.short:
        one = found.short == 1
        yield (
            f"{found.short} {'row was' if one else 'rows were'} left out, beside gaps at which recordings are cut, in"
            f" pieces of fewer than {SHORTEST_RUN} samples"
        )
    yield from lost_samples(found)


def lost_samples(found: TimeScore) -> Iterator[str]:
    """Yield what was not measured, in words: a sentence where samples are at no even times, and one a coordinate."""
    if found.uneven:
        grid = f"{found.rows} rows count at the nearest of {found.samples} points of a grid"
        yield f"samples are not at even times: {grid}"
    for name, (lost, gaps) in found.lost.items():
        of = found.rows if found.uneven else found.samples
        where = "" if found.uneven else ", in a gap" if gaps == 1 else f", in {gaps} gaps"
        yield f"{lost} samples of {name}, of {of}, are missing ({share(lost / of)}){where}"


def _of_the_energy(found: EnergyScore) -> Iterator[str]:
    """Yield what is wrong with the energies of a Lagrangian; nothing where all is as it must be."""
    if found.least_inertia is not None and found.least_inertia <= 0.0:
        yield (
            "the kinetic energy is not positive everywhere in the data (smallest eigenvalue of the mass matrix"
            f" {found.least_inertia:.2g}): some mechanism is wrong or missing"
        )
    if found.least_dissipation is not None and found.least_dissipation < -UNSIGNED:
        yield (
            "the dissipation gives energy back at some states of the data (up to"
            f" {share(-found.least_dissipation)} of its largest power): no friction does that"
        )
    if found.imbalance is not None and found.imbalance > IMBALANCE:
        yield (
            f"{share(found.imbalance)} of the energy that was turned over is missing from the balance of what came in,"
            " what was dissipated and what was stored: look for a force or friction that is not in the library"
        )
    if found.loosest is not None and found.loosest > LOOSE:
        yield (
            "two Lagrangians fit this record: a term of the kinetic energy is not told from nothing"
            f" (its standard error is {found.loosest:.2g} times its coefficient); record it at another energy"
        )


def _unlikely(sums: Sequence[Conserved]) -> Iterator[str]:
    """Yield a sentence a sum on which the data and the reactions of the model do not agree."""
    for found in sums:
        if not found.values:
            moves = f"it moves: {FLOWS}" if found.drift else "it is not seen to be"
            yield f"these reactions would keep {found.sum} constant, but in the data {moves}"
        elif found.by_model is False:
            yield f"these reactions would change {found.sum}, which the data show constant"


def _of_the_likelihood(judged: Likelihood, doubts: Doubts) -> Iterator[str]:
    if doubts.late:
        yield "the search was ended by the clock, [likelihood] seconds: another run may end elsewhere"
    yield from _of_the_budget(judged, doubts, False)
    if doubts.crowded:
        yield (
            "the search stopped at its largest number of terms: the library lacks what would explain the record in few"
        )
    if not judged.follows:
        missed = "far more than" if judged.residual_variance is None else f"{judged.residual_variance**0.5:.2g} times"
        yield (
            f"no standard errors: even in short segments the best model misses the record by {missed} its noise, so"
            " coefficients are the regression's; look for what the library lacks, such as dry friction or a reaction,"
            f" for a delay, or for an input or a state that was not recorded: {ONE_OF_TWO}"
        )
        return
    yield from _unexplained(judged, doubts, False)
    yield from of_single_terms(doubts)


def _of_the_budget(judged: Likelihood, doubts: Doubts, clear: bool) -> Iterator[str]:
    """Yield that the search ended with its budget, where the model is clear or, a warning, is not."""
    settled = judged.exact and not (doubts.thin or doubts.alike or doubts.crowded)
    if judged.finished or doubts.late or settled != clear:
        return
    more = "[likelihood] budget = 120 (60 by default, about half a minute of two cores)"
    if clear:
        yield (
            "the search ended with its budget, at a model that follows the record to within its noise and has no term"
            f" in doubt; {more} lets it go on"
        )
    else:
        yield f"the search ended with its budget: allow it more, {more}, for what it may have missed"


def _not_looked_at(judged: Likelihood) -> Iterator[str]:
    """Yield what of the record the likelihood did not look at, and why."""
    if judged.unknown:
        yield (
            f"{share(judged.unknown)} of the record does not count: inputs that act late, or early, were not recorded"
            " yet, or no more, when they acted there"
        )
    if judged.bursts:
        yield (
            f"{share(judged.bursts)} of the record is in bursts, too quick for a filter: the equations are those of the"
            " rest, and free runs say whether they lead through bursts"
        )


def _unexplained(judged: Likelihood, doubts: Doubts, little: bool) -> Iterator[str]:
    """Yield what a model leaves to noise of the process, where that is little of every target, or is not."""
    left = {t: q for t, q in (judged.process_noise or {}).items() if q is not None}
    shares = judged.unexplained or {}
    most = max((shares.get(t, inf) for t in left), default=0.0)
    if most < NEXT_TO_NOTHING or (most < LITTLE) != little:
        return
    sizes = ", ".join(_size(q, t, doubts.units.get(t, ""), shares.get(t)) for t, q in left.items())
    why = ""
    if parts := much(judged):
        order = f" ({ONE_OF_TWO})" if any(t.endswith("_dot") for t in parts) else ""
        why = (
            f"; so much of {listed(list(parts))} says that a state was not measured{order}, what drives it not"
            " recorded, or that it is an input itself, which belongs in [inputs]"
        )
    yield (
        f"the model leaves {sizes} unexplained (root mean square of averages over {doubts.window:.2g} s);"
        f" standard errors allow for it{why}"
    )


def _size(left: float, target: str, unit: str, part: float | None) -> str:
    """Return how much is left of a target, and how much of it that is.

    Args:
        left: root mean square of what is left.
        target: its name.
        unit: of it; "" where it is not known.
        part: of the root mean square of the target; None where that is not known.
    """
    of = "" if part is None else f" ({share(part)} of its root mean square)"
    return f"{left:.2g}{f' {unit}' if unit else ''} of {target}{of}"


def _poles(scores: ModelScores) -> list[str]:
    """Return the targets whose denominator vanishes between the states of the data."""
    return [t for t, s in scores.targets.items() if s.denominator is not None and s.denominator.vanishes]
