"""Terms that a record hardly tells from others are named, and those that it tells are not."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

SEEDS = [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))]
STUDY = Study(
    data=Data(time="t"), coordinates={"phi": Measured(order=2, angle=True)}, inputs={"u": Driven(hold="linear")}
)


def pendulum(seed, count, size):
    """Return a log of a driven pendulum that swings up to an angle, at 3 % noise."""
    rng, t = np.random.default_rng(seed), 0.05 * np.arange(count)
    f, phase = rng.uniform(0.05, 0.8, 8), rng.uniform(0.0, 2.0 * np.pi, 8)
    u = size * np.sin(2.0 * np.pi * np.multiply.outer(t, f) + phase).sum(axis=1)

    def rate(now, z):
        return [z[1], -4.0 * np.sin(z[0]) - 0.3 * z[1] + 1.5 * np.interp(now, t, u)]

    phi = solve_ivp(rate, (0.0, t[-1]), [0.6 * size, 0.0], t_eval=t, rtol=1e-8, atol=1e-10, max_step=0.05).y[0]
    return {"t": t, "phi": phi + 0.03 * phi.std() * rng.standard_normal(count), "u": u}


def look_alikes(result):
    return [note for note in result.warnings if note.startswith("look-alikes")]


@pytest.mark.slow
def test_a_short_swing_does_not_tell_dry_friction_from_drag():
    (said,) = look_alikes(identify(STUDY, pendulum(1, 70, 0.4)))
    assert "sign(phi_dot) in phi_ddot or phi_dot" in said


@pytest.mark.parametrize("seed", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_what_is_of_a_higher_degree_stands_in_no_place_of_a_simpler_term(seed):
    """Of a short swing phi_dot*cos(phi) is as likely as phi_dot."""
    result = identify(STUDY, pendulum(seed, 70, 0.4))
    assert {t.text for t in result.model.relations[0].terms} == {"phi_ddot", "sin(phi)", "phi_dot", "u"}
    assert look_alikes(result) == []


@pytest.mark.parametrize("seed", [7, *(pytest.param(k, marks=pytest.mark.slow) for k in (5, 8, 24))])
def test_products_with_what_hardly_changes_give_way_to_what_they_are_products_of(seed):
    rng, t = np.random.default_rng(seed), 60.0 * np.arange(240)
    ambient = 14.0 + 6.0 * np.sin(2.0 * np.pi * t / 86400.0 * 3.0 + rng.uniform(0.0, 6.0))
    pressure = 1012.0 + 0.4 * np.convolve(rng.standard_normal(len(t) + 99), np.ones(100) / 10.0, "valid")
    heat = np.repeat(rng.uniform(0.0, 2.0, 6), 40)

    def rate(now, T):
        k = min(int(now / 60.0 + 1e-9), len(t) - 1)
        return 3e-4 * (np.interp(now, t, ambient) - T) + 4e-3 * heat[k]

    T = solve_ivp(rate, (0.0, t[-1]), [20.0], t_eval=t, rtol=1e-8, atol=1e-8, max_step=30.0).y[0]
    log = {"t": t, "T": T + 0.1 * rng.standard_normal(len(t)), "Ta": ambient, "p": pressure, "q": heat}
    inputs = {"Ta": Driven(hold="linear"), "p": Driven(hold="linear"), "q": Driven(hold="zero")}
    study = Study(data=Data(time="t"), coordinates={"T": Measured()}, inputs=inputs)
    (relation,) = identify(study, log).model.relations
    assert {t.text for t in relation.terms} == {"T_dot", "T", "Ta", "q"}


@pytest.mark.parametrize("seed", SEEDS)
def test_a_long_record_of_large_swings_tells_every_term(seed):
    result = identify(STUDY, pendulum(seed, 1500, 1.0))
    assert {t.text for t in result.model.relations[0].terms} == {"phi_ddot", "sin(phi)", "phi_dot", "u"}
    assert look_alikes(result) == []
