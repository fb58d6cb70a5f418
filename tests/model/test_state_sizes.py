"""A free run is as exact in nanomoles as in moles: what is small is told by the sizes of states."""

from dataclasses import replace

import numpy as np
import pytest
from built_models import build

from odescope.export.programs.casadi import to_casadi
from odescope.model.simulation import simulate
from odescope.model.state_sizes import small_sizes
from odescope.recordings.coordinate import Coordinate, Input

TIMES = np.linspace(0.0, 2000.0, 11)
START = np.array([50.0, 1.0, 0.0])


def enzyme(unit):
    """S + E <-> C -> P + E, with amounts in so many moles."""
    k1, k2, k3 = 1e-3 / unit, 1.0, 0.5
    return build(
        [Coordinate("s"), Coordinate("e"), Coordinate("c")],
        [],
        [("s_dot", "1", 1.0), (None, "s*e", k1), (None, "c", -k2)],
        [("e_dot", "1", 1.0), (None, "s*e", k1), (None, "c", -k2 - k3)],
        [("c_dot", "1", 1.0), (None, "s*e", -k1), (None, "c", k2 + k3)],
    )


def block(unit):
    """A block on a spring, with dry friction: lengths in so many metres."""
    return build(
        [Coordinate("x", order=2)],
        [Input("u")],
        [("x_ddot", "1", 1.0), (None, "x", 9.0), (None, "sign(x_dot)", 1.5 * unit), (None, "u", -1.0)],
    )


@pytest.mark.parametrize("known", [False, True], ids=["initial", "domain"])
@pytest.mark.parametrize("unit", [1e-6, 1e-9, 1e-15])
def test_a_run_in_a_small_unit_is_that_in_a_large_one(unit, known):
    expected = simulate(enzyme(1.0), TIMES, None, START).states
    model = enzyme(unit)
    model = replace(
        model, domain={s: (0.0, unit * v) for s, v in zip(model.states, (50, 1, 1), strict=True)} if known else {}
    )
    found = simulate(model, TIMES, None, unit * START)
    assert found.ended is None
    off = np.abs(found.states / unit - expected).max(axis=0) / np.abs(expected).max(axis=0)
    assert np.all(off < 1e-5)


@pytest.mark.parametrize("unit", [1e-9, 1e-12])
def test_what_sticks_in_a_small_unit_sticks_where_it_does_in_a_large_one(unit):
    t = np.linspace(0.0, 6.0, 301)
    u = 1.3 * np.sin(1.7 * t)
    expected = simulate(block(1.0), t, u, [1.0, 0.0]).states
    found = simulate(block(unit), t, unit * u, [unit, 0.0]).states
    still = np.abs(expected[:, 1]) < 1e-12
    assert 0.05 < np.mean(still) < 0.95
    np.testing.assert_allclose(found / unit, expected, rtol=0, atol=1e-6)
    assert np.all(np.abs(found[still, 1]) < 1e-12 * unit)


def test_a_tolerance_that_is_given_stays():
    model, coarse = enzyme(1e-9), 1e-10
    loose = simulate(model, TIMES, None, 1e-9 * START, atol=coarse).states
    tight = simulate(model, TIMES, None, 1e-9 * START).states
    assert np.abs(loose - tight).max() > 1e-2 * 1e-9


def test_sizes_are_those_of_the_data_and_never_above_one():
    model = replace(enzyme(1.0), domain={"s": (-3.0, 50.0), "e": (-2e-9, 1e-9), "c": (0.0, 0.0)})
    assert small_sizes(model).tolist() == [1.0, 2e-9, 1.0]
    assert small_sizes(model, np.array([1e-4, 1e-4, 1e-14])).tolist() == [1.0, 2e-9, 1e-4]
    assert small_sizes(replace(model, domain={}), np.array([0.5, -1e-3, 1e-300])).tolist() == [0.5, 1e-3, 0.5]
    assert f"abstol={1e-12 * 2e-9!r})" in to_casadi(model).files["plant.py"]
