"""What a caller gives a simulation: times, inputs and states, as lists, dicts, dataframes or arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from odescope.arrays import FloatArray, Table
from odescope.errors import InputError, nearest, said
from odescope.recordings.coordinate import Input

GivenInputs: TypeAlias = Table | ArrayLike | None
GivenState: TypeAlias = Mapping[str, float] | Table | ArrayLike | None


def sample_times(t: ArrayLike) -> FloatArray:
    """Return times (N,).

    Raises:
        InputError: they are no list of finite numbers that ascend.
    """
    found = _numbers(t)
    if found is None or found.ndim != 1:
        raise InputError(f"t must be sample times in seconds, a list or array of shape (N,); {said(t)} came")
    if not np.all(np.isfinite(found)):
        raise InputError("t must be finite")
    if len(found) == 0 or np.any(np.diff(found) <= 0.0):
        raise InputError("sample times must ascend, and there must be at least one")
    return found


def sampled_inputs(given: GivenInputs, inputs: Sequence[Input], t: FloatArray) -> FloatArray:
    """Return inputs (N, m); the time, of a model that names it, need not be given.

    Args:
        given: by name, each of shape (N,) or one number throughout; or an array of shape (N, m), (N,) for one input.
        inputs: of the model, in their order.
        t: (N,) sample times in seconds.

    Raises:
        InputError: an input is missing, is not of that shape, or not finite.
    """
    count, names = len(t), [i.name for i in inputs]
    wanted = f"inputs must be {_spelled(names, 'u', '[...]')} or an array of shape ({count}, {len(names)})" + (
        f", a column each for {', '.join(names)}" if names else ", or None: the model has no inputs"
    )
    clock = {i.name: t for i in inputs if i.is_time}
    columns = {} if given is None and len(clock) == len(names) else _by_name(given)
    if columns is not None:
        columns = {**clock, **columns}
        lacking = [name for name in names if name not in columns]
        if lacking:
            raise InputError(f"{wanted}; {lacking[0]!r} is missing, {nearest(lacking[0], columns)}")
        parts = [_numbers(columns[name]) for name in names]
        for name, part in zip(names, parts, strict=True):
            if part is None or (part.shape and part.shape != (count,)):
                raise InputError(f"{wanted}; of {name!r} came {said(columns[name] if part is None else part)}")
        found = np.column_stack([np.empty((count, 0)), *(np.broadcast_to(p, (count,)) for p in parts if p is not None)])
    else:
        own = _numbers(given)
        found = np.empty(0) if own is None else own[:, None] if own.ndim == 1 and len(names) == 1 else own
        if own is None or found.shape != (count, len(names)):
            raise InputError(f"{wanted}; {said(given if own is None else own)} came")
    if not np.all(np.isfinite(found)):
        raise InputError("inputs must be finite")
    return found


def first_state(given: GivenState, names: Sequence[str]) -> FloatArray:
    """Return states (n,).

    Args:
        given: by name, or in the order of the names.
        names: of the states.

    Raises:
        InputError: a state is missing or unknown, or not one finite number.
    """
    wanted = (
        f"initial must be the states at t[0], {_spelled(names, 'x', '...')} or a list or array of shape ({len(names)},)"
    )
    columns = _by_name(given)
    if columns is not None:
        for name in names:
            if name not in columns:
                raise InputError(f"{wanted}; {name!r} is missing: velocities count as states, too")
        for name in columns:
            if name not in names:
                raise InputError(f"{wanted}; {name!r} is no state, {nearest(name, names)}")
        parts = [_numbers(columns[name]) for name in names]
        for name, part in zip(names, parts, strict=True):
            if part is None or part.size != 1:
                raise InputError(f"{wanted}; of {name!r} came {said(columns[name] if part is None else part)}")
        found = np.array([float(part.ravel()[0]) for part in parts if part is not None])
    else:
        own = _numbers(given)
        if own is None or own.shape != (len(names),):
            raise InputError(f"{wanted}; {said(given if own is None else own)} came")
        found = own
    if not np.all(np.isfinite(found)):
        raise InputError("initial states must be finite")
    return found


def _spelled(names: Sequence[str], example: str, value: str) -> str:
    """Return what a dict of these names looks like."""
    shown = ", ".join(f'"{name}": {value}' for name in names[:4] or [example])
    return "{" + shown + (", ...}" if len(names) > 4 else "}")


def _by_name(given: object) -> Mapping[str, object] | None:
    """Return columns or numbers by name, None where what came has no names."""
    if hasattr(given, "keys"):  # a dict, a dataframe of pandas, a series with an index of names
        keys = list(given.keys())
        return {key: given[key] for key in keys} if all(isinstance(k, str) for k in keys) else None  # type: ignore[index]
    if hasattr(given, "__arrow_c_stream__") and len(getattr(given, "shape", ())) == 2:
        import pyarrow as pa

        table = pa.table(given)
        return {name: table.column(name).to_numpy() for name in table.column_names}
    return None


def _numbers(given: object) -> FloatArray | None:
    """Return real numbers as an array, None where it is something else."""
    try:
        found = np.asarray(given)
        return None if found.dtype.kind not in "biuf" else np.array(found, dtype=np.float64)
    except (ValueError, TypeError):  # rows of different lengths, and what is no array at all
        return None
