"""Springs of angles: what goes back by the angle itself, where a default library has sines and cosines alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.relation import RelationTerm
from odescope.pipeline import competition
from odescope.pipeline.identification import identify
from odescope.pipeline.wider import regressed_with, with_extra
from odescope.study.options import Data, Driven, Measured, Study

NOISE = 0.005
HELD = 50  # samples that an input keeps its value
TURNING = Study(
    data=Data(time="t"), coordinates={"a": Measured(order=2, angle=True)}, inputs={"u": Driven(hold="zero")}
)


def recorded(rate, starts, period, count, reach, seed):
    """Return logs of a'' = rate(a, a', u), where u is held, at half a per cent of noise."""
    rng, logs = np.random.default_rng(seed), []
    t = period * np.arange(count)
    for start in starts:
        u, x = np.repeat(rng.uniform(-reach, reach, -(-count // HELD)), HELD)[:count], [np.array(start)]
        for k in range(0, count - 1, HELD):
            there = t[k : k + HELD + 1]
            solved = solve_ivp(
                lambda _, s, now=u[k]: [s[1], rate(*s, now)], (there[0], there[-1]), x[-1],
                t_eval=there[1:], rtol=1e-9, atol=1e-12, max_step=period,
            )  # fmt: skip
            x.extend(solved.y.T)
        a = np.array(x)[:, 0]
        logs.append({"t": t, "a": a + NOISE * a.std() * rng.standard_normal(count), "u": u})
    return logs


def servo(a, v, u):
    return 208.0 * u - 500.0 * a - 2.5 * v - 33.3 * np.tanh(v / 0.01)


def ship(a, v, u):
    return -0.3 * a + 0.27 * a**3 - 0.02 * v - 0.25 * v * abs(v) + u


def yaw(_, v, u):
    return u - 0.1 * v - 14.0 * v**3


def pendulum(a, v, u):
    return u - 9.0 * np.sin(a) - 0.3 * v


def sprung(a, v, u):
    return u + 6.0 * np.sin(a) - 14.0 * a - 0.3 * v


def found(logs):
    (relation,) = identify(TURNING, logs).model.relations
    return {t.text: -t.coefficient for t in relation.terms if t.product.factor is None}


MACHINES = {
    "servo": (
        servo,
        [[0.3, 0.0], [-0.5, 0.0]],
        0.002,
        2000,
        2.0,
        {"u": 208.0, "a": -500.0, "a_dot": -2.5},
        {"sign(a_dot)"},
    ),
    "ship": (
        ship,
        [[0.3, 0.0], [-0.2, 0.0]],
        0.1,
        1500,
        0.05,
        {"u": 1.0, "a": -0.3, "a**3": 0.27},
        {"a_dot", "a_dot*abs(a_dot)"},
    ),
    "yaw": (
        yaw,
        [[1.0, 0.0], [0.0, 0.0]],
        1.0,
        1500,
        0.01,
        {"u": 1.0, "a_dot": -0.1, "a_dot**3": -14.0},
        set(),
    ),
    "pendulum": (
        pendulum,
        [[0.5, 0.0], [-0.8, 0.0]],
        0.01,
        1500,
        2.0,
        {"u": 1.0, "sin(a)": -9.0, "a_dot": -0.3},
        set(),
    ),
    "sprung": (
        sprung,
        [[0.9, 0.0], [-0.5, 0.0]],
        0.01,
        1500,
        5.0,
        {"u": 1.0, "a": -14.0, "sin(a)": 6.0, "a_dot": -0.3},
        set(),
    ),
}


def right(machine, seed):
    rate, starts, period, count, reach, truth, beside = MACHINES[machine]
    terms = found(recorded(rate, starts, period, count, reach, seed))
    return terms.keys() == truth.keys() | beside and all(abs(terms[n] / v - 1.0) < 0.03 for n, v in truth.items())


@pytest.mark.parametrize(
    ("machine", "seeds"), [("servo", 1), *(pytest.param(m, 6, marks=pytest.mark.slow) for m in MACHINES)]
)
def test_an_angle_is_held_by_what_holds_it(machine, seeds):
    assert sum(right(machine, seed) for seed in range(seeds)) >= 0.8 * seeds


def quarter_car(seed):
    """Return a log of a body on a wheel on a road, with a damper that is harder when it is drawn, at .4 % noise."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 20.0, 0.005)
    f, phase, size = rng.uniform(0.2, 8.0, 40), rng.uniform(0.0, 2.0 * np.pi, 40), 0.004 * rng.standard_normal(40)

    def road(now):
        return np.sin(2.0 * np.pi * np.multiply.outer(now, f) + phase) @ size

    def rate(now, s):
        v = s[1] - s[3]
        force = 1500.0 * v + 500.0 * abs(v) + 16_000.0 * (s[0] - s[2])
        return [s[1], -force / 300.0, s[3], (force - 160_000.0 * (s[2] - road(now))) / 40.0]

    x, _, y, _ = solve_ivp(rate, (0.0, t[-1]), np.zeros(4), t_eval=t, rtol=1e-9, atol=1e-11).y
    noisy = {name: z + 0.004 * z.std() * rng.standard_normal(len(t)) for name, z in (("x", x), ("y", y))}
    return {"t": t, **noisy, "u": road(t)}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_damper_that_is_harder_when_it_is_drawn(seed):
    coordinates = {name: Measured(order=2, unit="m") for name in "xy"}
    study = Study(data=Data(time="t"), coordinates=coordinates, inputs={"u": Driven()})
    relations = identify(study, quarter_car(seed)).model.relations
    moving = {"x", "y", "x_dot", "y_dot", "abs(x_dot - y_dot)"}
    assert [{t.text for t in r.terms} for r in relations] == [{"x_ddot", *moving}, {"y_ddot", "u", *moving}]
    (size,) = (t for t in relations[0].terms if t.text == "abs(x_dot - y_dot)")
    assert abs(size.coefficient - 500.0 / 300.0) < 4.0 * size.std_error


def test_relations_of_another_library_are_ranked_on_the_rows_of_one_where_this_has_their_terms():
    logs = recorded(pendulum, [[0.5, 0.0], [-0.8, 0.0]], 0.01, 600, 2.0, 0)
    seen = []

    def kept(work, filtered, regressed):
        wide = regressed_with(with_extra(work, ("a", "a**3")), filtered)
        seen.append((regressed, wide))
        return regressed

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(competition, "with_springs_and_dampers", kept)
        identify(TURNING, logs)
    ((narrow, wide),) = seen
    assert narrow.worth(narrow.relations) == pytest.approx(narrow.criterion)
    assert wide.worth(narrow.relations) >= wide.criterion  # which is the best of this library
    sprung = [
        replace(r, terms=(*r.terms, RelationTerm(Product(None, parse_term("a", Scope.of("a"))), 1.0)))
        for r in wide.relations
    ]
    assert np.isfinite(wide.worth(sprung))
    assert narrow.worth(sprung) == np.inf
