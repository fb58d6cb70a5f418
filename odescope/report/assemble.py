"""From a result to plain data, and from plain data to report.json and back."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from odescope.errors import InputError
from odescope.export.model_file import from_json, to_json
from odescope.json_text import encoded
from odescope.model.model import Model
from odescope.model.quantity_units import quantity_units
from odescope.pipeline.identification import Identification
from odescope.report.at_work import at_work
from odescope.report.data import Coefficient, Observed, Report, TableRow
from odescope.report.recorded import Truth, derivatives_chart, recorded, spectra
from odescope.report.reproduce import reproduce
from odescope.report.searches import searched
from odescope.report.units import coefficient_units


def summary(
    result: Identification,
    title: str = "Identification",
    truth: Truth | None = None,
    table: Sequence[TableRow] = (),
    known: Observed | None = None,
) -> Report:
    """Return everything that the report shows as plain data, its lines downsampled.

    Args:
        result: what `identify` returned.
        title: heading of the report.
        truth: for a simulated record of one run, the true states and targets by name, one value a sample.
        table: rows that set coefficients beside those of the truth and of the paper.
        known: what `observed` returned for the same record, if it was called before.
    """
    model = result.model
    units = quantity_units(model)
    return Report(
        format="odescope/report",
        version=1,
        title=title,
        model=msgspec.Raw(msgspec.json.format(to_json(model).encode(), indent=0)),
        coefficients=tuple(
            tuple(Coefficient(unit=unit) for unit in coefficient_units(relation, units)) for relation in model.relations
        ),
        notes=result.notes,
        warnings=result.warnings,
        observed=observed(result, truth) if known is None else known,
        searches=searched(result),
        at_work=at_work(result, truth),
        table=tuple(table),
        reproduce=reproduce(result),
    )


def observed(result: Identification, truth: Truth | None = None) -> Observed:
    """Return the part of the report that does not depend on the model."""
    return Observed(recorded=recorded(result), spectra=spectra(result), derivatives=derivatives_chart(result, truth))


def to_json_text(report: Report) -> str:
    """Return the text of report.json."""
    return encoded(report).decode() + "\n"


def model_of(report: Report) -> Model:
    """Return the model of a report.

    Raises:
        InputError: it cannot be read.
    """
    return from_json(bytes(report.model))


def read_report(path: Path) -> Report:
    """Return the report that a report.json holds.

    Raises:
        InputError: the file is missing, no JSON, of another version, or says what no report can say.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(
            f"cannot read the report {path}: {error.strerror or error}; odescope identify writes it"
        ) from error
    try:
        report = msgspec.json.decode(data, type=Report)
        model = model_of(report)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError, InputError) as error:
        raise InputError(f"{path} is not a report that odescope can draw: {_explained(str(error))}") from error
    given = [len(row) for row in report.coefficients]
    if given != [len(relation.terms) for relation in model.relations]:
        raise InputError(f"{path} is not a report that odescope can draw: its coefficients are not those of its model")
    return report


def _explained(message: str) -> str:
    if "`$.format`" in message:
        return 'its format is not "odescope/report"'
    if "`$.version`" in message:
        return "its version is not 1, the only one known here; identify again"
    return message.replace("`$.", "`").replace("Object", "an object")
