"""A model for integrators that know no standstill: a smooth step stands for the sign of dry friction."""

from __future__ import annotations

from dataclasses import dataclass

from odescope.library.expression import Combination
from odescope.model.model import Model
from odescope.model.switches import smoothed

DRY = (
    "Dry friction is tanh(v/w) here, with w a ten-thousandth of the largest speed in the data, instead of sign(v):",
    "integrators of variable step stall at the standstill of a sign. It is stiff: take a method for such equations.",
)


@dataclass(frozen=True)
class SmoothRelations:
    """matrix (targets, targets) times the targets is `right`; `notes` say what was smoothed, if anything."""

    matrix: tuple[tuple[Combination, ...], ...]
    right: tuple[Combination, ...]
    notes: tuple[str, ...]


def smooth_relations(model: Model) -> SmoothRelations:
    """Return the relations of a model with dry friction smoothed, where the range of its speed is known."""
    right = tuple(smoothed(r.right, model.states, model.domain) for r in model.relations)
    matrix = tuple(tuple(r.part(target) for target in model.targets) for r in model.relations)
    return SmoothRelations(matrix, right, DRY if right != tuple(r.right for r in model.relations) else ())
