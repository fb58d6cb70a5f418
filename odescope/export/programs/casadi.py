"""A model as a Python module for CasADi."""

from __future__ import annotations

from collections.abc import Mapping

from odescope.export.about import about
from odescope.export.program_files import NAME, ProgramFiles, check_program
from odescope.export.recorded_python import acting_function
from odescope.export.smooth import smooth_relations
from odescope.export.spelling import Names, renamed
from odescope.library.expression import Power, signed_sum
from odescope.library.printer import Language, print_combination
from odescope.model.model import Model
from odescope.model.state_sizes import small_sizes
from odescope.recordings.coordinate import state_chain

_OWN = """
casadi numpy derivative step acting simulate ode_x ode_u ode_a ode_b ode_dx STATES INPUTS DELAYS HOLDS OFFSETS float int
"""
ABSTOL = 1e-12  # of a state of size 1; CVODES takes one for all
_NAMES = Names(frozenset(_OWN.split()), underscore=True)
_FUNCTIONS = {"abs": "fabs"}

_TEMPLATE = '''"""{header}

`derivative` is a casadi.Function from states x and inputs u, as they act, to the derivative dx; `step` advances the
states over h seconds by the Runge-Kutta method of fourth order, u0 and u1 being the inputs at its begin and end.
Inputs act as many seconds after they were recorded as DELAYS says, and between samples do what HOLDS says: `acting`
lays a record out so, and `simulate` runs along it with CVODES. Sensors read OFFSETS more than the coordinates.
{note}"""

import casadi
import numpy

STATES = {states!r}
INPUTS = {inputs!r}
DELAYS = {delays!r}
HOLDS = {holds!r}
OFFSETS = {offsets!r}


def _derivative():
    ode_x, ode_u = casadi.SX.sym("x", {n}), casadi.SX.sym("u", {m})
{unpack}    ode_a = casadi.SX({n_targets}, {n_targets})
{matrix}    ode_b = casadi.vertcat({right})
    ode_b = casadi.solve(ode_a, ode_b)
    ode_dx = casadi.vertcat({following})
    return casadi.Function("derivative", [ode_x, ode_u], [ode_dx], ["x", "u"], ["dx"])


def _step():
    x, h = casadi.SX.sym("x", {n}), casadi.SX.sym("h")
    u0, u1 = casadi.SX.sym("u0", {m}), casadi.SX.sym("u1", {m})
    middle = (u0 + u1) / 2
    k1 = derivative(x, u0)
    k2 = derivative(x + h / 2 * k1, middle)
    k3 = derivative(x + h / 2 * k2, middle)
    k4 = derivative(x + h * k3, u1)
    after = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return casadi.Function("step", [x, u0, u1, h], [after], ["x", "u0", "u1", "h"], ["after"])


derivative = _derivative()
step = _step()

{acting}

def simulate(x, t, u, reltol=1e-10, abstol={abstol!r}):
    """Return the states (N, {n}) at times t (N,), from x at the first on, under inputs u (N, {m}) as recorded."""
    times, begin, end, samples = acting(t, u)
    state, share, span = casadi.SX.sym("x", {n}), casadi.SX.sym("share"), casadi.SX.sym("span")
    u0, u1 = casadi.SX.sym("u0", {m}), casadi.SX.sym("u1", {m})
    rate = span * derivative(state, u0 + share * (u1 - u0))
    problem = {{"x": state, "t": share, "p": casadi.vertcat(u0, u1, span), "ode": rate}}
    options = {{"reltol": reltol, "abstol": abstol}}
    across = casadi.integrator("across", "cvodes", problem, 0, 1, options)
    states = [casadi.DM(x)]
    for k in range(len(times) - 1):
        given = casadi.vertcat(begin[k], end[k], times[k + 1] - times[k])
        states.append(across(x0=states[-1], p=given)["xf"])
    return numpy.array(casadi.horzcat(*states)).T[samples]
'''


def to_casadi(model: Model, name: str = NAME) -> ProgramFiles:
    """Return a Python module with a casadi.Function of the right-hand side, one of a step, and a run along a record.

    Raises:
        InputError: no module can be called so.
    """
    check_program(model, name, _NAMES, "CasADi")
    spelling, relations = _NAMES.spelled(model.variables), smooth_relations(model)
    language, notes = casadi_language(spelling), renamed(spelling)
    unpack = [f"{spelling[s]} = ode_x[{k}]" for k, s in enumerate(model.states)]
    unpack += [f"{spelling[i.name]} = ode_u[{k}]" for k, i in enumerate(model.inputs)]
    entries = [(i, j, c) for i, row in enumerate(relations.matrix) for j, c in enumerate(row) if c.parts]
    place = {s: spelling[s] for s in model.states} | {t: f"ode_b[{k}]" for k, t in enumerate(model.targets)}
    text = _TEMPLATE.format(
        header="\n".join(about(model, notes)),
        note="".join(f"\n{line}" for line in relations.notes) + ("\n" if relations.notes else ""),
        states=model.states,
        inputs=tuple(i.name for i in model.inputs),
        delays=tuple(float(i.delay) for i in model.inputs),
        holds=tuple(i.hold for i in model.inputs),
        offsets=tuple(float(c.offset) for c in model.coordinates),
        n=len(model.states),
        m=len(model.inputs),
        n_targets=len(model.targets),
        unpack="".join(f"    {line}\n" for line in unpack),
        matrix="".join(f"    ode_a[{i}, {j}] = {print_combination(language, c)}\n" for i, j, c in entries),
        right=", ".join(print_combination(language, c) for c in relations.right),
        following=", ".join(place[d] for d in state_chain(model.coordinates).values()),
        acting=acting_function(model),
        abstol=ABSTOL * float(small_sizes(model).min()),
    )
    return ProgramFiles({f"{name}.py": text}, (*notes, *relations.notes))


write = to_casadi


def casadi_language(names: Mapping[str, str]) -> Language[str]:
    """Return how terms are written for CasADi in Python; `names` says how states and inputs are."""
    return Language(
        name=lambda name, power: _raised(names[name], power),
        call=lambda function, argument, power: _raised(
            f"casadi.{_FUNCTIONS.get(function, function)}({argument})", power
        ),
        group=lambda inside, power: _raised(f"({inside})", power),
        product=lambda factors: "*".join(factors) or "1",
        sum=signed_sum,
    )


def _raised(body: str, power: Power) -> str:
    return body if power == 1 else f"{body}**{power}"
