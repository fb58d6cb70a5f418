"""From the arguments of a command line to a study."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar, get_args

from odescope.errors import InputError
from odescope.recordings.coordinate import Hold
from odescope.recordings.readers import column_names
from odescope.study.options import Data, Driven, Measured, Study
from odescope.study.toml import read_study

Column = TypeVar("Column", Measured, Driven)


@dataclass(frozen=True)
class DataArguments:
    """What a command line says of a data file; None and () where it says nothing.

    Attributes:
        time: column that holds the time.
        sample_period: in seconds, where no column holds the time.
        coordinates: NAME[:cyclic][:angle][:order=N] of each.
        inputs: NAME[:HOLD] of each.
        order: of the equations of all coordinates that do not say theirs.
        recording: column that splits the file into recordings.
    """

    time: str | None = None
    sample_period: float | None = None
    coordinates: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    order: int | None = None
    recording: str | None = None


def resolve(source: Path, given: DataArguments) -> tuple[Study, Path]:
    """Return the study of a file, a study or data with arguments, and the folder that its files are relative to.

    Raises:
        InputError: the file cannot be read, or the arguments do not go together.
    """
    if source.suffix.lower() != ".toml":
        return study_of(source, given), Path()
    if given != DataArguments():
        raise InputError("with a study file, data options belong in the study; only --out may stand beside it")
    return read_study(source), source.parent


def study_of(source: Path, given: DataArguments) -> Study:
    """Return the study of a data file that arguments describe.

    Raises:
        InputError: an argument is missing, given twice, or says what cannot be.
    """
    if not given.coordinates:
        columns = ", ".join(column_names(source))
        raise InputError(
            f"name at least one measured column of {source.name}, --coordinate NAME, or pass a study (.toml) instead;"
            f" its columns are: {columns}"
        )
    if given.time is None and given.sample_period is None:
        raise InputError("name the column that holds the time, --time NAME, or give --sample-period SECONDS")
    study = Study(
        data=Data(files=(str(source),), time=given.time, sample_period=given.sample_period, recording=given.recording),
        coordinates=_each("coordinate", given.coordinates, lambda flags, text: _measured(flags, text, given.order)),
        inputs=_each("input", given.inputs, _driven),
    )
    study.measured()
    return study


def _each(option: str, texts: Sequence[str], column: Callable[[list[str], str], Column]) -> dict[str, Column]:
    found: dict[str, Column] = {}
    for text in texts:
        name, *flags = text.split(":")
        if not (name.isascii() and name.isidentifier()):
            raise InputError(
                f"--{option}: {name!r} is not a plain name; in a study file, a {option} with a plain name can read any"
                f" column, by column = {name!r}"
            )
        if name in found:
            raise InputError(f"--{option} {name} is given twice")
        found[name] = column(flags, text)
    return found


def _measured(flags: list[str], text: str, order: int | None) -> Measured:
    own = 1 if order is None else order
    for flag in flags:
        if flag.startswith("order=") and flag[6:].isdecimal():
            own = int(flag[6:])
        elif flag not in ("cyclic", "angle"):
            raise InputError(f"--coordinate {text}: after the name come cyclic, angle or order=N; {flag!r} came")
    return Measured(order=own, cyclic="cyclic" in flags, angle="angle" in flags)


def _driven(flags: list[str], text: str) -> Driven:
    for hold in ("auto", *get_args(Hold)):
        if (flags or ["auto"]) == [hold]:
            return Driven(hold=hold)
    raise InputError(
        f"--input {text}: after the name comes auto, {', '.join(get_args(Hold))} or nothing; {':'.join(flags)!r} came"
    )


def results_folder(source: Path) -> Path:
    """Return the default folder: beside the source, called like it less its endings."""
    name = source.name
    stem = Path(name.removesuffix(".gz")).stem.lstrip(".")
    return source.parent / (stem if stem not in ("", name) else f"{stem}-results")
