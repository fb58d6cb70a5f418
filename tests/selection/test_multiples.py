import numpy as np
import pytest

from odescope.library.candidates import Library
from odescope.library.parse import Scope
from odescope.recordings.coordinate import Coordinate
from odescope.regression.problem import pose
from odescope.regression.rows import PlainRows
from odescope.selection.multiples import multiplied
from odescope.selection.ranking import as_candidate
from odescope.selection.sweep import Sweep
from odescope.signals.estimate import Channel, Signals

NAMES = ("x", "y", "x_dot")
SCOPE = Scope.of(NAMES)
LIBRARY = Library.of(("1", "x", "y", "x**2", "x*y", "y**2", "x**3", "x**2*y", "x*y**2", "y**3"), SCOPE) + Library.of(
    ("x_dot", "x_dot*x", "x_dot*y", "x_dot*x**2", "x_dot*x*y", "x_dot*y**2", "x_dot*x**3"), SCOPE
)
LAW = {"x", "x**2", "x*y", "x_dot", "x_dot*x"}
DIVIDED = {"1", "x", "y", "x_dot", "x_dot*x", "x_dot*x**2", "x_dot*x**3"}


def wave(rng, count):
    """A sum of sines between 0 and 1."""
    t, f = 0.02 * np.arange(count), rng.uniform(0.05, 0.5, 4)
    found = np.sum(np.sin(2.0 * np.pi * f[:, None] * t + rng.uniform(0.0, 6.0, (4, 1))), axis=0)
    return (found - found.min()) / np.ptp(found)


def posed(noise, seed):
    """x_dot = x (1 - x - .8 y) / (1 + 3 x), but for white noise."""
    rng, count = np.random.default_rng(seed), 3000
    x, y = 0.3 + 0.7 * wave(rng, count), wave(rng, count)
    slope = x * (1.0 - x - 0.8 * y) / (1.0 + 3.0 * x)
    columns = np.array([x, y, slope + noise * slope.std() * rng.standard_normal(count)])
    channels, coordinates = (Channel("x", 0.1, 5.0),), (Coordinate("x"), Coordinate("y"))
    signals = Signals(NAMES, (columns,), (0.0,), 0.02, channels, coordinates, ())
    return pose(signals, "x_dot", 1, LIBRARY, PlainRows())


def columns_of(problem, texts):
    return tuple(j for j, t in enumerate(problem.terms) if t.text in texts)


@pytest.mark.parametrize("seed", range(8))
def test_a_law_is_found_again_from_what_it_is_when_it_is_divided_by_a_variable(seed):
    problem = posed(0.01, seed)
    divided = as_candidate(problem, columns_of(problem, DIVIDED), Sweep((), (), len(problem.terms)))
    assert divided.target_r2 > 0.999
    assert multiplied(problem, [divided]) == columns_of(problem, LAW)


def test_nothing_beats_the_law():
    problem = posed(0.01, 0)
    law = as_candidate(problem, columns_of(problem, LAW), Sweep((), (), len(problem.terms)))
    assert multiplied(problem, [law]) is None


def test_a_target_by_itself_is_multiplied_by_nothing():
    problem = posed(0.01, 0)
    plain = as_candidate(problem, columns_of(problem, {"x", "x*y", "x_dot"}), Sweep((), (), len(problem.terms)))
    assert multiplied(problem, [plain]) is None


def test_a_support_that_is_included_anew_has_all_its_columns_for_guesses():
    found = Sweep(((0, 1), (2, 3)), ((0,), (2, 3)), 4).including((0, 1))
    assert found == Sweep(((2, 3), (0, 1)), ((2, 3), (0, 1)), 4)
