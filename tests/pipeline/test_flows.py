"""Tanks and vessels that flow into each other, through orifices and valves, by default settings."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

NOISE = 0.005  # of the standard deviation of a level


def flow(above, below):
    """What goes through an orifice."""
    return np.sign(above - below) * np.sqrt(abs(above - below))


def connected(h, pump, drain):
    """Two tanks, each with an inflow, whose flow into each other changes its sign."""
    between = 0.3 * flow(h[0], h[1])
    return 0.8 * pump - between, 0.8 * drain + between - 0.4 * flow(h[1], 0.0)


def throttled(h, pump, valve):
    """Two tanks with a valve between them, whose opening is recorded."""
    between = valve * flow(h[0], h[1])
    return 0.8 * pump - between, between - 0.4 * flow(h[1], 0.0)


def vessel(p, source, valve):
    """What is filled from a source of changing pressure through a valve, and leaks."""
    return (0.5 * valve * flow(source, p[0]) - 0.3 * flow(p[0], 0.0),)


def three(h, pump, other):
    """The benchmark of three tanks (Chen and Patton 1999): pumps into the outer two, all through the one between."""
    left, right = 0.3 * flow(h[0], h[2]), 0.3 * flow(h[2], h[1])
    return 0.5 * pump - left, 0.5 * other + right - 0.35 * flow(h[1], 0.0), left - right


def log(plant, start, inputs, span, seed):
    """A log of levels under inputs that go between random values.

    Args:
        plant: the rates, by levels and inputs.
        start: levels at first.
        inputs: least and largest value of each, and the time between nodes.
        span: the time that it takes, sampled at .15 intervals.
        seed: of inputs and noise.
    """
    rng, t = np.random.default_rng(seed), np.arange(0.0, span, 0.15)
    acts = [np.interp(t, every * np.arange(n := int(span / every) + 2), rng.uniform(*range_, n))
            for *range_, every in inputs.values()]  # fmt: skip
    run = solve_ivp(
        lambda now, h: plant(h, *(np.interp(now, t, a) for a in acts)), (0.0, span), start, t_eval=t,
        rtol=1e-8, atol=1e-10, max_step=0.5, method="LSODA",
    )  # fmt: skip
    levels = run.y + NOISE * run.y.std(axis=1, keepdims=True) * rng.standard_normal(run.y.shape)
    return {"t": t, **{f"h{k + 1}": h for k, h in enumerate(levels)}, **dict(zip(inputs, acts, strict=True))}


def found(plant, starts, inputs, span, seed):
    """Return the terms of every relation that default settings find, bare targets aside, by target.

    Args:
        plant: as `log` has it.
        starts: of each record.
        inputs: as `log` has them.
        span: of each record.
        seed: of the first record.
    """
    logs = [log(plant, start, inputs, span, 10 * seed + k) for k, start in enumerate(starts)]
    study = Study(
        data=Data(time="t"),
        coordinates={f"h{k + 1}": Measured() for k in range(len(starts[0]))},
        inputs={name: Driven() for name in inputs},
    )
    relations = identify(study, logs).model.relations
    assert all(len(r.targets) == 1 for r in relations)
    return {r.targets[0]: {t.text: -t.coefficient for t in r.terms if not t.product.bare} for r in relations}


BETWEEN = "sign(h1 - h2)*sqrt(abs(h1 - h2))"


def test_two_tanks_whose_flow_changes_its_sign():
    inputs = {"u": (0.0, 0.6, 15.0), "v": (0.2, 0.8, 20.0)}
    laws = found(connected, [[2.0, 0.8], [1.0, 1.8]], inputs, 200.0, seed=1)
    assert laws["h1_dot"] == pytest.approx({"u": 0.8, BETWEEN: -0.3}, rel=0.01)
    assert laws["h2_dot"] == pytest.approx({"v": 0.8, "sqrt(h2)": -0.4, BETWEEN: 0.3}, rel=0.01)


def test_a_valve_between_a_source_and_a_vessel():
    inputs = {"u": (2.0, 6.0, 15.0), "w": (0.1, 1.0, 10.0)}
    laws = found(vessel, [[2.0], [1.0]], inputs, 200.0, seed=0)
    assert laws["h1_dot"] == pytest.approx({"sqrt(h1)": -0.3, "w*sign(h1 - u)*sqrt(abs(h1 - u))": -0.5}, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_two_tanks_with_a_valve_between_them(seed):
    inputs = {"u": (0.2, 0.8, 15.0), "w": (0.1, 0.8, 9.0)}
    laws = found(throttled, [[2.0, 0.8], [1.0, 1.8]], inputs, 200.0, seed)
    assert laws["h1_dot"] == pytest.approx({"u": 0.8, f"w*{BETWEEN}": -1.0}, rel=0.01)
    assert laws["h2_dot"] == pytest.approx({"sqrt(h2)": -0.4, f"w*{BETWEEN}": 1.0}, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_three_tanks(seed):
    inputs = {"u": (0.0, 0.7, 25.0), "v": (0.1, 0.7, 30.0)}
    laws = found(three, [[2.0, 0.8, 1.5], [1.0, 1.8, 1.2]], inputs, 300.0, seed)
    left, right = "sign(h1 - h3)*sqrt(abs(h1 - h3))", "sign(h2 - h3)*sqrt(abs(h2 - h3))"
    assert laws["h1_dot"] == pytest.approx({"u": 0.5, left: -0.3}, rel=0.01)
    assert laws["h2_dot"] == pytest.approx({"v": 0.5, "sqrt(h2)": -0.35, right: -0.3}, rel=0.01)
    assert laws["h3_dot"] == pytest.approx({left: 0.3, right: 0.3}, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_cone_runs_out_by_the_root_over_the_square_of_its_level(seed):
    def cone(h, pump):
        return ((0.3 * pump - 0.26 * flow(h[0], 0.0)) / h[0] ** 2,)

    (law,) = found(cone, [[1.1]], {"u": (0.7, 1.2, 15.0)}, 400.0, seed).values()
    # The relation may be that times a power of the level.
    flows = sorted(c for text, c in law.items() if "h1_dot" not in text)
    assert flows == pytest.approx([-0.26, 0.3], rel=0.01)
