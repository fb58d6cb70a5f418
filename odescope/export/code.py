"""A model as a Python module of its own that imports numpy alone."""

from __future__ import annotations

from odescope.library.expression import Combination, Name, Term, signed_sum
from odescope.model.model import Model

_TEMPLATE = '''"""Equations of motion, written by odescope.

States: {states}
Inputs: {inputs}
"""

import numpy as {np}

STATES = {states_tuple}
INPUTS = {inputs_tuple}


def derivative({t}, {state}, {given}=()):
    """Return the time derivative of the state.

    {t} is not used: inputs are given by value. {state} and {given} follow STATES and INPUTS; scipy's solve_ivp takes
    lambda t, y: derivative(t, y, input_at(t)).
    """
{unpack}    {a} = {np}.array({matrix}, dtype={np}.float64)
    {b} = {np}.array({right}, dtype={np}.float64)
    {targets} = {np}.linalg.solve({a}, {b})
    return {np}.array([{following}])
'''


def to_python(model: Model) -> str:
    """Return the source of a module with STATES, INPUTS and derivative(t, state, inputs)."""
    inputs = tuple(i.name for i in model.inputs)
    mark = "_"  # begins the module's own names; no name of the model does
    while any(name.startswith(mark) for name in (*model.variables, *model.targets)):
        mark += "_"
    own = {name: mark + name for name in ("np", "t", "a", "b", "state")} | {"given": f"{mark}inputs"}
    matrix = [[_code(r.part(t), own["np"]) for t in model.targets] for r in model.relations]
    right = [_code(Combination(tuple((-c, t) for c, t in r.part(None).parts)), own["np"]) for r in model.relations]
    unpack = f"    {_unpacked(model.states)} = {own['state']}\n"
    if inputs:
        unpack += f"    {_unpacked(inputs)} = {own['given']}\n"
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
        **own,
    )


def _unpacked(names: tuple[str, ...]) -> str:
    return f"({names[0]},)" if len(names) == 1 else ", ".join(names)


def _code(combination: Combination, np: str) -> str:
    return signed_sum((c, _term(t, np)) for c, t in combination.parts)


def _term(term: Term, np: str) -> str:
    factors = []
    for atom, power in term.factors:
        body = atom.name if isinstance(atom, Name) else f"({_code(atom.argument, np)})"
        if not isinstance(atom, Name) and atom.function:
            body = f"{np}.{atom.function}{body}"
        # A negative integer power of an integer array would be an error in numpy; a float exponent never is.
        factors.append(body if power == 1 else f"{body}**{float(power)!r}" if power < 0 else f"{body}**{power}")
    return "*".join(factors) or "1"
