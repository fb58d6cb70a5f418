"""What a model must not be used for, in sentences: where there were no data, how far ahead, which terms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import isfinite, tau

from odescope.library.readable import displayed
from odescope.model.model import Model
from odescope.model.scores import FreeRun
from odescope.model.worth import uncertain

TOLD = 8  # ranges or terms
DOUBTFUL = 1.0 / 3.0  # standard error over coefficient: from here on a term may as well be absent, or twice as large


def cautions(model: Model, units: Mapping[str, str]) -> tuple[str, ...]:
    """Return sentences on the limits of a model's use, from what it was identified with.

    Args:
        model: as it was identified.
        units: of states and inputs, as far as they are known.
    """
    return tuple(_cautions(model, units))


def _cautions(model: Model, units: Mapping[str, str]) -> Iterator[str]:
    if model.scores is not None:
        if said := uncertain(model.scores):
            yield f"{said[0].upper()}{said[1:]}."
        yield from _horizon(model.scores.free_runs)
    ranges = list(_ranges(model, units))
    if ranges:
        yield f"It extrapolates, and nothing here says how well, wherever it leaves the data: {_few(ranges)}."
    yield from _terms(model)


def _horizon(runs: Sequence[FreeRun]) -> Iterator[str]:
    lost = [run.valid_time for run in runs if not run.stays]
    if lost:
        yield (
            f"It must not predict further ahead than some {min(lost):.2g} s without a new measurement: after that a"
            " free run parts from what was recorded."
        )


def _ranges(model: Model, units: Mapping[str, str]) -> Iterator[str]:
    """Yield the range of every state and input that the equations may hold, and that was not anywhere."""
    free = {c.name for c in model.coordinates if c.cyclic}
    angles = {c.name for c in model.coordinates if c.angle}
    for name, (low, high) in model.domain.items():
        if name in free or (name in angles and high - low >= tau) or not isfinite(high - low):
            continue
        unit = units.get(name, "")
        numbers = f"{low:.3g} to {high:.3g}".replace("-", "−")
        yield f"{name} from {numbers}{f' {unit}' if unit else ''}"


def _terms(model: Model) -> Iterator[str]:
    if model.mechanisms:
        found = [(m.name, m.coefficient, m.std_error) for m in model.shown_mechanisms]
    else:
        pairs = zip(model.targets, model.shown_relations, strict=True)
        found = [
            (f"{displayed(t.product.expanded)} in {target}", t.coefficient, t.std_error)
            for target, r in pairs
            for t in r.terms
        ]
    sizes = [(error / abs(value), name) for name, value, error in found if error is not None and value]
    doubtful = sorted(pair for pair in sizes if pair[0] >= DOUBTFUL)
    if doubtful:
        told = _few([f"{name} (± {100.0 * part:.2g} %)" for part, name in doubtful])
        yield f"Nothing should be concluded from terms whose error is no small part of them: {told}."
    elif sizes:
        part, name = max(sizes)
        yield f"The least certain coefficient is that of {name}: ± {100.0 * part:.2g} %."
    else:
        yield "How far single coefficients are off is not known: none has a standard error."


def _few(told: Sequence[str]) -> str:
    return ", ".join((*told[:TOLD], *([f"and {len(told) - TOLD} more"] if len(told) > TOLD else [])))
