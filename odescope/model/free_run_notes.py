"""Sentences about free runs from the start of the recordings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf

from odescope.model.scores import FreeRun, Likelihood

JOINED = 0.01  # standard deviations of the states, that pieces of the model's trajectory differ by at their joints
MANY = 4  # coordinates whose fits are told one by one
GROWS = 30.0  # times that errors at the start have become until a run parts, from where on any law would part
TELLING = 10.0  # times: from here on whole numbers
FOLLOWS = "piece joined to piece the model follows the record to within its noise"
ADDS_UP = "what it leaves unexplained adds up"
KEPT = "in a machine that only its controller keeps from falling"
WHERE = f"in chaos, where a swing may turn over or not, and {KEPT}"
FEW_STEPS = "Predictions of a few steps judge it (odescope validate: many starts)"


def free_run_sentences(runs: Sequence[FreeRun]) -> Iterator[str]:
    """Yield how long the free runs of a model stay with its recordings, how well they fit, and which ended early."""
    if len(runs) == 1:
        (run,) = runs
        stays = f"{_length(run)}" if run.stays else f"{run.valid_time:.4g} of {run.duration:.4g} s"
        yield f"Run freely from its start, it stays with the recording for {stays}{_fits(runs)}."
    elif runs:
        yield f"Run freely from their starts, it stays with {_which(runs)}{_fits(runs)}."
    for run in runs:
        if run.ended:
            which = "The free run" if len(runs) == 1 else f"The free run over recording {run.recording}"
            yield f"{which} ended early: {run.ended}."


def parting_sentences(runs: Sequence[FreeRun], judged: Likelihood | None) -> Iterator[str]:
    """Yield why free runs of a model that follows its record part from it, or that nothing explains it.

    Where errors grow by themselves that says little against a law, whether its states then run away or not; that they
    run away where errors do not grow does say something. Model files from before errors were let grow say nothing of
    it.

    Args:
        runs: from the starts of the recordings.
        judged: how the likelihood judged the model, where it ran.
    """
    run = _parting(runs, judged)
    if run is None or judged is None:
        return
    where, then = (KEPT, " and then runs away") if run.ended else (WHERE, "")
    size = run.growth or 0.0
    grown = f" ({size:{',.0f' if size >= TELLING else '.2g'}} times until then)"
    if judged.process_noise:
        if run.growth is not None:
            more = f", and errors grow by themselves{grown}, as {where}" if run.growth >= GROWS else ""
            yield f"freely the model parts from the record after {run.valid_time:.2g} s{then}: {ADDS_UP}{more}"
        return
    parts = f"{FOLLOWS}; freely it parts from it after {run.valid_time:.2g} s{then}"
    if run.growth is None:
        yield f"{parts}. {FEW_STEPS}"
    elif run.growth >= GROWS:
        yield f"{parts}, as any law does where errors grow by themselves{grown}: {where}. {FEW_STEPS}"
    else:
        yield f"{parts}, although errors do not grow by themselves in it{grown}: that speaks against it"


def unexplained_parting(runs: Sequence[FreeRun], judged: Likelihood | None) -> tuple[str, ...]:
    """Return those of the sentences that speak against a model.

    Args:
        runs: from the starts of the recordings.
        judged: how the likelihood judged the model, where it ran.
    """
    run = _parting(runs, judged)
    explained = run is None or run.growth is None or run.growth >= GROWS
    return () if explained or judged is None or judged.process_noise else tuple(parting_sentences(runs, judged))


def grows_by_itself(runs: Sequence[FreeRun], judged: Likelihood | None) -> bool:
    """Say whether free runs part from a record that the model follows, and errors that grow by themselves explain it.

    Args:
        runs: from the starts of the recordings.
        judged: how the likelihood judged the model, where it ran.
    """
    run = _parting(runs, judged)
    return run is not None and run.growth is not None and run.growth >= GROWS


def _parting(runs: Sequence[FreeRun], judged: Likelihood | None) -> FreeRun | None:
    """Return the free run that is told of those that part from a record which the model follows; None for none.

    Where runs ended early it is the one of these whose errors grow most, and none where they do not. Else it is the one
    whose errors grow least, where that does not explain it, else the one that parts first.
    """
    lost = [run for run in runs if not run.stays]
    if not lost or judged is None or not judged.follows or judged.truncated:
        return None
    if not judged.process_noise and (judged.gap is None or judged.gap > JOINED):
        return None
    if ended := [run for run in runs if run.ended]:
        most = max(ended, key=lambda run: run.growth or 0.0)
        return most if (most.growth or 0.0) >= GROWS else None
    least = min(lost, key=lambda run: inf if run.growth is None else run.growth)
    if least.growth is not None and least.growth < GROWS:
        return least
    return min(lost, key=lambda run: run.valid_time)


def _length(run: FreeRun) -> str:
    if run.recorded is None:
        return f"all of its {run.duration:.4g} s"
    return f"all of the first {run.duration:.4g} s, which were tried, of {run.recorded:.4g} s"


def _which(runs: Sequence[FreeRun]) -> str:
    tried = "" if runs[-1].recording == len(runs) else f" that were tried, of {runs[-1].recording},"
    lost = [run for run in runs if not run.stays]
    if not lost:
        return f"all {len(runs)} recordings{tried} to their ends"
    first = min(lost, key=lambda run: run.valid_time / run.duration)
    parted = f"{first.valid_time:.4g} of {first.duration:.4g} s of recording {first.recording}"
    if len(lost) == len(runs):
        return f"none of the {len(runs)} recordings{tried} to its end; it parts soonest after {parted}"
    rest = "the other" if len(lost) == 1 else "the others soonest"
    return (
        f"{len(runs) - len(lost)} of {len(runs)} recordings{tried} to their ends and parts from {rest} after {parted}"
    )


def _fits(runs: Sequence[FreeRun]) -> str:
    """Return the range of the fits of every coordinate over the recordings, where free runs stay with them."""
    if not all(run.stays for run in runs):
        return ""
    told = []
    for name in runs[0].coordinates:
        known = [run.coordinates[name].fit for run in runs if name in run.coordinates]
        fits = [fit for fit in known if fit is not None]
        if fits:
            low, high = (_percent(end) for end in (min(fits), max(fits)))
            told.append(f"{name} {low}" if low == high else f"{name} {low} to {high}")
    few = told[:MANY] + (["..."] if len(told) > MANY else [])
    return f" (fit of {', '.join(few)})" if told else ""


def _percent(fit: float) -> str:
    """Return a fit as a percentage that is not rounded up to the whole."""
    return "over 99.9 %" if 99.9 < fit < 100.0 else f"{fit:.3g} %"
