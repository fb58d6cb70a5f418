"""Models on new data: the validate command."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from odescope.commands.model_data import given_noise
from odescope.errors import InputError
from odescope.export.model_file import read_model
from odescope.files import model_in, shortest_ends
from odescope.model.model import Model
from odescope.model.recorded import TimeColumns
from odescope.report.result_names import MODEL
from odescope.validation.compare import compare
from odescope.validation.validate import Validation, ValidationRow

TABLE = "validation.csv"
FIGURE = "free-runs"
MODEL_ENDING = ".json"


@dataclass(frozen=True)
class ValidationFiles:
    """The models and the data of a command line."""

    models: tuple[Path, ...]
    data: tuple[Path, ...]

    @staticmethod
    def of(named: Sequence[Path], data: Sequence[Path]) -> ValidationFiles:
        """Return the files, of which those that end in .json are models, as are those in folders of results.

        Raises:
            InputError: there is no model or no data.
        """
        found = [model_in(p) if model_in(p).exists() else p for p in named]
        for path in found:
            if not path.exists() and not set(path.name) & set("*?["):
                raise InputError(f"no such file or folder: {path}")
        models = tuple(p for p in found if p.suffix.lower() == MODEL_ENDING)
        rest = (*(p for p in found if p not in models), *data)
        if not models:
            bare = [f"; {p} holds no {MODEL}" for p in named if p.is_dir()]
            raise InputError(
                f"name at least one model, a file that ends in .json, as identify writes it{''.join(bare)}"
            )
        if not rest:
            raise InputError("name at least one data file after the models, or with --data")
        return ValidationFiles(models, rest)


def validated(
    files: ValidationFiles, columns: TimeColumns, noise: Sequence[str]
) -> tuple[Validation, dict[str, Model]]:
    """Return how models of files predict the recordings of others, and the models by name.

    Args:
        files: models and data.
        columns: where the time is.
        noise: COORDINATE=NUMBER for one-step predictions.

    Raises:
        InputError: a file cannot be read, columns are missing, or models are about different coordinates.
    """
    models = {name: read_model(path) for name, path in _names(files.models).items()}
    first = next(iter(models.values()))
    given = given_noise(first, noise)
    return compare(models, files.data, columns, given), models


def validation_files(found: Validation, model: Model) -> dict[str, str | bytes]:
    """Return the table as CSV and the figure of the free runs, by name of their files.

    Args:
        found: a validation.
        model: one of the models: they are about the same coordinates.
    """
    from odescope.report.figures.draw_validation import draw_free_runs
    from odescope.report.figures.style import saved

    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(f.name for f in fields(ValidationRow))
    for row in found.rows:
        writer.writerow("" if v is None else repr(v) if isinstance(v, float) else v for v in astuple(row))
    coordinates = tuple((c.name, c.unit, c.offset) for c in model.coordinates)
    vector, raster = saved(draw_free_runs(found.runs, coordinates), FIGURE)
    return {TABLE: out.getvalue(), f"{FIGURE}.svg": vector, f"{FIGURE}.png": raster}


def _names(models: Sequence[Path]) -> dict[str, Path]:
    """Return models by the shortest ends of their paths that tell them apart, without the file's ending."""
    plain = [path.resolve().with_suffix("") for path in models]
    if len(set(plain)) < len(plain):
        raise InputError("a model is named twice")
    return dict(zip(shortest_ends(plain), models, strict=True))
