"""Energies of a Lagrangian, beside those of a cart with a pendulum worked out by hand."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.model.energy import energies_of, energy_scores, loosest, mass_matrix
from odescope.model.relation import FoundMechanism
from odescope.recordings.coordinate import Coordinate, Input

CART = (Coordinate("x", 2, cyclic=True), Coordinate("phi", 2, angle=True))
FORCE = (Input("u"),)
NAMES = ("x", "phi", "x_dot", "phi_dot", "u")


def found(kind, term, coefficient, error=None, name=None):
    return FoundMechanism(name or term, kind, term, coefficient, error)


MECHANISMS = (
    found("kinetic", "x_dot**2", 0.9, 1e-3),
    found("kinetic", "x_dot*phi_dot*cos(phi)", 0.18, 1e-3),
    found("kinetic", "phi_dot**2", 0.0275, 1e-4),
    found("potential", "cos(phi)", -1.7658, 1e-3),
    found("dissipation", "x_dot**2", 5.0),
    found("dissipation", "abs(phi_dot)", 0.01),
    found("force", "u", 1.0, name="u on x"),
)


def run(h=0.005, count=2001):
    """States and input (5, count), and the sampling period."""
    drive = lambda t: 5 * np.sin(2 * t) + 3 * np.cos(5.3 * t)  # noqa: E731

    def rate(t, s):
        _, phi, v, w = s
        matrix = [[1.8, 0.18 * np.cos(phi)], [0.18 * np.cos(phi), 0.055]]
        right = [drive(t) - 10 * v + 0.18 * w**2 * np.sin(phi), -1.7658 * np.sin(phi) - 0.01 * np.sign(w)]
        return [v, w, *np.linalg.solve(matrix, right)]

    t = h * np.arange(count)
    states = solve_ivp(rate, (0, t[-1]), [0, 1.5, 0, 0], t_eval=t, rtol=1e-9, atol=1e-9, max_step=h).y
    return np.vstack([states, drive(t)]), h


COLUMNS, PERIOD = run()


def scores(mechanisms, columns=COLUMNS):
    energies = energies_of(CART, FORCE, mechanisms)
    return energy_scores(energies, mechanisms, NAMES, [columns[:, :1200], columns[:, 1200:]], PERIOD)


def changed(kind, term, coefficient):
    return tuple(
        found(kind, term, coefficient, m.std_error, m.name) if (m.kind, m.term) == (kind, term) else m
        for m in MECHANISMS
    )


def test_the_mass_matrix_is_the_second_derivative_of_the_kinetic_energy():
    matrix = mass_matrix(CART, FORCE, MECHANISMS)
    assert [[entry.text for entry in row] for row in matrix] == [["1.8", "0.18*cos(phi)"], ["0.18*cos(phi)", "0.055"]]


def test_the_true_mechanisms_balance_and_the_least_inertia_is_that_of_the_matrix():
    score = scores(MECHANISMS)
    assert score.imbalance < 1e-4
    assert score.least_dissipation >= 0.0
    cosine = np.cos(COLUMNS[1])
    exact = min(np.linalg.eigvalsh([[1.8, 0.18 * c], [0.18 * c, 0.055]])[0] for c in cosine)
    assert score.least_inertia == pytest.approx(exact, rel=1e-9)
    assert score.loosest == pytest.approx(1e-3 / 0.18)


def test_without_friction_the_energy_is_out_of_balance():
    without = tuple(m for m in MECHANISMS if m.term != "x_dot**2" or m.kind != "dissipation")
    assert scores(without).imbalance > 0.2


def test_energy_that_stays_is_in_balance_whatever_the_noise_of_the_rates():
    free = tuple(m for m in MECHANISMS if m.kind in ("kinetic", "potential"))
    matrix = lambda phi: [[1.8, 0.18 * np.cos(phi)], [0.18 * np.cos(phi), 0.055]]  # noqa: E731
    right = lambda phi, w: [0.18 * w**2 * np.sin(phi), -1.7658 * np.sin(phi)]  # noqa: E731
    rate = lambda _, s: [s[2], s[3], *np.linalg.solve(matrix(s[1]), right(s[1], s[3]))]  # noqa: E731
    t = PERIOD * np.arange(2001)
    states = solve_ivp(rate, (0, t[-1]), [0, 1.5, 0, 0], t_eval=t, rtol=1e-9, atol=1e-9).y
    states[2:] += 0.01 * states[2:].std(axis=1, keepdims=True) * np.random.default_rng(0).standard_normal((2, 2001))
    assert scores(free, np.vstack([states, np.zeros(2001)])).imbalance < 0.02


def test_energy_that_is_given_back_and_inertia_that_is_negative_are_seen():
    assert scores(changed("dissipation", "abs(phi_dot)", -0.01)).least_dissipation < 0.0
    assert scores(changed("kinetic", "x_dot*phi_dot*cos(phi)", 0.5)).least_inertia < 0.0


def test_kinetic_terms_that_are_linear_in_the_rates_hold_no_energy():
    gyroscopic = (*MECHANISMS, found("kinetic", "x_dot*phi", 3.0))
    assert energies_of(CART, FORCE, gyroscopic).energy == energies_of(CART, FORCE, MECHANISMS).energy


def test_a_kinetic_term_that_is_told_from_nothing_is_loose():
    loose = (*MECHANISMS, found("kinetic", "phi_dot**2*cos(phi)", 1e-3, 3e-3))
    assert loosest(loose) == pytest.approx(3.0)
    assert loosest([found("potential", "cos(phi)", 1.0, 9.0), found("kinetic", "x_dot**2", 0.5)]) is None


@pytest.mark.parametrize(
    ("coordinates", "mechanisms"),
    [
        (CART, ()),
        (CART, (*MECHANISMS, found("tie", "x_dot**2", 1.0))),
        (CART, (*MECHANISMS, found("force", "u", 1.0))),
        (CART, (*MECHANISMS, found("potential", "__import__('os')", 1.0))),
        ((Coordinate("x"), Coordinate("phi")), MECHANISMS),
    ],
    ids=["none", "tie", "force on nothing", "unreadable", "order 1"],
)
def test_what_is_no_lagrangian_has_no_energies(coordinates, mechanisms):
    assert energies_of(coordinates, FORCE, mechanisms) is None
    assert mass_matrix(coordinates, FORCE, mechanisms) is None
