"""A model as a Python module of its own that imports numpy alone."""

from __future__ import annotations

from odescope.library.expression import Combination, Name, Term, signed_sum
from odescope.model.model import Model

_TEMPLATE = '''"""Equations of motion, written by odescope.

States: {states}
Inputs: {inputs}
"""

import numpy as _np

STATES = {states_tuple}
INPUTS = {inputs_tuple}


def derivative(_t, _state, _inputs=()):
    """Return the time derivative of the state.

    _t is not used: inputs are given by value. _state and _inputs follow STATES and INPUTS; scipy's solve_ivp takes
    lambda t, y: derivative(t, y, input_at(t)).
    """
{unpack}    _a = _np.array({matrix}, dtype=float)
    _b = _np.array({right}, dtype=float)
    {targets} = _np.linalg.solve(_a, _b)
    return _np.array([{following}])
'''


def to_python(model: Model) -> str:
    """Return the source of a module with STATES, INPUTS and derivative(t, state, inputs)."""
    inputs = tuple(i.name for i in model.inputs)
    matrix = [[_code(r.part(t)) for t in model.targets] for r in model.relations]
    right = [_code(Combination(tuple((-c, t) for c, t in r.part(None).parts))) for r in model.relations]
    unpack = f"    {_unpacked(model.states)} = _state\n"
    if inputs:
        unpack += f"    {_unpacked(inputs)} = _inputs\n"
    levels = {c.derivative(k): c.derivative(k + 1) for c in model.coordinates for k in range(c.order)}
    return _TEMPLATE.format(
        states=", ".join(model.states),
        inputs=", ".join(inputs) or "none",
        states_tuple=repr(model.states),
        inputs_tuple=repr(inputs),
        unpack=unpack,
        matrix="[" + ", ".join("[" + ", ".join(row) + "]" for row in matrix) + "]",
        right="[" + ", ".join(right) + "]",
        targets=_unpacked(model.targets),
        following=", ".join(levels[s] for s in model.states),
    )


def _unpacked(names: tuple[str, ...]) -> str:
    return f"({names[0]},)" if len(names) == 1 else ", ".join(names)


def _code(combination: Combination) -> str:
    return signed_sum((c, _term(t)) for c, t in combination.parts)


def _term(term: Term) -> str:
    factors = []
    for atom, power in term.factors:
        body = atom.name if isinstance(atom, Name) else f"({_code(atom.argument)})"
        if not isinstance(atom, Name) and atom.function:
            body = f"_np.{atom.function}{body}"
        # A negative integer power of an integer array would be an error in numpy; a float exponent never is.
        factors.append(body if power == 1 else f"{body}**{float(power)!r}" if power < 0 else f"{body}**{power}")
    return "*".join(factors) or "1"
