"""Published systems: the tables read as they are meant, models are compared term by term, and simple ones are found."""

from dataclasses import replace

import numpy as np
import pytest
from public import Job, attempt, clean, recorded, systems
from published import chaotic, compared, odebench
from truths import relations

from odescope.recordings.coordinate import Coordinate


def written(system, change=lambda factor, text, c: c):
    """Return the model of a system's law, its coefficients changed; what comes to 0 is left out."""
    coordinates = tuple(Coordinate(name) for name in system.coordinates)
    rows = {}
    for c, law in zip(coordinates, system.laws, strict=True):
        named = [(c.target if with_target else None, text, value) for (with_target, text), value in law.items()]
        rows[c.target] = [(f, t, new) for f, t, v in named if (new := change(f, t, v))]
    return relations(coordinates, (), rows).model


def test_there_are_all_of_them():
    assert len(chaotic()) == 79
    assert list(odebench()) == [str(k) for k in range(1, 64)]
    assert sorted(len(s.states) for s in odebench().values()) == [1] * 23 + [2] * 28 + [3] * 10 + [4] * 2
    assert all(len(start) == len(s.states) for s in odebench().values() for start in s.starts)


@pytest.mark.parametrize(
    ("number", "state", "rates"),
    [
        ("18", [20.0], [0.4 * 20 * (1 - 0.2) - 0.24 * 20 / 70]),
        ("33", [2.0, 0.5], [-np.sin(0.5) - 0.32, 2.0 - np.cos(0.5) / 2.0]),
        ("42", [2.0, 3.0], [8.9 - 2 - 24 / 5, 2.8 * (1 - 3 / 5)]),
        ("47", [0.3, 0.6], [-0.3 + 1 / (1 + np.exp(4.89 * 0.6 - 1.4)), -0.6 + 1 / (1 + np.exp(4.89 * 0.3 - 1.4))]),
    ],
)
def test_right_hand_sides_are_those_published(number, state, rates):
    np.testing.assert_allclose(odebench()[number].rate(0.0, np.array(state)), rates, rtol=1e-10)


def test_the_law_itself_is_exact_and_one_without_a_term_is_not():
    system = odebench()["42"]
    assert compared(system, written(system)).exact
    worse = compared(system, written(system, lambda f, t, c: 0.0 if t == "x*y" else c))
    assert not worse.exact
    assert worse.failures["x_dot"] == "missing ['x*y'], extra []"


def test_errors_are_relative_whatever_the_relation_is_scaled_by():
    system = odebench()["18"]
    found = compared(system, written(system, lambda f, t, c: 1.02 * c if t == "x**2" else c))
    assert max(found.errors.values()) == pytest.approx(0.02)
    assert sorted(found.errors.values())[-2] < 1e-10


def test_positions_have_equations_of_order_two_for_the_same_motion():
    found = systems("positions")
    assert {"24", "28", "HenonHeiles"} <= set(found)
    assert found["24"].states == ("x", "x_dot")
    both = chaotic()["HenonHeiles"], found["HenonHeiles"]
    np.testing.assert_allclose(clean(both[0])[0][1], clean(both[1])[0][1])


def test_half_of_the_samples_are_kept_with_noise_in_proportion():
    job = Job("odebench", odebench()["2"], 0.05, (), 3, 60.0, 0)
    (t, states), run = clean(job.system)[0], recorded(job)[0]
    assert len(run["t"]) == 75
    off = run["x"] / states[np.isin(t, run["t"]), 0] - 1.0
    assert off.std() == pytest.approx(0.05, rel=0.3)
    assert np.array_equal(recorded(replace(job, noise=0.0))[0]["t"], t)


@pytest.mark.slow
def test_a_solution_to_the_tolerance_of_its_solver_gives_the_law():
    """Logistic growth with harvesting: the constant is a hundredth of the rest, what the solver errs by a millionth."""
    result = attempt(Job("odebench", odebench()["17"], 0.0, (), 3, 60.0, 0))
    assert result["exact"]
    assert min(result["generalisation"][0]) > 0.999
