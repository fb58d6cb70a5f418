"""MATLAB files up to version 7: a variable a column."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from pathlib import Path

from odescope.errors import InputError
from odescope.recordings.chunks import DataFile
from odescope.recordings.columns import Columns, check_columns, first_line, from_arrays
from odescope.recordings.layout import Layout


def survey_matlab(path: Path, layout: Layout) -> DataFile:
    """Return how many rows a MATLAB file holds; it can only be read whole."""
    return DataFile(path, _rows(path, layout), divisible=False)


def read_matlab(path: Path, layout: Layout) -> Columns:
    """Return the used variables of a MATLAB file."""
    from scipy.io import loadmat

    _rows(path, layout)
    with _matlab_faults(path):
        arrays = loadmat(path, variable_names=list(layout.used))
    return from_arrays({label: arrays[label] for label in layout.used}, path.name)


def _rows(path: Path, layout: Layout) -> int:
    """Return how many rows the used variables have, by the first; refuse a file where one is lacking or no column."""
    from scipy.io import whosmat

    with _matlab_faults(path):
        kinds = {name: (shape, kind) for name, shape, kind in whosmat(path)}
        _check_variables(kinds, layout, path.name)
    return math.prod(kinds[layout.used[0]][0])


@contextlib.contextmanager
def _matlab_faults(path: Path) -> Iterator[None]:
    from scipy.io.matlab import MatReadError

    try:
        yield
    except InputError:  # a ValueError too, but already worded
        raise
    except NotImplementedError as error:  # scipy's answer to HDF5
        raise InputError(f"{path.name} is a MATLAB 7.3 file; save it with save(..., '-v7')") from error
    except (MatReadError, ValueError, TypeError, KeyError, IndexError) as error:
        raise InputError(f"{path.name} cannot be read as a MATLAB file: {first_line(error)}") from error


def _check_variables(kinds: Mapping[str, tuple[tuple[int, ...], str]], layout: Layout, source: str) -> None:
    """Refuse variables that are no columns; where one is lacking, say which variables may be hiding it."""
    hiding = [name for name, (shape, kind) in kinds.items() if not _is_column(shape, kind)]
    for label in layout.used:
        if label in hiding or (hiding and label not in kinds):
            name = label if label in kinds else hiding[0]
            shape, kind = kinds[name]
            size = "x".join(map(str, shape))
            lacking = f"no variable {label!r} in {source}; " if label not in kinds else f"in {source}, "
            raise InputError(
                f"{lacking}{name!r} is a {size} {kind}: save each column as a variable of its own (for a struct, "
                "save(file, '-struct', name) does it)"
            )
    check_columns(layout.used, list(kinds), source)


def _is_column(shape: tuple[int, ...], kind: str) -> bool:
    return kind not in ("struct", "cell", "object", "function", "opaque", "sparse", "char") and (
        len(shape) == 1 or (len(shape) == 2 and 1 in shape)
    )


def matlab_names(path: Path) -> list[str]:
    """Return the names of the variables."""
    from scipy.io import whosmat

    with _matlab_faults(path):
        return [name for name, _, _ in whosmat(path)]
