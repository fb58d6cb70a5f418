"""From a result to plain data, and from plain data to report.json and back."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import msgspec

from odescope.errors import InputError
from odescope.export.model_file import from_json, to_json
from odescope.model.model import Model
from odescope.pipeline.identification import Identification
from odescope.report.at_work import at_work
from odescope.report.data import Coefficient, Measured, Report, Reproduce, Stage, TableRow
from odescope.report.recorded import Truth, derivatives_chart, recorded, spectra
from odescope.report.searches import likelihood, searched
from odescope.report.units import coefficient_units, quantity_units
from odescope.study.toml import study_toml

PACKAGES = ("numpy", "scipy", "numba", "matplotlib")


def summary(
    result: Identification,
    title: str = "Identification",
    study: str | None = None,
    truth: Truth | None = None,
    table: Sequence[TableRow] = (),
    known: Measured | None = None,
) -> Report:
    """Return everything that the report shows as plain data, its lines thinned.

    Args:
        result: what `identify` returned.
        title: heading of the report.
        study: the resolved study as TOML; by default that of the result.
        truth: for a simulated record of one run, the true states and targets by name, one value a sample.
        table: rows that set coefficients beside those of the truth and of the paper.
        known: what `measured` returned for the same record, if it was called before.
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
        measured=measured(result, truth) if known is None else known,
        searches=searched(result),
        likelihood=likelihood(result),
        at_work=at_work(result, truth),
        table=tuple(table),
        reproduce=Reproduce(
            study=study_toml(result.study) if study is None else study,
            seed=result.study.random.seed,
            versions=_versions(),
            stages=tuple(
                Stage(name=name, seconds=round(seconds, 4), peak=result.memory.get(name))
                for name, seconds in result.seconds.items()
            ),
        ),
    )


def measured(result: Identification, truth: Truth | None = None) -> Measured:
    """Return the part of the report that does not depend on the model."""
    return Measured(recorded=recorded(result), spectra=spectra(result), derivatives=derivatives_chart(result, truth))


def _versions() -> tuple[tuple[str, str], ...]:
    from odescope import __version__

    python = ("Python", f"{platform.python_version()}, {platform.system()} {platform.machine()}")
    return (("odescope", __version__), python, *((name, version(name)) for name in PACKAGES))


def to_json_text(report: Report) -> str:
    """Return the text of report.json."""
    return msgspec.json.encode(report).decode() + "\n"


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
