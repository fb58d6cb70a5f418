"""From the arguments of a command line to a study."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, TypeVar, get_args

import msgspec

from odescope.errors import InputError, nearest
from odescope.library.parse import parse_term
from odescope.recordings.coordinate import Hold
from odescope.recordings.gaps import Gaps
from odescope.recordings.headings import UNITS_OF_TIME, Heading, check_time_unit, find_label
from odescope.recordings.readers import column_names, find_files
from odescope.report.place import default_place
from odescope.study.clock import with_time
from odescope.study.library_options import MOST_DEGREE, Candidates
from odescope.study.options import Data, Driven, Measured, Study
from odescope.study.toml import read_study, with_whole_paths

Column = TypeVar("Column", Measured, Driven)


@dataclass(frozen=True)
class DataArguments:
    """What a command line says of data files; None and () where it says nothing.

    Attributes:
        time: column that holds the time.
        sample_period: in seconds, where no column holds the time.
        coordinates: NAME[:cyclic][:angle][:order=N] of each.
        inputs: NAME[:HOLD] of each.
        order: of the equations of all coordinates that do not say theirs.
        recording: column that splits the files into recordings.
        gaps: what is done about them.
        delays: INPUT=SECONDS of each, or INPUT=estimate.
        basis: functions that terms are products of, several in one text with commas between.
        degree: of the terms.
        time_unit: of the column that holds the time.
    """

    time: str | None = None
    sample_period: float | None = None
    coordinates: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    order: int | None = None
    recording: str | None = None
    gaps: str | None = None
    delays: tuple[str, ...] = ()
    basis: tuple[str, ...] = ()
    degree: int | None = None
    time_unit: str | None = None


def resolve(sources: Sequence[Path], given: DataArguments) -> tuple[Study, Path]:
    """Return the study of files, a study or data with arguments, and the folder that its files are relative to.

    Raises:
        InputError: a file cannot be read, or the arguments do not go together.
    """
    studies = [source for source in sources if source.suffix.lower() == ".toml"]
    if not studies:
        return study_of(sources, given), Path()
    if len(sources) > 1:
        raise InputError(
            f"{studies[0].name} is a study: it is identified alone, and names its data itself, files = [...] in [data]"
        )
    if given != DataArguments():
        raise InputError(
            "with a study file, data options belong in the study; only --out, --seconds, --cluster and --events may"
            " stand beside it"
        )
    folder = studies[0].parent
    return with_whole_paths(read_study(studies[0]), folder), folder


def with_seconds(study: Study, seconds: float) -> Study:
    """Return a study whose searches the clock ends so many seconds after the run began.

    Raises:
        InputError: that is no time.
    """
    if not 0.0 < seconds < math.inf:
        raise InputError(f"--seconds {seconds}: expected a positive number")
    return msgspec.structs.replace(study, likelihood=msgspec.structs.replace(study.likelihood, seconds=seconds))


def study_of(sources: Sequence[Path], given: DataArguments) -> Study:
    """Return the study of data files that arguments describe.

    Raises:
        InputError: an argument is missing, given twice, or says what cannot be.
    """
    first = find_files(sources)[0]
    labels = column_names(first)
    if not given.coordinates:
        raise InputError(
            f"name at least one measured column of {first.name}, --coordinate NAME, or pass a study (.toml) instead,"
            f" which odescope init {sources[0]} writes; its columns are: {', '.join(labels)}"
        )
    if given.time is None and given.sample_period is None:
        raise InputError(
            f"name the column of {first.name} that holds the time, --time NAME, or give --sample-period SECONDS; its"
            f" columns are: {', '.join(labels)}"
        )
    if given.gaps is not None and given.gaps not in get_args(Gaps):
        raise InputError(f"--gaps {given.gaps}: expected one of {', '.join(get_args(Gaps))}")
    if given.time_unit is not None:
        check_time_unit(given.time_unit)
    data = Data(
        files=tuple(map(str, sources)),
        time=given.time,
        time_unit=next((unit for unit in UNITS_OF_TIME if unit == given.time_unit), None),
        sample_period=given.sample_period,
        recording=given.recording,
        gaps=next((gaps for gaps in get_args(Gaps) if gaps == given.gaps), Data().gaps),
    )
    inputs = _each("input", given.inputs, labels, _driven)
    study = Study(
        data=data,
        coordinates=_each("coordinate", given.coordinates, labels, partial(_measured, given.order)),
        inputs=_delayed(inputs, given.delays),
        library=_library(given),
    )
    study.measured()
    scope = with_time(study).scope()
    for function in study.library.basis or ():
        parse_term(function, scope)
    return study


def _library(given: DataArguments) -> Candidates:
    """Return the library of a basis; the default one where none is given."""
    basis = tuple(part.strip() for text in given.basis for part in text.split(",") if part.strip())
    if given.degree is not None and not 1 <= given.degree <= MOST_DEGREE:
        raise InputError(f"--degree {given.degree}: expected a whole number from 1 to {MOST_DEGREE}")
    found = Candidates(basis=basis or None)
    return found if given.degree is None else msgspec.structs.replace(found, degree=given.degree)


def _delayed(inputs: dict[str, Driven], texts: Sequence[str]) -> dict[str, Driven]:
    """Return inputs with the delays that are given."""
    found = dict(inputs)
    for text in texts:
        label, equals, value = text.rpartition("=")
        if not equals:
            raise InputError(f"--delay {text}: expected INPUT=SECONDS, such as {next(iter(inputs), 'u')}=0.02")
        name = Heading.of(label).name
        if name not in inputs:
            raise InputError(f"--delay {text}: {label!r} is no --input; {nearest(name, inputs)}")
        try:
            delay: float | Literal["auto", "estimate"]
            delay = "auto" if value == "auto" else "estimate" if value == "estimate" else float(value)
        except ValueError:
            expected = f"INPUT=SECONDS, such as {name}=0.02, or {name}=estimate"
            raise InputError(f"--delay {text}: expected {expected}") from None
        own = inputs[name]
        found[name] = Driven(column=own.column, hold=own.hold, unit=own.unit, delay=delay)
    return found


def _each(
    option: str, texts: Sequence[str], labels: Sequence[str], column: Callable[[str | None, list[str], str], Column]
) -> dict[str, Column]:
    found: dict[str, Column] = {}
    for text in texts:
        label, *flags = text.split(":")
        name, read = label, None
        if not (name.isascii() and name.isidentifier()):
            # Only of a column that is there: anything else is a slip, and its plain name would hide that.
            read = find_label(label, labels, "the data")
            name = label if read is None else Heading.of(read).name
        if not (name.isascii() and name.isidentifier()):
            near = nearest(label, labels)
            if near.startswith("did you mean"):
                raise InputError(f"--{option}: there is no column {label!r}; {near}")
            raise InputError(
                f"--{option}: {name!r} is not a plain name; in a study file, a {option} with a plain name can read any"
                f" column, by column = {name!r}"
            )
        if name in found:
            raise InputError(f"--{option} {name} is given twice")
        found[name] = column(read, flags, text)
    return found


def _measured(order: int | None, column: str | None, flags: list[str], text: str) -> Measured:
    own = 1 if order is None else order
    for flag in flags:
        if flag.startswith("order=") and flag[6:].isdecimal():
            own = int(flag[6:])
        elif flag not in ("cyclic", "angle"):
            raise InputError(f"--coordinate {text}: after the name come cyclic, angle or order=N; {flag!r} came")
    return Measured(column=column, order=own, cyclic="cyclic" in flags, angle="angle" in flags)


def _driven(column: str | None, flags: list[str], text: str) -> Driven:
    for hold in ("auto", *get_args(Hold)):
        if (flags or ["auto"]) == [hold]:
            return Driven(column=column, hold=hold)
    raise InputError(
        f"--input {text}: after the name comes auto, {', '.join(get_args(Hold))} or nothing; {':'.join(flags)!r} came"
    )


def results_folder(sources: Sequence[Path], study: Study, folder: Path) -> Path:
    """Return the default folder: beside the first source, called like it less its endings, and how many follow.

    Where the data come from that, as from logs/ of which logs.toml is a study, "-results" follows.

    Args:
        sources: of the command line.
        study: that they came to.
        folder: that its files are relative to.
    """
    return default_place(_whole(sources[0]).parent / source_stem(sources), study.data.files, folder)


def source_stem(sources: Sequence[Path]) -> str:
    """Return what results are called by default: as the first source less its endings, and how many follow."""
    name = _whole(sources[0]).name
    bare = "".join(sign for sign in name if sign not in "*?")
    only_ending = bare != name and bare.startswith(".")  # of *.csv
    stem = "" if only_ending else Path(bare.removesuffix(".gz")).stem.lstrip(".")
    more = f"-and-{len(sources) - 1}-more" if len(sources) > 1 else ""
    return f"{stem or 'results'}{more}"


def _whole(source: Path) -> Path:
    return source if source.name not in ("", "..") else source.resolve()
