"""Masses on springs in a row: what is linear has many Lagrangians, of which one gives every mass its coordinate."""

import numpy as np
import pytest
from logs import smooth
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

NAMES = ("x1", "x2", "x3")


def recorded(mass, stiffness, damping, pushed, count, band, size, noise, seed):
    """Positions with noise, and the input, of M x'' + D x' + K x = f u."""
    rng, step = np.random.default_rng(seed), 0.01
    t = step * np.arange(count)
    u = smooth(rng, count, step, band, size)
    inverse = np.linalg.inv(np.diag(mass))

    def rate(now, s):
        return [*s[3:], *(inverse @ (np.array(pushed) * np.interp(now, t, u) - stiffness @ s[:3] - damping @ s[3:]))]

    states = solve_ivp(rate, (0.0, t[-1]), np.zeros(6), t_eval=t, max_step=step, rtol=1e-8, atol=1e-10).y
    noisy = (x + noise * np.ptp(x) * rng.standard_normal(count) for x in states)
    return {"t": t, **dict(zip(NAMES, noisy, strict=False)), "u": u}


def in_a_row(first, *between):
    """The matrix of what holds three masses: the first to the ground, each to the next."""
    ends = [first, *between, 0.0]
    return np.diag(np.add(ends[:-1], ends[1:])) - np.diag(between, 1) - np.diag(between, -1)


def found(log):
    coordinates = {name: Measured(order=2) for name in NAMES}
    return identify(Study(data=Data(time="t"), coordinates=coordinates, inputs={"u": Driven()}), log).model


def energies(model):
    return {f"{m.kind} {m.name}": m.coefficient for m in model.mechanisms}


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2, 3, 4))])
def test_every_mass_of_a_chain_has_its_own_coordinate(seed):
    """Its mass matrix times a function of the stiffness over it is one of another Lagrangian, in which all is full."""
    stiffness, damping = in_a_row(30.0, 20.0, 25.0), in_a_row(0.4, 0.2, 0.0)
    damping[2, 2] += 0.6
    model = found(recorded((1.0, 1.5, 0.7), stiffness, damping, (1.0, 0.0, 0.0), 2500, 1.5, 10.0, 0.003, seed))
    truth = {
        "kinetic x1_dot**2": 0.5,
        "kinetic x2_dot**2": 0.75,
        "kinetic x3_dot**2": 0.35,
        "potential x1**2": 15.0,
        "potential (x1 - x2)**2": 10.0,
        "potential (x2 - x3)**2": 12.5,
        "dissipation x3_dot**2": 0.3,
        "force u on x1": 1.0,
    }
    there = energies(model)
    assert len(there) == 10
    assert {term: there[term] for term in truth} == pytest.approx(truth, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_energies_that_noise_hides_are_found_from_what_relations_say(seed):
    """A frame of three storeys on a table that shakes: 20 rad/s by 1 % of noise."""
    mass = np.array([1.0, 1.0, 0.83])
    stiffness, damping = in_a_row(200.0, 150.0, 100.0), in_a_row(0.6, 0.4, 0.3)
    model = found(recorded(mass, stiffness, damping, -mass, 3000, 4.0, 2.0, 0.01, seed))
    there = energies(model)
    truth = {
        "potential x1**2": 100.0,
        "potential (x1 - x2)**2": 75.0,
        "potential (x2 - x3)**2": 50.0,
        "kinetic x2_dot**2": 0.5,
        "kinetic x3_dot**2": 0.415,
        "force u on x2": -1.0,
    }
    assert len(there) == 12
    assert {term: there[term] for term in truth} == pytest.approx(truth, rel=0.1)
