"""Models written by hand for the tests of the exports: rational, coupled, with nasty names and numbers."""

from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm
from odescope.model.scores import Denominator, FreeRun, ModelScores, TargetScore
from odescope.recordings.coordinate import Coordinate, Input


def relation(scope, *terms):
    return Relation(tuple(RelationTerm(Product(f, parse_term(t, scope)), c, *error) for f, t, c, *error in terms))


def rational():
    """One angle and one position, both quotients, as the pendulum on a cart."""
    scope = Scope.of(["x", "phi", "x_dot", "phi_dot", "u", "v"])
    return Model(
        (Coordinate("x", 2, cyclic=True, unit="m"), Coordinate("phi", 2, angle=True)),
        (Input("u", "linear", "N"), Input("v", "zero")),
        (
            relation(
                scope,
                ("x_ddot", "1", 1.0),
                ("x_ddot", "cos(phi)**2", -0.1 - 0.2, 1e-3),
                (None, "u", -1 / 3, 2e-300),
                (None, "sin(phi)*cos(phi)", -3.2),
                (None, "x_dot", 5.55, 0.0),
                (None, "1", 1e-17),
            ),
            relation(
                scope,
                ("phi_ddot", "1", 1.0),
                ("phi_ddot", "(1.5 + abs(phi_dot))**-1", 0.25),
                (None, "v*exp(-0.5*x)", 2.0),
                (None, "phi_dot*abs(phi_dot)", 0.7),
                (None, "tanh(3.0*phi_dot - u)", -1.0),
                (None, "phi_dot**-2", 1e-9),
                (None, "(x**2 + 1.0)**0.5", 0.125),
            ),
        ),
        ModelScores(
            targets={"x_ddot": TargetScore(0.1 + 0.2, 1e-17, 0.75, float("inf"), Denominator((0.1, 1.0), (-0.1, 1.0)))},
            free_runs=(FreeRun(13.0, 1 / 3),),
        ),
        {"x": (-1 / 3, 1e22), "phi": (0.0, 5e-324)},
        {"odescope": "0.1.0", "columns": {"x": "x [m]"}, "note": 'ü "quoted" \\ \n'},
    )


def coupled():
    """Three coordinates of order 1, 2 and 3, the first two relations sharing their targets."""
    scope = Scope.of(["c", "q", "w", "q_dot", "w_dot", "w_ddot"])
    return Model(
        (Coordinate("c", 1), Coordinate("q", 2), Coordinate("w", 3)),
        (),
        (
            relation(scope, ("c_dot", "1", 1.0), ("q_ddot", "c", 0.5), (None, "q", 1.0), (None, "c*q_dot", -2.0)),
            relation(scope, ("q_ddot", "1", 1.0), ("c_dot", "sin(q)", 0.25), (None, "w", 3.0), (None, "1", -1.0)),
            relation(scope, ("w_dddot", "1", 1.0), (None, "w_ddot*w_dot", 1.0), (None, "w", 1.0), (None, "c", -1.0)),
        ),
    )


def hostile():
    """Names that a careless program would trip over: its own, NumPy's, and those of Python's builtins."""
    names = ("_np", "_a", "float", "dtype", "numpy", "derivative", "_state", "STATES", "len", "_t")
    scope = Scope.of([*names, *(f"{n}_dot" for n in names), "_inputs", "_b"])
    return Model(
        tuple(Coordinate(n, 2) for n in names),
        (Input("_inputs"), Input("_b")),
        tuple(
            relation(
                scope,
                (f"{n}_ddot", "1", 1.0),
                (None, f"{n}*cos({n}_dot)", 1.0 + k),
                (None, "_a*_b", -0.5),
                (None, "_inputs*float", 0.25),
            )
            for k, n in enumerate(names)
        ),
    )


MODELS = {"rational": rational(), "coupled": coupled(), "hostile": hostile()}
