"""A model as a Python module of its own that imports numpy alone."""

from __future__ import annotations

from odescope.errors import check_kind
from odescope.export.about import about
from odescope.library.expression import Power, signed_sum
from odescope.library.printer import Language, print_combination
from odescope.model.model import Model
from odescope.model.switches import smoothed
from odescope.recordings.coordinate import state_chain

_TEMPLATE = '''"""{about}
{note}"""

import numpy as {np}

STATES = {states_tuple}
INPUTS = {inputs_tuple}
DELAYS = {delays_tuple}
HOLDS = {holds_tuple}

{acting}
def derivative({t}, {state}, {given}=()):
    """Return the time derivative of the state.

    {state} and {given} follow STATES and INPUTS. {given} are the values of the inputs as they act at time {t}, or a
    function of time that returns the inputs as they were recorded: each is then taken as many seconds before {t} as
    DELAYS says. Between samples it is to do what HOLDS says: keep the last value ("zero"), run linearly, or be
    band-limited, a windowed sinc. scipy's solve_ivp takes lambda t, y: derivative(t, y, recorded_at).
    """
{unpack}    {a} = {np}.array({matrix}, dtype={np}.float64)
    {b} = {np}.array({right}, dtype={np}.float64)
    {targets} = {np}.linalg.solve({a}, {b})
    return {np}.array([{following}])
'''

_NOTE = """
Dry friction is tanh(v/w) here, with w a ten-thousandth of the largest speed in the data, instead of sign(v), at which
integrators of variable step stall in standstill. It is stiff: solve_ivp is fastest with method="LSODA".
"""

_ACTING = """
def {acting}({t}, {given}):
    if callable({given}):
        return [{given}({t} - delay)[k] for k, delay in enumerate(DELAYS)]
    return {given}

"""


def to_python(model: Model) -> str:
    """Return the source of a module with STATES, INPUTS, DELAYS, HOLDS and derivative(t, state, inputs)."""
    check_kind(model, Model, "what is written")
    inputs = tuple(i.name for i in model.inputs)
    mark = "_"  # begins the module's own names; no name of the model does
    while any(name.startswith(mark) for name in (*model.variables, *model.targets)):
        mark += "_"
    own = {name: mark + name for name in ("np", "t", "a", "b", "state")} | {"given": f"{mark}inputs"}
    language = python_language(own["np"])
    matrix = [[print_combination(language, r.part(t)) for t in model.targets] for r in model.relations]
    smooth = [smoothed(r.right, model.states, model.domain) for r in model.relations]
    right = [print_combination(language, combination) for combination in smooth]
    unpack, acting = f"    {_unpacked(model.states)} = {own['state']}\n", f"{mark}acting"
    if inputs:
        unpack += f"    {_unpacked(inputs)} = {acting}({own['t']}, {own['given']})\n"
    return _TEMPLATE.format(
        about="\n".join(about(model)),
        note=_NOTE if smooth != [r.right for r in model.relations] else "",
        states_tuple=repr(model.states),
        inputs_tuple=repr(inputs),
        delays_tuple=repr(tuple(float(i.delay) for i in model.inputs)),
        holds_tuple=repr(tuple(i.hold for i in model.inputs)),
        acting=_ACTING.format(acting=acting, **own) if inputs else "",
        unpack=unpack,
        matrix="[" + ", ".join("[" + ", ".join(row) + "]" for row in matrix) + "]",
        right="[" + ", ".join(right) + "]",
        targets=_unpacked(model.targets),
        following=", ".join(state_chain(model.coordinates).values()),
        **own,
    )


write = to_python


def python_language(np: str) -> Language[str]:
    """Return how terms are written for NumPy, imported by the name `np`."""
    return Language(
        name=_raised,
        call=lambda function, argument, power: _raised(f"{np}.{function}({argument})", power),
        group=lambda inside, power: _raised(f"({inside})", power),
        product=lambda factors: "*".join(factors) or "1",
        sum=signed_sum,
    )


def _raised(body: str, power: Power) -> str:
    # A negative integer power of an integer array would be an error in numpy; a float exponent never is.
    return body if power == 1 else f"{body}**{float(power)!r}" if power < 0 else f"{body}**{power}"


def _unpacked(names: tuple[str, ...]) -> str:
    return f"({names[0]},)" if len(names) == 1 else ", ".join(names)
