"""Sentences on how a model was chosen: the best columns, form and functions, what it does without, what is constant."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from odescope.library.readable import without_first_powers
from odescope.model.scores import (
    Conserved,
    Doubts,
    FormScore,
    ModelScores,
    Number,
    PathScore,
    SuspicionScore,
    VersionScore,
)
from odescope.recordings.coordinate import TIME

TOLD = 6  # notes of one kind
EXACT = 10.0  # standard errors: from here on whole numbers
SUSPECTED = {
    "powers": "{target} holds several powers of {variable}",
    "fractions": "{target} holds {variable} in a denominator",
    "driven": "by the model {variable} drives {target} somewhere, where dry friction brakes",
    "residual": "what is unexplained of {target} goes with {variable}",
    "measured": "{target} may hold a function of {variable}",
    "pair": "{target} may hold a function of two variables together",
    "sine": "{target} may hold sines of angles",
    "bend": "{target} may hold what begins to act at a limit",
    "angle": "{variable} may be an angle",
    "temperature": "{variable} is a temperature by its unit, or by name and size: rates may go with it by Arrhenius",
    "radiation": "{variable} is a temperature by its unit, or by name and size: what is hot radiates",
    "periodic": "what is unexplained of {target} goes at {low:.4g} to {high:.4g} rad/s, as under a forcing that was"
    " not recorded",
    "swinging": "what is unexplained of {target} goes with {variable} times a sine of {low:.4g} to {high:.4g} rad/s, as"
    " where a coefficient goes to and fro",
    "recurring": "what is unexplained of {target} repeats along {variable}, at {low:.4g} to {high:.4g} rad a unit"
    " of it, as the cogging of a motor does",
}
TURNING = (  # the same, of a turn in degrees
    "what is unexplained of {target} repeats along {variable} every 360 of it, as along an angle in degrees"
    ' (unit = "deg" in [coordinates.{variable}] says so)'
)
ONE_TURN = 2.0 * math.pi / 360.0  # rad a unit of such an angle
NARROW = 1.5  # times the least rate: of a wider range no single one is told
REPLACED = {  # what functions were found for, where it is in the model no more
    "powers": "{target} has {found} in place of several powers of {variable}",
    "fractions": "{target} has {found} in place of a fraction in {variable}",
    "measured": "{target} has {found}, found among functions of all variables",
    "pair": "{target} has {found}, found among functions of two variables together",
    "sine": "{target} has {found}, found among sines of angles",
    "bend": "{target} has {found}, found among what begins to act at a limit",
}
WAVES = ("periodic", "swinging", "recurring")  # reasons that ask for a sine of a rate of its own
UNCOUNTED = ("driven", "residual", *WAVES)  # reasons that no number of terms gives
JOINT = ("pair", "sine", "bend")  # reasons that are of no variable, and of too many functions to name
BY_FAR = 1000.0  # in -2 log-likelihood: how much more says nothing
ALIKE = 0.01  # of a sum: by less recordings do not differ in it
MANY = 3  # powers of one variable that are rarely a law; of a fraction a function with two constants says as much
FORMS = {"lagrangian": "Lagrange's equations", "relations": "relations", "reactions": "reactions"}


def findings(scores: ModelScores | None) -> tuple[str, ...]:
    """Return sentences on what was found beside the equations: the best form, what it did without, what is constant."""
    if scores is None:
        return ()
    return (
        *_of_the_versions(scores.versions),
        *_of_the_forms(scores.forms),
        *(_of_a_suspicion(s) for s in scores.suspicions if s.found or s.terms or s.reason in UNCOUNTED),
        *_of_the_path(scores.path),
        *_of_constants(scores.conserved),
    )


def unsettled(suspicions: Sequence[SuspicionScore]) -> Iterator[str]:
    """Yield those of the findings that leave a suspicion standing: the equations may imitate another function."""
    for found in suspicions:
        if _stands(found):
            yield _of_a_suspicion(found)


def imitating(suspicions: Sequence[SuspicionScore]) -> tuple[str, ...]:
    """Return the targets whose terms may imitate another function."""
    return tuple(dict.fromkeys(found.target for found in suspicions if found.terms and _stands(found)))


def of_single_terms(doubts: Doubts) -> Iterator[str]:
    """Yield the terms whose evidence is thin, and those that others could replace almost as well."""
    if doubts.thin:
        terms = ", ".join(f"{term} in {target} ({errors:.1f} standard errors)" for term, target, errors in doubts.thin)
        yield f"thin evidence, more data would decide: {terms}"
    if doubts.alike:
        terms = listed([f"{term} in {target} or {other}" for term, target, other in doubts.alike])
        yield f"look-alikes, between which the record decides by less than ten to one: {terms}"


def _stands(found: SuspicionScore) -> bool:
    """Say whether terms that are left may still imitate a function."""
    if found.reason == "fractions":
        return found.terms > MANY
    if found.found:
        return bool(found.terms)
    if not (found.terms or found.reason in UNCOUNTED):
        return False
    return not found.tried or found.terms >= MANY


def _of_the_forms(forms: Sequence[FormScore]) -> Iterator[str]:
    kept = [f for f in forms if f.chosen]
    others = [f for f in forms if not f.chosen]
    if not kept or not others:
        return
    first = kept[0]
    shown = (
        f"{FORMS.get(first.form, first.form)} ({first.coefficients} coefficients{_free_run(first, 'free-run error ')})"
    )
    yield f"{shown} were preferred to " + listed(
        [f"{FORMS.get(f.form, f.form)} ({f.coefficients}{_free_run(f, '')})" for f in others]
    )


def _of_the_versions(versions: Sequence[VersionScore]) -> Iterator[str]:
    for kept in (v for v in versions if v.chosen):
        read = listed([f"{name} from the column {column!r}" for name, column in kept.columns.items()])
        others = listed([_version(v) for v in versions if v is not kept])
        yield f"{read} was preferred{_free_run(kept.did, 'free-run error ')} to {others}"


def _version(of: VersionScore) -> str:
    how = "no model" if of.did is None else _free_run(of.did, "")[2:]
    return " and ".join(map(repr, of.columns.values())) + (f" ({how})" if how else "")


def _of_a_suspicion(found: SuspicionScore) -> str:
    """Return what competed with powers and fractions of a variable, and how, with a warning where these are left."""
    turning = found.low <= ONE_TURN <= found.high < NARROW * found.low and found.reason == "recurring"
    told = TURNING if turning else SUSPECTED[found.reason]
    what = told.format(variable=found.variable, target=found.target, low=found.low, high=found.high)
    if found.reason in WAVES:
        return f"{what}: {_forced(found)}"
    left = f"; {_held_within(found)}" if _stands(found) else ""
    if not found.tried:
        return f"{what}: functions of it could not be tried{left}"
    many, of_it = len(found.tried), "" if found.reason in JOINT else " of it"
    if found.found:
        gain = "" if found.gain is None else f", which lowers -2 log-likelihood + penalty by {found.gain:,.0f}"
        tried = f" ({many} functions competed)" if of_it and many > 1 else ""
        said = REPLACED.get(found.reason, f"{what}: {{found}} instead")
        functions = listed([without_first_powers(text) for text in found.found])
        said = said.format(target=found.target, found=functions, variable=found.variable)
        return f"{said}{gain}{tried}{left}"
    tried = f"{many} functions{of_it} were tried" if many > 1 else f"{found.tried[0]} was tried"
    return f"{what}: {tried}, {_no_better(found.gain, many)}{left}"


def _no_better(gain: Number, many: int) -> str:
    """Return how functions did of which none is in the model, the best of them with such a gain at first."""
    if gain == -math.inf:
        return "with none of them can the record be followed"
    lost = f"{'none is' if many > 1 else 'it is not'} better{' in the end' if gain and gain > 0.0 else ''}"
    off = 0.0 if gain is None else -gain
    told = f"raises -2 log-likelihood + penalty by {off:,.0f}" if off < BY_FAR else "is worse by far"
    by = f", the best {told}" if off >= 1.0 else ""
    return f"{lost} than the model's own terms{by}"


def _forced(found: SuspicionScore) -> str:
    if not found.tried:
        return (
            f"sines of the time are tried where [data] time names a column of numbers, in seconds, and nothing else is"
            f" called {TIME} or rate_{TIME}"
        )
    return f"{listed(found.found)} instead" if found.found else f"{listed(found.tried)} were tried and are no better"


def _held_within(found: SuspicionScore) -> str:
    return (
        "if these terms imitate another function, the equations hold no further than the record went,"
        f" {found.variable} = {found.low:.3g} to {found.high:.3g}"
    )


def _free_run(form: FormScore | None, what: str) -> str:
    return "" if form is None or form.free_run is None else f", {what}{form.free_run:.2g}"


def _of_the_path(path: Sequence[PathScore]) -> Iterator[str]:
    """Yield what the choice on the path does without, the strongest evidence first; nothing where it is the first."""
    chosen = next((k for k, step in enumerate(path) if step.chosen), 0)
    dropped = [step for step in path[1 : chosen + 1] if step.dropped is not None]
    if not dropped:
        return
    dropped.sort(key=lambda step: -(step.statistic or 0.0))
    told = some([f"{step.dropped}{_evidence(step)}" for step in dropped])
    first, last = path[0], path[chosen]
    errors = (
        "" if first.error is None or last.error is None else f"{first.error:.2g} with them, {last.error:.2g} without"
    )
    yield (
        f"left out on the way back from {first.terms} terms to {last.terms}"
        f"{errors and f', free-run error {errors}'}: {listed(told)}; [likelihood] terms = {first.terms} keeps them"
    )


def _evidence(step: PathScore) -> str:
    if step.standard_errors is None:
        return ""
    digits = ".0f" if step.standard_errors >= EXACT else ".2g"
    return f" ({step.standard_errors:{digits}} standard errors)"


def _of_constants(sums: Sequence[Conserved]) -> Iterator[str]:
    """Yield a sentence a sum that stays constant in the data, and what that leaves open."""
    alike = list[str]()
    for found in sums:
        if not found.values:
            continue
        told = [f"{value:.3g}" for value in found.values[:TOLD] if value is not None]
        more = ", ..." if len(found.values) > TOLD else ""
        many = f"recordings 1 to {len(found.values)}" if len(found.values) > 1 else "recording 1"
        reason = ", as these reactions have it" if found.by_model else ""
        yield f"{found.sum} stays constant at {', '.join(told)}{more} in {many}{reason}"
        known = [value for value in found.values if value is not None]
        if not found.by_model and max(known) - min(known) <= ALIKE * max(map(abs, known)):
            alike.append(found.sum)
    if alike:
        has = "has" if len(alike) == 1 else "have"
        yield (
            f"while {listed(alike)} {has} one value, several laws say the same, of which the shortest is given: a"
            " recording with another value tells them apart"
        )


def some(items: Sequence[str], most: int = TOLD) -> list[str]:
    """Return the first items, at most so many, and how many more there are."""
    return [*items[:most], *([f"{len(items) - most} more"] if len(items) > most else [])]


def listed(items: Sequence[str]) -> str:
    """Return items as a sentence lists them."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"
