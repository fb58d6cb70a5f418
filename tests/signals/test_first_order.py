"""What the rate of a quantity follows from tells an amount from a position."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.headings import Heading
from odescope.recordings.record import Record, Records
from odescope.signals.differentiators import Spectral
from odescope.signals.estimate import estimate_signals
from odescope.signals.first_order import FOLDS, STRETCHES, order_advice, rate_explained, second_order_hints
from odescope.signals.look import look

T = 0.02 * np.arange(1500)


def test_of_a_rate_that_is_a_polynomial_all_is_explained_and_of_one_that_is_not_nothing():
    rng = np.random.default_rng(0)
    values = rng.standard_normal((2, 4000))
    follows = 1.0 - values[0] + 0.3 * values[0] * values[1] ** 2
    assert rate_explained([follows], [values]) == pytest.approx(1.0, abs=1e-9)
    assert rate_explained([rng.standard_normal(4000)], [values]) < 0.01


def test_it_is_that_of_a_straight_line_fitted_to_the_other_stretches():
    """Records too short for more than a line, by the textbook's slope and intercept."""
    rng = np.random.default_rng(1)
    xs = [rng.standard_normal(14), 1.0 + rng.standard_normal(11)]
    rates = [2.0 - 1.5 * x + 0.5 * rng.standard_normal(len(x)) for x in xs]
    fold = np.concatenate([np.arange(len(x)) * STRETCHES // len(x) % FOLDS for x in xs])
    x, y = np.concatenate(xs), np.concatenate(rates)
    left = np.empty(len(y))
    for k in range(FOLDS):
        a, b = x[fold != k], y[fold != k]
        slope = np.cov(a, b, bias=True)[0, 1] / a.var()
        left[fold == k] = (y - b.mean() - slope * (x - a.mean()))[fold == k]
    expected = 1.0 - np.sum(left**2) / np.sum((y - y.mean()) ** 2)
    assert rate_explained(rates, [v[None] for v in xs]) == pytest.approx(expected, abs=1e-12)


def orders(columns, noise=0.002):
    """The orders that the columns of a log look like, with noise."""
    rng = np.random.default_rng(2)
    seen = {n: y + noise * np.std(y) * rng.standard_normal(len(y)) if n != "u" else y for n, y in columns.items()}
    record = Record(T, np.column_stack(list(seen.values())), tuple(seen), (None,) * len(seen), "log")
    return {s.name: s.order for s in look(Records((record,)), {n: Heading.of(n) for n in seen}) if s.name != "u"}


def simulated(rates, start):
    return solve_ivp(rates, (T[0], T[-1]), start, t_eval=T, rtol=1e-9, atol=1e-9, max_step=0.02).y


@pytest.mark.parametrize("zeta", [0.02, 0.3, 1.0])
def test_a_position_that_swings_back_is_one(zeta):
    x = simulated(lambda _, s: [s[1], -2.0 * zeta * 2.0 * s[1] - 4.0 * s[0]], [1.0, 0.0])[0]
    assert orders({"x": x}) == {"x": 2}


def test_the_amounts_of_a_reactor_are_amounts_whatever_they_are_called():
    x, z = simulated(lambda _, s: [0.2 - s[0] / (0.5 + s[0]), s[0] / (0.5 + s[0]) - 0.3 * s[1]], [3.0, 0.0])
    assert orders({"x": x, "z": z}) == {"x": 1, "z": 1}


def test_predator_and_prey_go_round_and_are_amounts():
    x, z = simulated(lambda _, s: [s[0] * (1.0 - s[1]), s[1] * (s[0] - 1.0)], [2.0, 1.0])
    assert orders({"x": x, "z": z}) == {"x": 1, "z": 1}


def test_under_a_controller_a_position_remains_one():
    """A force that is a function of position and speed tells the speed."""
    wanted = np.sin(0.5 * T) + 0.5 * np.sin(1.3 * T)

    def force(t, s):
        return 25.0 * (np.interp(t, T, wanted) - s[0]) - 12.0 * s[1]

    found = simulated(lambda t, s: [s[1], force(t, s) - 0.1 * s[1]], [0.0, 0.0])
    u = np.array([force(t, s) for t, s in zip(T, found.T, strict=True)])
    assert orders({"x": found[0], "u": u}) == {"x": 2}


def test_what_is_too_short_is_what_its_name_says():
    record = Record(T[:100], np.exp(-T[:100])[:, None], ("x",), (None,), "log")
    (seen,) = look(Records((record,)), {"x": Heading.of("x")})
    assert (seen.order, seen.why) == (2, "a position, by its name; order 1 for an amount")


TIME = np.arange(0.0, 30.0, 0.02)


def driven(t):
    return np.sin(1.3 * t) + np.cos(2.9 * t)


MOVING = {
    "oscillator": lambda t, x: (x[1], (1.0 - x[0] ** 2) * x[1] - x[0]),
    "driven": lambda t, x: (x[1], driven(t) - 4.0 * x[0] - 0.3 * x[1]),
    "amount": lambda t, x: (driven(t) - x[0], x[0] - 0.5 * x[1]),
    "Lorenz": lambda t, x: (10.0 * (x[1] - x[0]), x[0] * (28.0 - x[2]) - x[1], x[0] * x[1] - 8.0 / 3.0 * x[2]),
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("name", "measured", "hinted"),
    [("oscillator", 1, ["x0"]), ("driven", 1, ["x0"]), ("amount", 2, []), ("amount", 1, []), ("Lorenz", 1, [])],
)
def test_what_moves_as_a_position_does_is_told_from_amounts_and_hidden_states(name, measured, hinted, seed):
    rng = np.random.default_rng(seed)
    start = rng.uniform(0.5, 2.0, 3 if name == "Lorenz" else 2)
    x = solve_ivp(MOVING[name], (0.0, TIME[-1]), start, t_eval=TIME, rtol=1e-8, atol=1e-10).y[:measured].T
    x = x + 0.01 * x.std(axis=0) * rng.standard_normal(x.shape)
    names = tuple(f"x{k}" for k in range(measured))
    inputs = (Input("u"),) if name in ("driven", "amount") else ()
    columns = np.column_stack([x, driven(TIME)]) if inputs else x
    records = Records.of([Record(TIME, columns, (*names, *(i.name for i in inputs)))])
    signals = estimate_signals(records, tuple(Coordinate(n, 1) for n in names), inputs, Spectral())
    hints = second_order_hints(signals)
    assert list(hints) == hinted
    assert all(f"[coordinates.{n}]" in hints[n] for n in hinted)


def test_what_moves_as_a_position_does_is_advised_before_what_its_unit_says_it_may_be():
    x = solve_ivp(MOVING["oscillator"], (0.0, TIME[-1]), [1.0, 0.5], t_eval=TIME, rtol=1e-8, atol=1e-10).y[0]
    rng = np.random.default_rng(0)
    level = solve_ivp(lambda t, y: driven(t) - y, (0.0, TIME[-1]), [0.0], t_eval=TIME).y[0]
    columns = np.column_stack([column + 0.01 * rng.standard_normal(len(TIME)) for column in (x, level)])
    coordinates = (Coordinate("angle", 1, angle=True), Coordinate("level", 1, unit="m"))
    signals = estimate_signals(Records.of([Record(TIME, columns, ("angle", "level"))]), coordinates, (), Spectral())
    moves, may_be = order_advice(signals)
    assert "moves as a position does" in moves
    assert moves == second_order_hints(signals)["angle"]
    assert may_be.startswith("the equation of level, in m, is of order 1")
