"""Several models on the same files: each reads them as it was identified."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from odescope.errors import InputError
from odescope.model.model import Model
from odescope.model.recorded import UNSAID, TimeColumns, read_for
from odescope.validation.validate import Validation, together, validate


def compare(
    models: Mapping[str, Model],
    files: Sequence[Path],
    columns: TimeColumns = UNSAID,
    noise: Mapping[str, float] | None = None,
) -> Validation:
    """Return how models predict the recordings of some files.

    Args:
        models: by name.
        files: data.
        columns: where the time is.
        noise: standard deviation of a sample, by coordinate, for one-step predictions.

    Raises:
        InputError: the models are about different coordinates, a file cannot be read, or columns are missing.
    """
    first, *others = models.items()
    about = [c.name for c in first[1].coordinates]
    for name, model in others:
        if [c.name for c in model.coordinates] != about:
            raise InputError(
                f"models that are compared must be about the same coordinates: {first[0]} is about"
                f" {', '.join(about)}, {name} about {', '.join(c.name for c in model.coordinates)}"
            )
    names = {name: [c.name for c in m.coordinates] + [i.name for i in m.inputs] for name, m in models.items()}
    return together(
        [validate({name: m}, read_for(m, files, columns, names[name]), noise) for name, m in models.items()]
    )
